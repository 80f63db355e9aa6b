"""Open Sound Control, and the VMC protocol that is built on it: numbers, markers and poses, received and sent."""

from kinegraph.devices.osc.inlet import OscInlet
from kinegraph.devices.osc.outlet import OscOutlet

__all__ = ["OscInlet", "OscOutlet"]
