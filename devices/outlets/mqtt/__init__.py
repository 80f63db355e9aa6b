"""Streams of a graph as entities of a home, over MQTT: `MqttOutlet`."""

from devices.outlets.mqtt.outlet import MqttOutlet

__all__ = ["MqttOutlet"]
