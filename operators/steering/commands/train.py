"""`kinegraph train mesh`: from a recording of a moving mesh, a model that moves it with a few markers."""

from __future__ import annotations

from pathlib import Path as File
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stream.errors import KinegraphError, nearest
from stream.plain import say

if TYPE_CHECKING:
    from stream.chunk import Samples
    from stream.mesh import Topology

MOST_FRAMES = 400


def mesh(
    recordings: Annotated[
        list[File],
        typer.Argument(help="recordings of one mesh, or results of `kinegraph batch`", metavar="RECORDING..."),
    ],
    markers: Annotated[File, typer.Option(help="YAML: which vertex each marker stands for; see below")],
    output: Annotated[File, typer.Option("-o", "--out", help="the model to be made")] = File("mesh.npz"),
    parts: Annotated[int, typer.Option(min=1, max=100, help="near-rigid parts, at most")] = 14,
    modes: Annotated[int, typer.Option(min=0, max=20, help="how each part's shape may change")] = 4,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace a model that exists")] = False,
) -> None:
    """Learn how a mesh moves with a few of its vertices (thesis, chapter 9). The file of markers says

    markers: {hoof_fl: 3215, hoof_fr: 1120, withers: 77, croup: 912}   # names of the live markers, numbers of vertices

    reference: [withers, croup]       # where the mesh is: the mean of these

    limbs: [hoof_fl, hoof_fr]         # optional: parts nearest to these follow them alone

    The model is used by operators.steering.operator.SteerMesh.
    """
    from operators.steering.fit import fit_steering
    from operators.steering.stored import KIND, to_arrays
    from stream.model import write_model

    if output.exists() and not overwrite:
        raise KinegraphError(f"{output}: exists; choose another --out, or replace it with --overwrite")
    frames, topology = _frames(recordings)
    said = _markers(markers, topology.vertices)
    say(f"{len(frames)} frames of {topology.vertices} vertices; learning ...")
    model = fit_steering(frames, topology.faces, said["markers"], said["reference"], said["limbs"], parts, modes)
    header, arrays = to_arrays(model, topology, tuple(said["limbs"]))
    write_model(output, KIND, {**header, "trained_on": [path.name for path in recordings]}, arrays)
    say(f"{output}: {len(model.parts)} parts, {len(model.markers)} markers")
    for k, part in enumerate(model.parts):
        alone = model.markers[int(part.features[0]) // 3] if len(part.features) == 3 else "all markers"
        say(
            f"  part {k}: {len(part.vertices)} vertices, by {alone}, width {part.learned.width:g}, ridge {part.learned.ridge:g}"
        )


def _frames(recordings: list[File]) -> tuple[Samples, Topology]:
    """All frames of the one mesh that the recordings hold."""
    import numpy as np

    from stream.batch.sessions import open_session, sessions_at
    from stream.mesh import Topology

    found: list[Any] = []
    mesh: Topology | None = None
    for path in sessions_at(recordings):
        with open_session(path) as opened:
            for name, stream in opened.streams.items():
                if "mesh" in stream.spec.meta:
                    other = Topology.of(stream.spec, name)
                    if mesh and mesh.hash != other.hash:
                        raise KinegraphError(
                            f"{path}: {name} is another mesh than the one before ({other.hash}, {mesh.hash})"
                        )
                    mesh = other
                    found.append(np.asarray(opened.read(name)[1], np.float64))
    if mesh is None:
        raise KinegraphError(
            "no stream of a mesh in these recordings; `kinegraph import` makes one of a mesh sequence (.npz)"
        )
    frames = np.concatenate(found)
    frames = frames[np.isfinite(frames).all(axis=(1, 2))]
    if len(frames) < 2:
        raise KinegraphError(
            f"{len(frames)} frames of the mesh are finite; at least 2 are needed to learn how it moves"
        )
    if len(frames) > MOST_FRAMES:
        frames = frames[np.linspace(0, len(frames) - 1, MOST_FRAMES).astype(int)]
    return frames, mesh


def _markers(path: File, vertices: int) -> dict[str, Any]:
    """What the file of markers says, checked against the mesh."""
    from stream.graph.yaml_lines import parse

    try:
        said = parse(path.read_text(encoding="utf-8"), str(path)).plain()
    except OSError as error:
        raise KinegraphError(f"{path}: cannot be read: {error.strerror}") from None
    if not isinstance(said, dict) or not isinstance(said.get("markers"), dict) or not said["markers"]:
        raise KinegraphError(f"{path}: must hold `markers:`, a mapping of names to numbers of vertices")
    for name, vertex in said["markers"].items():
        if not isinstance(vertex, int) or isinstance(vertex, bool) or not 0 <= vertex < vertices:
            raise KinegraphError(f"{path}: markers.{name} is {vertex!r}; the mesh has vertices 0 to {vertices - 1}")
    for key in ("reference", "limbs"):
        said.setdefault(key, [])
        for name in said[key]:
            if name not in said["markers"]:
                raise KinegraphError(
                    f"{path}: {key}: there is no marker {name!r}; {nearest(str(name), said['markers'])}"
                )
    if not said["reference"]:
        said["reference"] = [name for name in said["markers"] if name not in said["limbs"]] or list(said["markers"])
    return said
