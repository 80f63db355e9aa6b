"""MQTT: what a graph finds out goes to home automation by `MqttOutlet`, and a switch there comes into the graph by `MqttSwitch`."""

from devices.mqtt.outlet import MqttOutlet
from devices.mqtt.switch import MqttSwitch

__all__ = ["MqttOutlet", "MqttSwitch"]
