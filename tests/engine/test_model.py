"""Models: what was written is read back; a wrong, damaged or hostile file is an error that names it, and never runs or unpacks anything."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.data import bounded
from kinegraph.stream.data.model_file import ModelError, describe_input, read_model, write_model
from kinegraph.stream.errors import InputError

SPEC = StreamSpec((3,), rate_hz=100.0, channels=("x", "y", "z"), units=("m",))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "a.model.npz"
    write_model(path, "pose", {"input": describe_input(SPEC), "note": "é"}, {"w": np.arange(6.0).reshape(2, 3)})
    return path


def test_a_model_comes_back(path: Path) -> None:
    model = read_model(path, "pose")
    assert model.header["note"] == "é" and model.header["made"]
    assert (model.array("w", (2, None)) == np.arange(6.0).reshape(2, 3)).all()
    model.check_input("in", SPEC)
    assert [p.name for p in path.parent.iterdir()] == [path.name], "no draft is left"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"channels": ("x", "y", "w")}, "channels"),
        ({"units": ("mm",)}, "units"),
        ({"rate_hz": 60.0}, "100 Hz"),
        ({"rate_hz": None}, "100 Hz"),
    ],
)
def test_another_stream_is_refused(path: Path, change: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_model(path, "pose").check_input("in", SPEC.derive(**change))


def test_another_kind_shape_or_array_is_refused(path: Path) -> None:
    with pytest.raises(ModelError, match="of kind 'pose'; here one of kind 'steps'"):
        read_model(path, "steps")
    with pytest.raises(ModelError, match=r"shape \(2, 3\); it must be \(3, any\)"):
        read_model(path, "pose").array("w", (3, None))
    with pytest.raises(ModelError, match="no array 'v'"):
        read_model(path, "pose").array("v", (3,))
    with pytest.raises(ModelError, match="no such file; make a model with kinegraph motion train pose"):
        read_model(path.with_name("none"), "pose")


def test_what_is_not_plain_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="must hold numbers"):
        write_model(tmp_path / "b", "pose", {}, {"w": np.array([object()])})
    assert not list(tmp_path.iterdir())


def test_pickles_and_bombs_are_refused(tmp_path: Path) -> None:
    header = np.frombuffer(json.dumps({"kinegraph": "model", "kind": "pose", "version": 1}).encode(), np.uint8)
    np.savez(tmp_path / "pickle.npz", header=header, w=np.array([{}], dtype=object))
    with pytest.raises(ModelError, match=r"pickle\.npz"):
        read_model(tmp_path / "pickle.npz", "pose")
    with (
        zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("w.npy", "w", force_zip64=True) as entry,
    ):
        for _ in range((bounded.LEAST >> 24) + 1):
            entry.write(bytes(1 << 24))
    with pytest.raises(ModelError, match=r"bomb\.npz.* at most \d+ are unpacked"):
        read_model(tmp_path / "bomb.npz", "pose")


@given(where=st.floats(0, 1, exclude_max=True), to=st.integers(0, 255))
def test_a_damaged_byte_is_an_error_or_no_matter(
    tmp_path_factory: pytest.TempPathFactory, where: float, to: int
) -> None:
    path = tmp_path_factory.mktemp("damaged") / "a.npz"
    write_model(path, "pose", {"input": describe_input(SPEC)}, {"w": np.arange(6.0)})
    damaged = bytearray(path.read_bytes())
    damaged[int(where * len(damaged))] = to
    path.write_bytes(damaged)
    try:
        read_model(path, "pose")
    except ModelError as error:
        assert str(path) in str(error)


@pytest.mark.parametrize("number", ["1e400", "Infinity", "-Infinity", "NaN"])
def test_a_header_with_a_number_that_none_can_be_is_refused(number: str, tmp_path: Path) -> None:
    text = f'{{"kinegraph": "model", "kind": "pose", "version": 1, "parts": {number}}}'
    np.savez(tmp_path / "a.npz", header=np.frombuffer(text.encode(), np.uint8))
    with pytest.raises(ModelError, match=r"a\.npz: not a kinegraph model \(its header holds .*not a valid number"):
        read_model(tmp_path / "a.npz", "pose")


def test_as_many_arrays_as_are_allowed_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bounded, "_MANY_ARRAYS", 3)
    np.savez(tmp_path / "three.npz", a=np.ones(2), b=np.ones(3), c=np.ones(4))
    np.savez(tmp_path / "four.npz", a=np.ones(2), b=np.ones(3), c=np.ones(4), d=np.ones(5))
    assert set(bounded.arrays(tmp_path / "three.npz")) == {"a", "b", "c"}
    with pytest.raises(ValueError, match="it holds 4 arrays; at most 3 are read"):
        bounded.arrays(tmp_path / "four.npz")
