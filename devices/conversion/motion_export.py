"""`kinegraph files export` to BVH, GLB and VRM animations: one stream of poses, or of a mesh, as a file for animation programs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kinegraph.devices.formats.exporter import Export, Exporter, Written
from kinegraph.stream.chunk import NS, Array, Samples, StreamSpec, Times
from kinegraph.stream.domain.axes import BODY, Axes
from kinegraph.stream.domain.mesh import Topology
from kinegraph.stream.domain.skeleton import JointTree
from kinegraph.stream.errors import InputError, RecordingError
from kinegraph.stream.system.atomic_file import complete, private_folder

MAX_NUMBERS = 400_000_000
"""A mesh's motion is held in memory; 3 GB are too much for most."""


def takes_poses(spec: StreamSpec) -> str:
    """Why a stream cannot be exported as poses; "": it can."""
    try:
        JointTree.of(spec)
    except InputError:
        return "no stream of poses"
    return ""


def takes_motion(spec: StreamSpec) -> str:
    """Why a stream is neither poses nor a mesh; "": it is one of them."""
    return "" if "mesh" in spec.meta and len(spec.shape) == 2 else takes_poses(spec) and "neither poses nor a mesh"


def _one(wanted: Export, what: str) -> str:
    """The stream that is meant. Raises RecordingError where there are several."""
    if len(wanted.names) > 1:
        raise RecordingError(
            f"a file of this format holds one stream of {what}; there are {', '.join(wanted.names)}: choose one with --stream"
        )
    wanted.refuse_existing(wanted.place)
    private_folder(wanted.place.parent)
    return wanted.names[0]


def whole(wanted: Export, name: str) -> tuple[Times, Array, list[int]]:
    """All samples of a stream that are finite: stamps, samples, and how many are missing before each (-1: some)."""
    times, data, lost = list[Array](), list[Array](), list[int]()
    for chunk in wanted.recording.chunks(name):
        good = np.isfinite(chunk.data.reshape(len(chunk), -1)).all(axis=1) if len(chunk) else np.zeros(0, np.bool_)
        times.append(chunk.time[good])
        data.append(chunk.data[good])
        lost += [int(chunk.lost) if i == 0 else 0 for i in np.flatnonzero(good).tolist()]
        wanted.progress(len(chunk))
    if not sum(map(len, times)):
        raise RecordingError(f"stream {name!r} has no finite sample: nothing can be exported")
    return np.concatenate(times), np.concatenate(data), lost


def _bvh(wanted: Export) -> list[Written]:
    from kinegraph.devices.formats.bvh.writer import COUNT, bvh_head, bvh_rows

    name = _one(wanted, "poses")
    spec = wanted.recording.streams[name].spec
    if not spec.rate_hz:
        raise RecordingError(f"stream {name!r} is irregular; BVH has one time between all its frames")
    tree = JointTree.of(spec)
    times, poses, _ = whole(wanted, name)
    head, at = bvh_head(tree, spec.rate_hz)
    with complete(wanted.place) as draft, draft.open("w", encoding="ascii", errors="replace", newline="\n") as file:
        rows = np.concatenate(list(_on_grid(times, poses, spec.rate_hz)))
        file.write(f"{head[:at]}{len(rows):{COUNT}d}{head[at + COUNT :]}{bvh_rows(tree, rows)}")
    return [(name, wanted.place, len(rows))]


def _on_grid(times: Times, poses: Samples, rate_hz: float) -> Iterator[Samples]:
    """The poses, each again where the next ones are missing: BVH frames have no times of their own."""
    yield poses[:1]
    steps = np.maximum(1, np.rint(np.diff(times) * rate_hz / NS)).astype(np.int64)
    for k, step in enumerate(steps.tolist()):
        if step > 1:
            yield np.repeat(poses[k : k + 1], step - 1, axis=0)
        yield poses[k + 1 : k + 2]


def _glb(wanted: Export) -> list[Written]:
    from kinegraph.devices.formats.gltf.writer import write_mesh, write_skeleton

    name = _one(wanted, "poses or vertices")
    stream = wanted.recording.streams[name]
    if stream.samples * int(np.prod(stream.spec.shape)) > MAX_NUMBERS:
        raise RecordingError(f"stream {name!r} has {stream.samples} samples: too many for one GLB file; cut it first")
    times, data, _ = whole(wanted, name)
    seconds = (times - times[0]) / NS
    with complete(wanted.place) as draft:
        if "mesh" in stream.spec.meta:
            mesh = Topology.of(stream.spec)
            columns, signs = (Axes.of(stream.spec) or BODY).to(BODY)
            write_mesh(draft, mesh.faces, seconds, data[..., columns].astype(np.float64) * signs, mesh.name or name)
        else:
            write_skeleton(draft, JointTree.of(stream.spec), seconds, data, name)
    return [(name, wanted.place, len(times))]


def _vrma(wanted: Export) -> list[Written]:
    from kinegraph.devices.formats.gltf.writer import write_vrm_animation
    from kinegraph.stream.domain.humanoid import BONES, to_humanoid
    from kinegraph.stream.errors import KinegraphError

    name = _one(wanted, "poses")
    times, poses, _ = whole(wanted, name)
    body = JointTree.of(wanted.recording.streams[name].spec)
    if body.joints != BONES:
        try:
            body, poses = to_humanoid(body, poses)
        except KinegraphError as error:
            raise RecordingError(f"stream {name!r}: {error}") from None
    with complete(wanted.place) as draft:
        write_vrm_animation(draft, (times - times[0]) / NS, body, poses)
    return [(name, wanted.place, len(times))]


BVH = Exporter("one stream of poses as BVH, in cm", ".bvh", _bvh, takes_poses)
GLB = Exporter("one stream of poses or of a mesh as binary glTF", ".glb", _glb, takes_motion)
VRMA = Exporter("one stream of poses as a VRM animation (VRMC_vrm_animation)", ".vrma", _vrma, takes_poses)
