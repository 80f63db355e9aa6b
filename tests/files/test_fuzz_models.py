"""Every kind of model, fed with damaged copies: an error that names the file, or a model; never anything else.

Damage to the archive itself is nearly always found by its checksums, so every second copy is packed again after one of its arrays, or its
header, was damaged. `make fuzz` tries for longer: KINEGRAPH_FUZZ_S seconds a kind, with other seeds every day.
"""

from __future__ import annotations

import io
import os
import random
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinegraph import operators
from kinegraph.operators.emg.mixtures.emg_model import read_references, write_references
from kinegraph.operators.emg.mixtures.reference import References
from kinegraph.operators.maps.motion_graph.build import build_graph
from kinegraph.operators.pose.operator import regression_of
from kinegraph.operators.segmentation.names.taught import taught
from kinegraph.operators.steering.model.stored import from_model
from kinegraph.operators.steps.forest import StepModel
from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.data.model_file import read_model, write_model
from kinegraph.stream.domain.humanoid import BONES
from kinegraph.stream.domain.motion_graph import MotionGraph
from kinegraph.stream.domain.pose_map import MotionIndex
from kinegraph.stream.errors import KinegraphError
from tests.support.measured import MOST_S
from tests.support.motion_made import RATE, TREE, take, walking
from tests.support.mutants import SECONDS, mutant, seed_of

MUTANTS = 25
Reader = Callable[[Path], object]
SHIPPED = Path(operators.__file__).parent
FEATURES = StreamSpec((3,), rate_hz=30.0, channels=("a", "b", "c"))
MIXTURES = StreamSpec(
    (3,), meta={"normalisation": "max", "envelope": "6 Hz", "height_unit": "%", "fitting": {"circular": True}}
)


def emg(path: Path) -> Reader:
    references = References.empty(1)
    references.modes[:] = 1
    references.covariances[:, :, [0, 2]] = 1.0
    write_references(path, references, ["TA"], MIXTURES.meta, {})
    return lambda path: read_references(path, MIXTURES, ["TA"])


def exercises(path: Path) -> Reader:
    turns = np.sin(np.arange(60)[:, None] / 10 + np.arange(3))
    made = taught([("squat", [turns, turns * 1.1])], 0.3)
    made.write(path, FEATURES, "a test")
    return lambda path: type(made).read(path, "in", FEATURES)


def graph(path: Path) -> Reader:
    build_graph(TREE, [take("straight", walking(8, sway=0.1), 0)], ("straight",), RATE, 0.10, 5).write(path, {})
    return MotionGraph.read


def pose(path: Path) -> Reader:
    width = 6 * len(BONES) + 3
    arrays = {
        "landmarks": np.arange(2), "centres": np.zeros((4, 6)), "mean": np.zeros(width), "basis": np.ones((2, width)),
        "weights": np.zeros((4, 2)), "scales": np.ones(6), "regional": np.zeros((4, 3)), "ranks": np.array([0, 1, 1, 2, 2, 2]),
        "offsets": np.zeros((len(BONES), 3)),
    }  # fmt: skip
    write_model(path, "pose", {}, arrays)
    return lambda path: regression_of(read_model(path, "pose"))


def shipped(name: str, read: Reader) -> Callable[[Path], Reader]:
    def make(path: Path) -> Reader:
        path.write_bytes((SHIPPED / name).read_bytes())
        return read

    return make


SEEDS = {
    "emg": emg,
    "exercises": exercises,
    "graph": graph,
    "pose": pose,
    "map": shipped("maps/pose_map/example.npz", MotionIndex.read),
    "mesh": shipped("steering/quadruped.npz", lambda path: from_model(read_model(path, "mesh"))),
    "steps": shipped("steps/walking_manner.npz", StepModel.read),
}


def repacked(whole: bytes, chance: random.Random) -> bytes:
    """A valid archive of which one entry is damaged: its numbers, its shape, its kind of numbers, or that it is there at all."""
    with np.load(io.BytesIO(whole)) as archive:
        entries = {name: archive[name] for name in archive.files}
    name = chance.choice([*entries, *["header"] * (1 + len(entries) // 4)])
    array = entries.pop(name)
    kind = chance.choice(("bytes", "cut", "shape", "dtype", "gone", "value")) if name != "header" else "bytes"
    if kind == "bytes":
        data = mutant(array.tobytes(), chance)
        entries[name] = np.frombuffer(data[: len(data) // array.itemsize * array.itemsize], array.dtype)
        if entries[name].size == array.size:
            entries[name] = entries[name].reshape(array.shape)
    elif kind == "cut":
        entries[name] = array[: chance.randrange(len(array) + 1)] if array.ndim else array
    elif kind == "shape":
        entries[name] = array.reshape(chance.choice(((-1,), (1, -1), (-1, 1), (1, 1, -1))))
    elif kind == "dtype":
        entries[name] = array.astype(chance.choice((np.int8, np.uint64, np.float16, np.complex128, np.bool_)))
    elif kind == "value":
        entries[name] = array.astype(np.float64)
        entries[name].flat[: chance.choice((1, array.size))] = chance.choice((-1, 2**40, np.nan, np.inf, 1e308, 0.5))
    packed = io.BytesIO()
    np.savez(packed, allow_pickle=False, **entries)
    return packed.getvalue()


@pytest.mark.timeout(300 + 2 * SECONDS)
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", SEEDS)
def test_damaged_models_are_told_by_name(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"{kind}.npz"
    read = SEEDS[kind](path)
    read(path)
    whole = path.read_bytes()
    seed = seed_of(kind)
    chance, end, tried = random.Random(seed), time.monotonic() + SECONDS, 0
    while tried < MUTANTS or time.monotonic() < end:
        data = repacked(whole, chance) if tried % 2 else mutant(whole, chance)
        path.write_bytes(data)
        begun = time.process_time()
        try:
            read(path)
        except KinegraphError as error:
            assert str(path) in str(error), (seed, tried, error)
        except Exception as error:
            (Path(os.environ.get("KINEGRAPH_FUZZ_KEEP", tmp_path)) / f"failed-{kind}.npz").write_bytes(data)
            raise AssertionError(f"mutant {tried} of {seed!r}: {type(error).__name__}: {error}") from error
        assert time.process_time() - begun < MOST_S, f"mutant {tried} of {seed!r} took too long"
        tried += 1
