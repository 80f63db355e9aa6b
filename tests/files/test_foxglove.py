"""`kinegraph files export --format foxglove`: MCAP as its own library reads it, every message as its JSON Schema says, every value kept."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from mcap.reader import make_reader

from kinegraph.devices.formats.table.foxglove_writer import FoxgloveWriter, keys_of
from kinegraph.stream.chunk import NS, Chunk, StreamSpec, grid

START = 1_700_000_000 * NS + 123
EVENT = np.dtype([("onset", "<i8"), ("text", "<U16"), ("share", "<f8"), ("final", "?"), ("count", "<i4")])


def written(path: Path, spec: StreamSpec, *chunks: Chunk) -> tuple[dict[str, Any], list[dict[str, Any]], list[int]]:
    """What is read back: the schema, the messages, and their log times."""
    writer = FoxgloveWriter(path)
    writer.write("board.emg", spec, chunks, lambda n: None)
    writer.close()
    with path.open("rb") as file:
        found = list(make_reader(file, validate_crcs=True).iter_messages())
    schema = json.loads(found[0][0].data)
    assert (found[0][0].encoding, found[0][1].message_encoding, found[0][1].topic) == (
        "jsonschema",
        "json",
        "board.emg",
    )
    return schema, [json.loads(message.data) for *_, message in found], [message.log_time for *_, message in found]


def test_a_signal(tmp_path: Path) -> None:
    spec = StreamSpec((2,), rate_hz=1000.0, channels=("TA left", "SO"), units=("uV",))
    time = grid(1000.0, 50, start_ns=START)
    data = np.random.default_rng(1).normal(size=(50, 2))
    data[7, 1] = np.nan
    first, rest = Chunk(time[:20], data[:20], 0), Chunk(time[20:], data[20:], 0, 3)
    schema, messages, stamps = written(tmp_path / "a.mcap", spec, first, rest)
    for message in messages:
        Draft202012Validator(schema).validate(message)
    assert stamps == time.tolist()
    assert [m["TA_left"] for m in messages] == data[:, 0].tolist()
    assert "SO" not in messages[7]
    assert [i for i, m in enumerate(messages) if m["lost"]] == [20]
    assert messages[0]["timestamp"] == {"sec": 1_700_000_000, "nsec": 123}
    assert schema["properties"]["SO"]["description"] == "SO [uV]"


def test_events(tmp_path: Path) -> None:
    spec = StreamSpec((), EVENT, units=("ns", "", "", "", ""))
    rows = np.array([(START, "a<b", 0.5, True, 3), (START + NS, "", np.inf, False, -1)], EVENT)
    schema, messages, _ = written(tmp_path / "a.mcap", spec, Chunk(np.array([START, START + 1]), rows, 0))
    for message in messages:
        Draft202012Validator(schema).validate(message)
    kept = {"onset": {"sec": 1_700_000_000, "nsec": 123}, "text": "a<b", "share": 0.5, "final": True, "count": 3}
    assert {k: v for k, v in messages[0].items() if k in kept} == kept
    assert "share" not in messages[1]


@pytest.mark.parametrize(
    ("channels", "keys"),
    [
        (("a b", "a-b", "a_b"), ["a_b", "a_b_2", "a_b_3"]),
        (("timestamp", "lost"), ["timestamp_1", "lost_2"]),
        (("µ", "1"), ["_", "1"]),
    ],
)
def test_keys_can_stand_in_a_message_path_and_differ(channels: tuple[str, ...], keys: list[str]) -> None:
    assert keys_of(StreamSpec((len(channels),), channels=channels)) == keys
