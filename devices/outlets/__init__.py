"""Where results leave a graph: the terminal, files, reports, MQTT, LSL."""
