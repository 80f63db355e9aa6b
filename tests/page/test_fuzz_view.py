"""`kinegraph view` through its socket, of damaged recordings and of sound ones that a stranger made up: an answer to every look, or a line
that says why it is empty; never a traceback, never much memory or time.

`make fuzz` tries for longer: KINEGRAPH_FUZZ_S seconds, with other seeds every day.
"""

from __future__ import annotations

import asyncio
import json
import os
import random
import shutil
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from kinegraph.devices.page.recorded.reading import MAX_STAMP
from kinegraph.devices.page.recorded.viewing import RecordingHub
from kinegraph.devices.page.serving import PageServer
from kinegraph.devices.page.transfer.wire import decode
from kinegraph.stream.chunk import NS, StreamSpec
from kinegraph.stream.data.bounded import reading
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.manual import ANNOTATION
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.format.paths import parts_of
from kinegraph.stream.recording.series import Series, write_recording
from tests.support.measured import MOST_S
from tests.support.mutants import SECONDS, mutant, seed_of
from tests.support.page_session import needs_page

pytestmark = [needs_page, pytest.mark.timeout(300 + 2 * SECONDS)]
MUTANTS = 15
START = 1_700_000_000 * NS


def viewed(path: Path) -> list[dict[str, Any]]:
    """All that a client is sent of a recording: the headers. Raises KinegraphError where it cannot be opened."""
    with ExitStack() as stack:
        with reading(path, "a recording that can be shown"):
            hub = RecordingHub(stack.enter_context(Recording.open(path)))
        return asyncio.run(_viewed(hub))


async def _viewed(hub: RecordingHub) -> list[dict[str, Any]]:
    server = PageServer(hub, lambda: "", files={})
    found: list[dict[str, Any]] = []
    port = await server.open("127.0.0.1", 0, "")
    try:
        async with connect(f"ws://127.0.0.1:{port}/socket", max_size=None, compression=None, proxy=None) as client:
            hello = decode(await client.recv())[0]
            for whole in (False, True):
                if whole:
                    await asyncio.to_thread(hub.build, found_by(found))
                await _ask(client, hello, found)
        await hub.close()
    finally:
        await server.close()
    return [hello, *found]


def found_by(found: list[dict[str, Any]]) -> Any:
    return lambda message: found.append(decode(message)[0])


async def _ask(client: Any, hello: dict[str, Any], found: list[dict[str, Any]]) -> None:
    """Look at everything from afar, close by and past both ends, analyse every stream, and mark a moment."""
    streams, length = [*range(len(hello["streams"]))], min(hello["length_s"], 1e8)
    for number, (begin, end) in enumerate([(0, length + 1e-3), (length / 2, length / 2 + 1e-6), (-1e8, 1e8)]):
        look = {"do": "look", "streams": streams, "begin": begin, "end": end, "at": (begin + end) / 2, "points": 300}
        await client.send(json.dumps(look | {"at": begin + number * 1e-9}))
        while (header := decode(await client.recv())[0])["t"] != "looked":
            found.append(header)
    for number, stream in enumerate(hello["streams"]):
        if stream["kind"] == "signal" and stream["rate_hz"] and stream["shape"][0]:
            for what in ("spectrum", "spectrogram"):
                asked = {"do": "analyse", "stream": number, "what": what, "begin": -1.0, "end": length + 1}
                await client.send(json.dumps(asked))
                found.append(decode(await client.recv())[0])
    await client.send(json.dumps({"do": "mark", "text": "here", "at": length / 2}))
    while (header := decode(await client.recv())[0])["t"] != "events":
        found.append(header)


def tried(path: Path, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str], what: str) -> None:
    """View it; fails where anything but a reason comes of it."""
    begun = time.process_time()
    try:
        viewed(path)
    except KinegraphError as error:
        assert str(path) in str(error), (what, error)
    except (Exception, ConnectionClosed) as error:
        keep = Path(os.environ.get("KINEGRAPH_FUZZ_KEEP", path.parent))
        shutil.copy(path, keep / "failed-view.mcap")
        raise AssertionError(f"{what}: {type(error).__name__}: {error}") from error
    stderr = capsys.readouterr()
    assert "Traceback" not in stderr.out + stderr.err + caplog.text, (what, stderr, caplog.text)
    assert time.process_time() - begun < MOST_S, f"{what} took too long"


