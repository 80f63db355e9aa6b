"""Recordings: what a session saw and gave, in MCAP files that survive a killed process, a full disk and a slow one."""

from stream.recording.reader import Recording
from stream.recording.recorded_stream import RecordedStream
from stream.recording.recorder import Recorder
from stream.recording.recorder_slot import RecorderStatus
from stream.recording.versions import versions

__all__ = ["RecordedStream", "Recorder", "RecorderStatus", "Recording", "versions"]
