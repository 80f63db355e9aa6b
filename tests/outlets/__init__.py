"""Outlets: tables, reports, LSL, MQTT, the terminal, triggers."""