def test_damaged_recordings_are_looked_at(
    tmp_path: Path, made: Path, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = parts_of(made / "s")[0].read_bytes()
    seed = seed_of("view")
    chance, end, number = random.Random(seed), time.monotonic() + SECONDS, 0
    path = tmp_path / "x.mcap"
    while number < MUTANTS or time.monotonic() < end:
        path.write_bytes(mutant(whole, chance))
        path.with_suffix(".marks.json").unlink(missing_ok=True)
        tried(path, caplog, capsys, f"mutant {number} of {seed!r}")
        number += 1


def test_recordings_that_a_stranger_made_up_are_looked_at(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    seed = seed_of("made up")
    chance, end, number = random.Random(seed), time.monotonic() + SECONDS, 0
    while number < MUTANTS or time.monotonic() < end:
        path = tmp_path / f"{number}.mcap"
        series = [_drawn(f"s{k}", chance) for k in range(chance.randint(1, 3))]
        graph = chance.choice(("", "[" * 3000, "nodes: {s0: {use: [x]}}", "page: {panels: [{kind: avatar, of: s0}]}"))
        write_recording(path, series, {"graph": graph, "session": chance.choice(({}, {"a": [1]}))})
        tried(path, caplog, capsys, f"recording {number} of {seed!r}")
        path.unlink()
        number += 1


META: dict[str, list[Any]] = {
    "skeleton": [
        {"joints": ["a"], "parents": [7], "offsets_m": [[0, 0, 0]]},
        {"joints": ["a", "b"], "parents": [-1, 0], "offsets_m": [[0, 0, 0], []]},
        {"joints": 3, "parents": [], "offsets_m": []},
        7,
    ],
    "bones": [[[1, 2], [3]], [7], "x", {"a": 1}, [["a", None]]],
    "mesh": [{}, 7, "x", {"faces": [[0, 1, 9]]}],
    "axes": ["camera", 7],
    "columns": [-1, 0, 1 << 70, "x"],
    "encoding": ["jpeg", 7],
}


def _drawn(name: str, chance: random.Random) -> Series:
    """A stream that no one would record."""
    shape = chance.choice([(), (0,), (1,), (3,), (7,), (11,), (5000,), (2, 3), (1, 3), (0, 3), (4, 4), (2, 2, 2)])
    dtype = np.dtype(chance.choice(["<f8", "<f4", "<f2", "<i8", "|i1", "|b1", "<u2", "<c16", "|S3", "<U2"]))
    if not shape:
        dtype = chance.choice(
            (ANNOTATION, np.dtype([("onset", "<f8", (2,)), ("text", "|S2")]), np.dtype([("a", "<f4")]))
        )
    rate = chance.choice([None, None, 1e-9, 1e-3, 1.0, 1000.0, 1e9])
    meta = {key: chance.choice(values) for key, values in META.items() if chance.random() < 0.4}
    named = tuple(f"c{k}" for k in range(shape[0])) if shape and chance.random() < 0.5 else ()
    spec = StreamSpec(shape, dtype, rate, channels=named, meta=meta)
    count = chance.choice((1, 2, 5, 200))
    drawn = np.random.default_rng(chance.randrange(1 << 30))
    begin = chance.choice((START, 0, 1, -(10**18), MAX_STAMP - 10**10, MAX_STAMP + 10**10))
    steps = drawn.integers(0, chance.choice((1, 10, 10**6, 10**12, 10**16)) + 1, count)
    stamps = begin + np.cumsum(steps) * chance.choice((1, 1, 1, -1))
    raw = drawn.bytes(count * spec.sample_bytes)
    data = np.frombuffer(raw, dtype).reshape(count, *shape) if spec.sample_bytes else np.empty((count, *shape), dtype)
    if dtype.kind == "U" or "U" in str(dtype):
        data = np.zeros((count, *shape), dtype)
    return Series(name, spec, stamps.astype(np.int64), data)
