"""`kinegraph motion train pose`: from recordings of whole poses, a model of what markers do not show."""

from __future__ import annotations

from pathlib import Path as File
from typing import TYPE_CHECKING, Annotated

import typer

from kinegraph.stream.errors import KinegraphError, nearest
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    from kinegraph.operators.pose.learn import Lesson
    from kinegraph.stream.domain.skeleton import JointTree

RATE_HZ = 30.0
"""Poses closer in time than this teach nothing more."""


def pose(
    recordings: Annotated[
        list[File],
        typer.Argument(help="recordings that hold poses, or results of `kinegraph batch`", metavar="RECORDING"),
    ],
    output: Annotated[File, typer.Option("-o", "--out", help="the model to be made")] = File("pose.npz"),
    markers: Annotated[
        str, typer.Option(help="landmarks that will be seen, with commas [default: head, shoulders, ..., ankles: 13]")
    ] = "",
    centres: Annotated[int, typer.Option(min=50, max=5000, help="kernel centres: 500 take some 30 us a frame")] = 500,
    noise_mm: Annotated[
        float,
        typer.Option(
            min=0.0, max=200.0, help="how far the live markers err (deviation), after all filters; a camera's 15 or so"
        ),
    ] = 0.0,
    landmark: Annotated[
        list[str] | None,
        typer.Option(
            help="which points of a stream of markers make up a landmark, where their names do not say: hip_l=LASI,LPSI; can be given "
            "again",
            metavar="NAME=POINTS",
        ),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace a model that exists")] = False,
) -> None:
    """Learn what markers do not show of a pose: how bones are turned, where joints without a marker are.

    kinegraph files import walk.bvh -o walk.mcap --unit walk=cm; kinegraph motion train pose walk.mcap -o pose.npz

    Every stream of poses in the recordings is learned from (BVH and AMC files give one each), and every stream of markers that shows more
    of a body than the model will be given, as those of C3D files may: its pose is found by geometry. The model is for the landmarks that
    it was trained for: --markers head,wrist_l,wrist_r,... names those that a stream will have. It is used by
    operators.pose.WholePose.
    """
    import numpy as np

    from kinegraph.operators.pose.landmarks import NAMES, USUAL
    from kinegraph.operators.pose.learn import learn_pose
    from kinegraph.stream.data.model_file import write_model

    names = [name.strip() for name in markers.split(",")] if markers else list(USUAL)
    for name in names:
        if name not in NAMES:
            raise KinegraphError(f"--markers: there is no landmark {name!r}; {nearest(name, NAMES)}")
    if len(set(names)) < 5:
        raise KinegraphError(f"--markers: {len(set(names))} landmarks are too few; at least 5 are needed")
    if output.exists() and not overwrite:
        raise KinegraphError(f"{output}: exists; choose another --out, or replace it with --overwrite")
    chosen = np.array(sorted(NAMES.index(name) for name in set(names)), np.int64)
    lessons, trained_on, tree = _lessons(recordings, chosen, noise_mm / 1000.0, _given(landmark or []))
    learned = learn_pose(lessons, chosen, centres)
    header = {"landmarks": [NAMES[k] for k in chosen], "noise_mm": noise_mm, "trained_on": trained_on}
    write_model(output, "pose", header, {**learned, "landmarks": chosen, "offsets": tree.offsets})
    frames = sum(len(one.features) for one in lessons) // 2
    say(
        f"{output}: learned from {frames} poses of {len(trained_on)} streams, for {len(chosen)} landmarks, "
        f"{len(learned['centres'])} centres"
    )


def _given(landmarks: list[str]) -> dict[str, tuple[str, ...]]:
    """What --landmark says: of a landmark the points that make it up."""
    from kinegraph.operators.pose.landmarks import NAMES

    given: dict[str, tuple[str, ...]] = {}
    for one in landmarks:
        name, _, joined = one.partition("=")
        points = tuple(point.strip() for point in joined.split(",") if point.strip())
        if name not in NAMES:
            raise KinegraphError(f"--landmark: there is no landmark {name!r}; {nearest(name, NAMES)}")
        if not points:
            raise KinegraphError(f"--landmark {one}: names no points; write {name}=POINT,POINT")
        given[name] = points
    return given


def _lessons(
    recordings: list[File], chosen: object, noise_m: float, given: dict[str, tuple[str, ...]]
) -> tuple[list[Lesson], list[str], JointTree]:
    """What every stream of poses teaches, which they are, and the skeleton of the first."""
    import numpy as np

    from kinegraph.operators.pose.from_markers import solved
    from kinegraph.operators.pose.learn import lessons_of
    from kinegraph.operators.pose.upright import upright_along
    from kinegraph.stream.batch.sessions import name_of, open_session, sessions_at
    from kinegraph.stream.domain.humanoid import to_humanoid, usual_body
    from kinegraph.stream.domain.skeleton import JointTree

    lessons: list[Lesson] = []
    trained_on: list[str] = []
    refused: list[str] = []
    known: set[str] = set()
    tree: JointTree | None = None
    for path in sessions_at(recordings):
        with open_session(path) as opened:
            for name, stream in opened.streams.items():
                spec, every = stream.spec, max(1, round((stream.spec.rate_hz or RATE_HZ) / RATE_HZ))
                known.update(spec.channels)
                if "skeleton" in spec.meta and len(spec.shape) == 1:
                    rows = opened.read(name)[1][::every]
                    rows = rows[np.isfinite(rows).all(axis=1)]
                    if not len(rows):
                        continue
                    body, poses = to_humanoid(JointTree.of(spec, name), rows)
                    if axis := upright_along(body, poses, (spec.rate_hz or RATE_HZ) / every):
                        say(
                            f"{name_of(opened)}: {name}: somebody walks upright along {axis}; turn it: y must point up",
                            err=True,
                        )
                elif f"{name}.pose" not in opened.streams:
                    body, found = usual_body(), solved(spec, *opened.read(name), np.asarray(chosen), given)
                    if isinstance(found, str):
                        refused.append(f"{name_of(opened)}: {name}: {found}{_cure(found, name)}")
                    if found is None or isinstance(found, str):
                        continue
                    poses = found[::every]
                else:
                    continue
                tree = tree or body
                lessons += lessons_of(body, poses, np.asarray(chosen), noise_m)
                trained_on.append(f"{name_of(opened)}: {name}")
                say(f"{name_of(opened)}: {name}: {len(poses)} poses")
    for points in given.values():
        for point in points:
            if point not in known:
                raise KinegraphError(f"--landmark: no stream has a point {point!r}; {nearest(point, known)}")
    for one in refused:
        say(f"left out: {one}", err=True)
    if tree is None:
        raise KinegraphError(
            "no stream of poses in these recordings, and no markers that show more of a body than the model's landmarks; "
            "`kinegraph files import` makes poses of each AMC file and of each BVH file (give its --unit), and markers of C3D files"
        )
    return lessons, trained_on, tree


def _cure(why: str, name: str) -> str:
    """What could be done about it."""
    if "no unit" in why:
        return f"; import it again with --unit {name}=cm, or what they are in"
    if "names" in why or "shows no " in why:
        return "; --markers says what the model will be given, --landmark which points make up what it lacks"
    return ""
