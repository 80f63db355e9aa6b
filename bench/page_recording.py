"""A long recording on the page: how soon it is open, with and without the recorder's overview, and how long a look at it takes."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from websockets.sync.client import connect

from bench.page_session import BOARD, CHANNELS, HOUSE, PATIENCE_S, RATE_HZ
from bench.report import Goal, Section, short
from kinegraph.devices.page.recorded.pyramid import Pyramid
from kinegraph.devices.page.recorded.viewing import RecordingHub
from kinegraph.devices.page.transfer.wire import Look, decode
from kinegraph.stream.chunk import NS, Chunk, StreamSpec, grid
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.recording import Recorder, Recording

LOOK = {"do": "look", "streams": [0], "begin": 0, "end": 10, "at": 5, "points": 1000}


def recorded(path: Path, minutes: float) -> None:
    """A recording of 16 channels at 2000 Hz: an offset that wanders, and noise of a converter's steps."""
    recorder = Recorder(path, {"graph": ""}, RecordingOptions(), wait=True)
    spec = StreamSpec((CHANNELS,), np.dtype("<f4"), float(RATE_HZ), channels=BOARD.channels, units=("uV",))
    number = recorder.add_stream("board", spec, "input")
    noise = np.random.default_rng(1).integers(-40, 40, (RATE_HZ, CHANNELS)).astype(np.float32)
    for second in range(round(60 * minutes)):
        time_ns = grid(RATE_HZ, RATE_HZ, start_ns=second * NS)
        chunk = Chunk(time_ns, noise + np.float32(50 * np.sin(second / 100)), int(time_ns[-1]))
        recorder.write(number, chunk, int(time_ns[-1]), second)
    recorder.close()
    recorder.check()


def looked(minutes: float, scrubs: int) -> Section:
    """How soon a recording can be looked at, with and without the recorder's overview, and how long a look takes."""
    rows, opened, first = [], {}, {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "s"
        recorded(path, minutes)
        for name in ("overview", "none"):
            began = time.monotonic()
            with Recording.open(path) as recording:
                hub = RecordingHub(recording)
                hub.seen(0, Look([0], 0.0, 10.0, 5.0, 1000))
                first[name] = time.monotonic() - began
                if name == "overview":
                    hub.build(lambda message: None)
                else:
                    source = recording.streams["board"]
                    hub.pyramids[0] = Pyramid(source.spec, source.first or 0, source.last or 0)
                    hub.pyramids[0].build(recording.chunks("board"), lambda share: None)
                opened[name] = time.monotonic() - began
                rows.append([f"opened, {name}", short(1000 * first[name]), short(1000 * opened[name])])
                if name == "overview":
                    rows += scrubbed(hub, minutes, scrubs)
        rows.append(["`kinegraph view`, from its start to a client's first picture", short(1000 * begun(path)), ""])
    what = f"page: {minutes:g} min of 16 channels at 2000 Hz"
    goals = [
        Goal(f"{what}, opened", opened["overview"], 2.0, "s"),
        Goal(f"{what} without an overview, first picture", first["none"], 2.0, "s"),
    ]
    return Section(
        f"A recording of {minutes:g} min",
        ["", "first picture ms; a look's p50", "whole ms; a look's p99"],
        rows,
        goals=goals,
    )


def begun(path: Path) -> float:
    """How long it takes from the command to the first picture at a headless client (s)."""
    began = time.monotonic()
    command = [sys.executable, "-m", "kinegraph", "view", str(path), "--page-at", ":0", "--no-token"]
    with subprocess.Popen(command, cwd=HOUSE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stderr
            port = next(found[1] for line in process.stderr if (found := re.search(r"page: http://[^:]+:(\d+)/", line)))
            with connect(f"ws://127.0.0.1:{port}/socket", max_size=None, compression=None) as client:
                client.recv(timeout=PATIENCE_S)
                client.send(json.dumps(LOOK))
                while decode(client.recv(timeout=PATIENCE_S, decode=False))[0]["t"] != "signal":
                    pass
                return time.monotonic() - began
        finally:
            process.terminate()


def scrubbed(hub: RecordingHub, minutes: float, scrubs: int) -> list[list[str]]:
    """Looks at random moments, by how much is looked at."""
    rng, rows = np.random.default_rng(1), []
    for span in (1.0, 10.0, 60.0, 600.0):
        took = []
        for at in rng.uniform(0, 60 * minutes, scrubs):
            began = time.perf_counter()
            hub.seen(0, Look([0], at - span / 2, at + span / 2, at, 1000))
            took.append(1000 * (time.perf_counter() - began))
        rows.append(
            [f"a look at {span:g} s", short(float(np.percentile(took, 50))), short(float(np.percentile(took, 99)))]
        )
    return rows
