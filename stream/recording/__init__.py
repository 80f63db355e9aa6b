"""Recordings: what a session saw and gave, in MCAP files that survive a killed process, a full disk and a slow one."""

from kinegraph.stream.recording.format.recorded_stream import RecordedStream
from kinegraph.stream.recording.format.versions import versions
from kinegraph.stream.recording.read.reader import Recording
from kinegraph.stream.recording.write.recorder import Recorder
from kinegraph.stream.recording.write.recorder_slot import RecorderStatus

__all__ = ["RecordedStream", "Recorder", "RecorderStatus", "Recording", "versions"]
