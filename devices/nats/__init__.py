"""NATS JetStream: an edge of a graph that leaves its machine (`StreamOutlet`), and enters another graph as a source (`StreamInlet`)."""

from kinegraph.devices.nats.inlet import StreamInlet
from kinegraph.devices.nats.outlet import StreamOutlet

__all__ = ["StreamInlet", "StreamOutlet"]
