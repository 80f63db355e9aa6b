"""MQTT: streams of a graph as entities of a home (`MqttOutlet`), and a switch of the home that comes into the graph (`MqttSwitch`)."""

from kinegraph.devices.mqtt.outlet import MqttOutlet
from kinegraph.devices.mqtt.switch import MqttSwitch

__all__ = ["MqttOutlet", "MqttSwitch"]
