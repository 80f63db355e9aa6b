"""A session's report: a page that a clinician can read and print, and a table of every cycle."""

from kinegraph.devices.reports.session.session import SessionReport

__all__ = ["SessionReport"]
