"""Every script of the bench runs, with tiny sizes and without peers; what it measures is not judged here."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from bench import page, page_recording, page_turns
from bench.__main__ import MEASURES
from bench.report import BEGIN, END, Goal, Section, goals, into_page, short
from tests.support.page_session import needs_page

ROOT = Path(__file__).resolve().parents[2]


def run(*arguments: str) -> str:
    done = subprocess.run([sys.executable, "-m", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.nightly
def test_all_measures_run() -> None:
    """All but `serial` and `lsl`, which take a while however small; the first one's parts are tested in test_bench_devices.py."""
    measures = [name for name in MEASURES if name not in ("serial", "lsl")]
    text = run("bench", "--quick", "--no-peers", "--only", *measures)
    for words in ("MTi at 2000 Hz", "copies of a frame"):
        assert words in text
    for words in ("Cost of a message", "Five operators", "Paced", "Recording", "Start", "Replay of 0.02 hours"):
        assert words in text
    assert "the bare loop gives the same" in text  # the chain's bits, whatever the chunks
    assert "| different answers over 3 chunk sizes | 1 " in text


@pytest.mark.nightly
def test_stalls_run() -> None:
    order = {"freeze": False, "first": 700, "switch_ms": 5, "nogil": True, "beside": "busy", "seconds": 0.2}
    due = json.loads(run("bench.stalls", "--one", json.dumps(order)).splitlines()[-1])
    assert len(due) == 20
    assert min(due) > 0


@needs_page
@pytest.mark.timeout(600)
@pytest.mark.nightly
def test_the_page_and_its_recordings_can_be_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = ("no page", "one client", "five clients", "the server killed every second", "no page, again")
    kinds = {name: page.KINDS[name] for name in tried}
    monkeypatch.setattr(page, "KINDS", kinds)
    monkeypatch.setattr(page_turns, "WARM_S", 0.2)
    text = page.live(1, 1.0).markdown()
    assert all(name in text for name in kinds)
    assert len(page_recording.looked(0.2, 2).goals) == 2


def test_a_report_replaces_the_one_before(tmp_path: Path) -> None:
    readme = tmp_path / "README.md"
    readme.write_text("# kinegraph\n\nText.\n", encoding="utf-8")
    for reached in (3.0, 2.0):
        into_page(readme, goals([Section("Title", goals=[Goal("speed", reached, 2.5, "us")])], "About."))
    text = readme.read_text(encoding="utf-8")
    assert text.startswith("# kinegraph\n\nText.\n")
    assert (text.count(BEGIN), text.count(END)) == (1, 1)
    assert "| speed | 2 us | at most 2.5 us | yes |" in text
    assert "3 us" not in text


def test_short_numbers() -> None:
    assert [short(v) for v in (0.1234, 12.34, 123.4, 12345.0)] == ["0.123", "12.3", "123", "12345"]
