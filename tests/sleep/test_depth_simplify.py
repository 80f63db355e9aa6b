"""Simplification: against a plain PCA of the same blocks, block by block; what is finer than a block is gone, in a session's files too."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.pictures import face
from kinegraph.operators.bed.frames.blocks import left_over
from kinegraph.operators.bed.frames.simplify import Simplify
from kinegraph.stream.chunk import NS, Array, Chunk
from kinegraph.stream.engine.session import Session
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.operator import grid
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.format.checkpoint import Checkpoint
from tests.sleep.depth_frames import Faces, blocks_spec, finer, frames_spec, in_blocks, play

RAW = frames_spec(48, 64, simplified=False)


def scene(count: int, *, vertical: bool = False, seed: int = 0) -> Array:
    """A bed's edge and slopes, noise, and invalid pixels that flicker."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[0:48, 0:64]
    depth = np.where((x if vertical else y) % 19 < 7, 2000.0, 1700.0) + (4.0 * y if vertical else 3.0 * x)
    frames = depth + random.normal(0, 4, (count, 48, 64))
    frames[random.random(frames.shape) < 0.1] = 0
    frames[:, 8:16, 16:24][:, :5] = 0
    return frames.astype(np.uint16)


def filled(frames: Array) -> Array:
    """(n, rows, columns, 64): blocks with invalid pixels at the mean of the valid ones."""
    cut = in_blocks(frames).astype(float)
    valid = cut > 0
    means = cut.sum(axis=-1) / np.maximum(valid.sum(axis=-1), 1)
    return np.where(valid, cut, means[..., None])


def test_with_one_component_a_block_is_its_mean_and_pixels_without_measurement_leave_no_trace() -> None:
    frames = scene(20)
    made = play(Simplify(), **{"in": (RAW, grid(30.0, 20), frames)})
    seen = (in_blocks(frames) > 0).mean(axis=-1) >= 0.5
    means = np.where(seen, filled(frames).mean(axis=-1), np.nan)
    assert not seen.all() and seen.mean() > 0.9
    whole = (in_blocks(frames) > 0).all(axis=-1)
    assert np.array_equal(np.isnan(made["blocks"]), ~seen) and np.allclose(made["blocks"][whole], means[whole])
    assert np.nanmax(abs(made["blocks"] - means)) < 12, "the level of the middle: some pixels of a slope are missing"
    assert np.array_equal(in_blocks(made["out"])[..., 0], np.where(seen, np.floor(means + 0.5), 0))
    assert finer(made["out"]) == 0 and not len(made["scene"])


@pytest.mark.parametrize("components", [2, 5])
def test_the_basis_holds_as_much_as_a_pca_of_all_blocks(components: int) -> None:
    frames = scene(150)
    operator = Simplify(components=components, learn_s=1.0)
    operator.open({"in": RAW})
    time = grid(30.0, 150)
    made = operator.process("in", Chunk(time, frames, int(time[-1])))
    scenes, out = made[0][1].data, made[1][1].data
    assert [event["what"] for event in scenes] == ["learned"] and scenes["onset"][0] == time[94]
    blocks = filled(frames[:31])[(in_blocks(frames[:31]) > 0).mean(axis=-1) >= 0.5]
    within = np.cov(blocks - blocks.mean(axis=1, keepdims=True), rowvar=False, bias=True)
    best = np.linalg.eigh(within)[0][: 64 - (components - 1)].sum()
    ours = operator.state.vectors
    assert np.allclose(ours @ ours.T, np.eye(components), atol=1e-9)
    assert left_over(np.ascontiguousarray(within), np.ascontiguousarray(ours)) < 1.02 * best
    last = filled(frames[-1:])[0]
    centre = operator.state.centre[:, :8].reshape(64)
    expected = last.mean(axis=-1, keepdims=True) + centre + (last - centre) @ ours[1:].T @ ours[1:]
    seen = (in_blocks(frames[-1]) > 0).mean(axis=-1) >= 0.5
    assert np.abs(in_blocks(out[-1])[seen] - expected[seen]).max() < 0.51
    assert finer(out[:94]) == 0, "before a basis is learned there are means"


def test_a_changed_scene_is_learned_again_and_an_unchanged_one_is_not() -> None:
    frames = np.concatenate([scene(300), scene(400, vertical=True, seed=1)])
    time = grid(30.0, 700)
    made = play(Simplify(components=2, learn_s=1.0), **{"in": (RAW, time, frames)})["scene"]
    assert made["what"].tolist() == ["learned", "relearned"]
    assert time[300] < made["onset"][1] <= time[300] + 8 * NS, "within two stretches and their searches"


