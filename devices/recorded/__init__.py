"""Other programs' formats, in and out: importers make recordings of them, exporters write them from recordings."""

from typing import TYPE_CHECKING

from kinegraph.stream.system.lazy import offered

if TYPE_CHECKING:
    from kinegraph.devices.recorded.recorded_streams import RecordedStreams

__all__ = ["RecordedStreams"]

__getattr__, __dir__ = offered(__name__, {"RecordedStreams": "kinegraph.devices.recorded.recorded_streams"})
