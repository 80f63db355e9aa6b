"""The bench of datagrams and belts runs, and measures what it says."""

from __future__ import annotations

import pytest

from bench import datagrams


def test_frames_are_measured_from_bytes_to_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("bleak")
    monkeypatch.setattr(datagrams, "N", 40)
    monkeypatch.setattr(datagrams, "ROUNDS", 1)
    for figures in (datagrams.natnet_figures(), datagrams.polar_figures()):
        assert next(iter(figures)) == "source" and all(us > 0 for us in figures.values())
    assert all(us > 0 for us in datagrams.declared_figures().values())
