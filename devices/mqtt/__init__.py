"""MQTT: the connection to a broker, and a switch of the home that comes into the graph by `MqttSwitch`."""

from devices.mqtt.switch import MqttSwitch

__all__ = ["MqttSwitch"]
