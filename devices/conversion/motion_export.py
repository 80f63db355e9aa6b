"""`kinegraph files export` to BVH, GLB and VRM animations: poses with hands and face, or a mesh, as a file for animation programs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kinegraph.devices.formats.exporter import Export, Exporter, Written
from kinegraph.stream.chunk import NS, Array, Samples, StreamSpec, Times
from kinegraph.stream.domain.axes import BODY, Axes
from kinegraph.stream.domain.humanoid import BONES, to_humanoid
from kinegraph.stream.domain.mesh import Topology
from kinegraph.stream.domain.performance import Performance, is_face, is_fingers
from kinegraph.stream.domain.skeleton import JointTree
from kinegraph.stream.errors import InputError, KinegraphError, RecordingError
from kinegraph.stream.system.atomic_file import complete, private_folder

MAX_NUMBERS = 400_000_000
"""A mesh's motion is held in memory; 3 GB are too much for most."""


def takes_poses(spec: StreamSpec) -> str:
    """Why a stream is no part of what a body, its hands and its face do; "": it is one."""
    if is_fingers(spec) or is_face(spec):
        return ""
    try:
        JointTree.of(spec)
    except InputError:
        return "no stream of poses"
    return ""


def takes_motion(spec: StreamSpec) -> str:
    """Why a stream is neither poses nor a mesh; "": it is one of them."""
    return "" if _is_mesh(spec) else takes_poses(spec) and "neither poses nor a mesh"


def takes_bones(spec: StreamSpec) -> str:
    """Why a stream has no place in a file of bones alone; "": it has one."""
    return "BVH has no expressions" if is_face(spec) else takes_poses(spec)


def _is_mesh(spec: StreamSpec) -> bool:
    return "mesh" in spec.meta and len(spec.shape) == 2


@dataclass(frozen=True, slots=True)
class Meant:
    """The streams of a file: poses or a mesh; fingers and face beside them; "": left out."""

    body: str
    fingers: str
    face: str


def _meant(wanted: Export, what: str) -> Meant:
    """The streams that are meant. Raises RecordingError where there are several of a kind, or fingers and a face alone."""
    specs = {name: wanted.recording.streams[name].spec for name in wanted.names}
    fingers = [name for name, spec in specs.items() if is_fingers(spec)]
    face = [name for name, spec in specs.items() if is_face(spec)]
    bodies = [name for name in specs if name not in (*fingers, *face)]
    for some, kind in ((bodies, what), (fingers, "fingers"), (face, "a face")):
        if len(some) > 1:
            chosen = " ".join(f"--stream {one[0]}" for one in (bodies, fingers, face) if one)
            raise RecordingError(
                f"a file of this format holds one stream of {kind}; there are {', '.join(some)}: choose, as with {chosen}"
            )
    if not bodies:
        raise RecordingError(f"{', '.join((*fingers, *face))}: needs a stream of {what} beside it")
    wanted.refuse_existing(wanted.place)
    private_folder(wanted.place.parent)
    return Meant(bodies[0], fingers[0] if fingers else "", face[0] if face else "")


def _performance(wanted: Export, meant: Meant, *, humanoid: bool = False) -> tuple[Times, Performance]:
    """Stamps of the poses, and what is done. Raises RecordingError."""
    times, poses, _ = whole(wanted, meant.body)
    tree = JointTree.of(wanted.recording.streams[meant.body].spec)
    fingers = whole(wanted, meant.fingers)[:2] if meant.fingers else None
    face = None
    if meant.face:
        face = (wanted.recording.streams[meant.face].spec.channels, *whole(wanted, meant.face)[:2])
    try:
        if humanoid and tree.joints != BONES:
            tree, poses = to_humanoid(tree, poses)
        return times, Performance.joined(tree, times, poses, fingers, face)
    except KinegraphError as error:
        raise RecordingError(f"stream {meant.body!r}: {error}") from None


def _written(wanted: Export, meant: Meant, rows: int) -> list[Written]:
    return [(name, wanted.place, rows) for name in (meant.body, meant.fingers, meant.face) if name]


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

    meant = _meant(wanted, "poses")
    spec = wanted.recording.streams[meant.body].spec
    if not spec.rate_hz:
        raise RecordingError(f"stream {meant.body!r} is irregular; BVH has one time between all its frames")
    times, played = _performance(wanted, meant)
    head, at = bvh_head(played.tree, spec.rate_hz)
    with complete(wanted.place) as draft, draft.open("w", encoding="ascii", errors="replace", newline="\n") as file:
        rows = np.concatenate(list(_on_grid(times, played.poses, spec.rate_hz)))
        file.write(f"{head[:at]}{len(rows):{COUNT}d}{head[at + COUNT :]}{bvh_rows(played.tree, rows)}")
    return _written(wanted, meant, len(rows))


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

    meant = _meant(wanted, "poses or vertices")
    stream = wanted.recording.streams[meant.body]
    if stream.samples * int(np.prod(stream.spec.shape)) > MAX_NUMBERS:
        raise RecordingError(
            f"stream {meant.body!r} has {stream.samples} samples: too many for one GLB file; cut it first"
        )
    if _is_mesh(stream.spec):
        times, data, _ = whole(wanted, meant.body)
        mesh = Topology.of(stream.spec)
        columns, signs = (Axes.of(stream.spec) or BODY).to(BODY)
        vertices, seconds = data[..., columns].astype(np.float64) * signs, (times - times[0]) / NS
        with complete(wanted.place) as draft:
            write_mesh(draft, mesh.faces, seconds, vertices, mesh.name or meant.body)
        return [(meant.body, wanted.place, len(times))]
    times, played = _performance(wanted, meant)
    with complete(wanted.place) as draft:
        write_skeleton(draft, played, meant.body)
    return _written(wanted, meant, len(times))


def _vrma(wanted: Export) -> list[Written]:
    from kinegraph.devices.formats.gltf.writer import write_vrm_animation

    meant = _meant(wanted, "poses")
    times, played = _performance(wanted, meant, humanoid=True)
    with complete(wanted.place) as draft:
        write_vrm_animation(draft, played)
    return _written(wanted, meant, len(times))


BVH = Exporter("one stream of poses, and of fingers, as BVH, in cm", ".bvh", _bvh, takes_bones)
GLB = Exporter("one stream of poses, of fingers and a face, or of a mesh as binary glTF", ".glb", _glb, takes_motion)
VRMA = Exporter(
    "one stream of poses, of fingers and a face as a VRM animation (VRMC_vrm_animation)", ".vrma", _vrma, takes_poses
)
