"""OptiTrack Motive, live by NatNet: rigid bodies, bones, labelled markers, analog channels; multicast and unicast."""

from kinegraph.devices.natnet.source import NatNet

__all__ = ["NatNet"]
