"""Where streams begin and end: devices, simulators, files, the screen."""
