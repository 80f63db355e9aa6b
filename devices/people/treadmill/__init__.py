"""A simulated treadmill session: EMG, contacts and force of a walk with known truth."""

from kinegraph.devices.people.treadmill.source import CONTACT, Treadmill, truth

__all__ = ["CONTACT", "Treadmill", "truth"]
