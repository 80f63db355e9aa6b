"""A training session's report: sets, repetitions, tempo, rest, and how well they were done."""

from kinegraph.devices.reports.training.report import TrainingReport

__all__ = ["TrainingReport"]
