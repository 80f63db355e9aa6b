"""The bench of datagrams and belts runs, and measures what it says."""

from __future__ import annotations

import pytest

from bench import datagrams

pytestmark = pytest.mark.nightly


def test_frames_are_measured_from_bytes_to_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("bleak")
    monkeypatch.setattr(datagrams, "N", 40)
    monkeypatch.setattr(datagrams, "ROUNDS", 1)
    for figures in (datagrams.natnet_figures(), datagrams.polar_figures()):
        assert next(iter(figures)) == "source" and all(us > 0 for us in figures.values())
    assert all(us > 0 for us in datagrams.declared_figures().values())


def test_whole_sources_are_measured_as_datagrams_come() -> None:
    figures = datagrams.whole_sources(rounds=1, seconds=0.3, after=0.0)
    assert len(figures) == 4 and all(us > 0 for us in figures.values())
