"""Any board that BrainFlow knows, as one source; extra `boards`."""

from kinegraph.devices.brainflow.source import BrainflowBoard

__all__ = ["BrainflowBoard"]