@pytest.mark.parametrize("components", [1, 2])
def test_grey_and_infrared_images_are_simplified_as_depth_is_and_black_is_a_grey(components: int) -> None:
    random = np.random.default_rng(3)
    y, x = np.mgrid[0:48, 0:64]
    images = np.where(y % 19 < 7, 140.0, 40.0) + x + random.normal(0, 9, (150, 48, 64))
    images = np.clip(images, 0, 255).astype(np.uint8)
    images[:, :8, :8] = 0
    images[:, :8, 8:16] = 255
    spec = RAW.derive(dtype=np.dtype(np.uint8), units=())
    made = play(Simplify(components=components, learn_s=1.0), **{"in": (spec, grid(30.0, 150), images)})
    out, means = made["out"], in_blocks(images).mean(axis=-1)
    assert out.dtype == np.uint8 and np.allclose(made["blocks"], means)
    assert np.array_equal(in_blocks(out[:90])[..., 0], np.floor(means[:90] + 0.5)) and finer(out[:90]) == 0
    assert not out[:90, :8, :8].any() and (out[:90, :8, 8:16] == 255).all()
    assert made["scene"]["what"].tolist() == ["learned"] * (components > 1)
    left = np.square(in_blocks(images[-1:]) - in_blocks(out[-1:]).astype(float)).mean()
    mean_left = np.square(in_blocks(images[-1:]) - means[-1:, ..., None]).mean()
    assert left < 0.75 * mean_left if components > 1 else abs(left - mean_left) < 1.0


def test_what_cannot_be_simplified_is_refused() -> None:
    with pytest.raises(InputError, match="grey or infrared images"):
        Simplify().open({"in": RAW.derive(shape=(48, 64, 3), dtype=np.dtype(np.uint8))})
    with pytest.raises(ParameterError, match="block is 9; it must be a divisor of both 48 and 64: 2, 4, 8, 16"):
        Simplify(block=9).open({"in": RAW})
    with pytest.raises(ParameterError, match="at most 4"):
        Simplify(block=2, components=5).open({"in": RAW})
    with pytest.raises(InputError, match="depth frames"):
        Simplify().open({"in": blocks_spec(6, 8)})


# nothing finer than a block is stored or sent ------------------------------------------------------------------------

GRAPH = """
record: [simplify, simplify.blocks, motion, motion.map, presence.height]
checkpoint_s: 0.1
nodes:
  camera: {use: depth_frames.Faces}
  simplify: {use: operators.bed.frames.simplify.Simplify, from: camera}
  bed: {use: operators.bed.bed.BedRegion, from: simplify.blocks, regions: [[0, 0, 48, 64]]}
  presence: {use: operators.bed.presence.Presence, from: {regions: bed, blocks: simplify.blocks}}
  motion: {use: operators.bed.motion.Motion, from: {scene: simplify.scene, regions: bed, frames: simplify}, epoch_s: 1.0}
"""


def test_a_face_sized_relief_has_no_detail_in_anything_that_a_session_stores(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    relief = face(48, 64, 24, 32)
    assert finer(relief) > 0.1 * float(((relief - relief.mean()) ** 2).sum()), "it has such detail"
    graph = load_text(GRAPH, path=str(Path(__file__).parent / "graph.yaml"))
    saved: list[Checkpoint] = []
    save = Checkpoint.save
    monkeypatch.setattr(Checkpoint, "save", lambda self, folder: (saved.append(self), save(self, folder))[1])
    outcome = Session(graph, tmp_path / "night").run()
    assert outcome.error is None
    raw = Faces().frames()
    with Recording.open(tmp_path / "night") as recording:
        assert recording.streams["camera"].samples == len(raw) == recording.streams["simplify"].samples
        assert finer(recording.read("simplify")[1]) == 0
        assert (
            recording.read("simplify.blocks")[1].shape[1:] == recording.read("motion.map")[1]["map"].shape[1:] == (6, 8)
        )
    row = raw[:, 22, 22:42]
    arrays = list(saved[-1].arrays.values())
    frames = [a for a in arrays if a.shape[-2:] == (48, 64)]
    assert len(frames) >= 3 and all(finer(a) == 0 for a in frames)
    for array in arrays:
        assert not any(line.tobytes() in array.tobytes() for line in row)
        assert not any(line.astype(kind).tobytes() in array.tobytes() for line in row for kind in (float, np.float32))
    for path in (tmp_path / "night").iterdir():
        stored = path.read_bytes()
        assert not any(line.tobytes() in stored for line in row), path.name
