"""Recordings: what a session saw and gave, in MCAP files that survive a killed process, a full disk and a slow one."""

from stream.recording.lane import RecorderStatus
from stream.recording.reader import Recording
from stream.recording.recorder import Recorder
from stream.recording.tally import RecordedStream
from stream.recording.versions import versions

__all__ = ["RecordedStream", "Recorder", "RecorderStatus", "Recording", "versions"]
