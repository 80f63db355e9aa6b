"""Careless senders over a real LSL, in one session: what each claims and does not keep is a finding, and a clean one gives none."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.lsl.network import library
from kinegraph.stream.domain.finding import recorded_findings
from kinegraph.stream.engine.session import Session
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording

SECONDS = 16.0
SENDERS: dict[str, tuple[float, float, Callable[[float], float], tuple[str, ...]]] = {
    # declared and sent rate, what is added to a stamp by the seconds since somebody listens, the kind of finding
    "clean": (250.0, 250.0, lambda s: 0.0, ()),
    "half": (250.0, 125.0, lambda s: 0.0, ("rate",)),
    "near": (256.0, 250.0, lambda s: 0.0, ("rate",)),
    "unix": (100.0, 100.0, lambda s: 1.7e9, ("epoch",)),
    "back": (100.0, 100.0, lambda s: -20.0 if s > 6 else 0.0, ("epoch", "order")),
}


@contextmanager
def sending(lsl: Any) -> Iterator[None]:
    """All senders, each with blocks of a tenth of a second and even stamps of its own."""
    outlets = {
        name: lsl.StreamOutlet(lsl.StreamInfo(f"claims {name}", "EEG", 2, d, "float32", f"claims {name}"))
        for name, (d, *_) in SENDERS.items()
    }
    stop, began = threading.Event(), lsl.local_clock()
    rng = np.random.default_rng(0)

    def run() -> None:
        made, heard = dict.fromkeys(SENDERS, 0), dict[str, float]()
        while not stop.wait(0.1):
            for name, (_, sent, moved, _) in SENDERS.items():
                now = lsl.local_clock() - began
                until = int(now * sent)
                if outlets[name].have_consumers():
                    heard.setdefault(name, now)
                for i in range(made[name], until):
                    outlets[name].push_sample(
                        rng.normal(0, 30, 2), began + i / sent + moved(i / sent - heard.get(name, now))
                    )
                made[name] = until

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


@pytest.mark.nightly
def test_careless_senders_are_found_out_and_clean_ones_are_not(tmp_path: Path) -> None:
    lsl = library()
    nodes = "".join(
        f"  {name}: {{use: devices.lsl.LslInlet, name: claims {name}, channels: 2, rate_hz: {declared}, unit: uV}}\n"
        for name, (declared, *_) in SENDERS.items()
    )
    with sending(lsl):
        outcome = Session(load_text(f"nodes:\n{nodes}"), tmp_path / "s", duration_s=SECONDS).run()
    assert outcome.exit_code == 0, outcome.error
    with Recording.open(tmp_path / "s") as recording:
        found = recorded_findings(recording)
        by_node = {
            name: {e["what"] for e in recording.log if e["kind"] == "finding" and e["node"] == name} for name in SENDERS
        }
        assert by_node == {name: {*kinds} for name, (*_, kinds) in SENDERS.items()}, [f.text for f in found]
        time_ = recording.read("back")[0]
        steps = np.diff(time_) / 1e9
        assert steps.min() >= 0 and np.median(steps) == pytest.approx(0.01, abs=1e-4), "stamps keep their pace"
    assert abs(time.time() - time_[-1] / 1e9) < 10, "and follow the arrival"
    row = outcome.table["half"]["findings"]
    assert "claims 250 Hz; seen: 125" in row
