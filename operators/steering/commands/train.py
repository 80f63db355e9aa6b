"""`kinegraph motion train steering`: from a recording of a moving mesh, a model that moves it with a few markers."""

from __future__ import annotations

from pathlib import Path as File
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinegraph.operators.commands.marker_file import marker_file
from kinegraph.stream.errors import KinegraphError, nearest
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    from kinegraph.operators.steering.model.choose import Method
    from kinegraph.operators.steering.model.fit import PoseRegression, Steering
    from kinegraph.operators.steering.model.pose_parameters import MarkerGraph
    from kinegraph.operators.steering.model.soft import MarkerPull
    from kinegraph.stream.chunk import Samples
    from kinegraph.stream.domain.axes import Axes
    from kinegraph.stream.domain.mesh import Topology

MAX_FRAMES, STEEP = 400, 0.9
"""Most frames taken of a longer recording. A heading steeper than the second (sine of its angle to the ground) does not count."""
LISTS = ("reference", "limbs", "heading")
"""What a file of markers may say beside `markers`: lists of some of them."""
KEYS = ("markers", *LISTS, "performer")
ASSEMBLIES = {"alignment": ("placed", "greedy"), "shapes": ("predicted", "optimised"), "blend": ("borders", "shared")}
"""How parts come to fit one another; the first of each is the default."""


def steering(
    recordings: Annotated[
        list[File],
        typer.Argument(help="recordings of one mesh, or results of `kinegraph batch`", metavar="RECORDING"),
    ],
    markers: Annotated[File, typer.Option(help="YAML: which vertex each marker stands for; see below")],
    output: Annotated[File, typer.Option("-o", "--out", help="the model to be made")] = File("mesh.npz"),
    parts: Annotated[int, typer.Option(min=1, max=100, help="near-rigid parts, at most")] = 14,
    part_error: Annotated[
        float,
        typer.Option(
            min=0.0,
            help="the fewest parts, at most --parts, that leave at most this error, in percent of the mesh's diagonal, where each only "
            "turns and shifts; 0: --parts of them",
        ),
    ] = 0.0,
    modes: Annotated[int, typer.Option(min=0, max=20, help="how each part's shape may change")] = 4,
    method: Annotated[
        str,
        typer.Option(
            help="parts, straight (from markers to vertices), both (their mean), or local (straight, each region as seen from the markers "
            "near it) [default: what predicts frames left out best]"
        ),
    ] = "",
    pose: Annotated[
        str,
        typer.Option(
            help="what tells the pose: positions of markers, angles (and lengths between them, as in the thesis), or directions "
            "(the same, and where each marker goes)"
        ),
    ] = "positions",
    regression: Annotated[str, typer.Option(help="kernel, or linear as in the thesis")] = "kernel",
    skeleton: Annotated[
        bool,
        typer.Option("--skeleton", help="parts are linked by joints and turned by quaternions, as in the thesis"),
    ] = False,
    alignment: Annotated[
        str,
        typer.Option(
            help="placed (each part by its own regression), or greedy: each next part against those already placed, by their border, as in "
            "the thesis"
        ),
    ] = "placed",
    shapes: Annotated[
        str,
        typer.Option(
            help="predicted, or optimised: moved against neighbouring parts and markers, as in the thesis (9.14)"
        ),
    ] = "predicted",
    blend: Annotated[
        str,
        typer.Option(
            help="borders, or shared: a part that several limbs share follows each of them, and is blended, as in the thesis (9.16)"
        ),
    ] = "borders",
    performer: Annotated[
        File | None,
        typer.Option(help="a recording of the one who will steer: markers of the same names, on another body"),
    ] = None,
    ranges: Annotated[
        str,
        typer.Option(
            help="with --performer: ranges of motion are made equal of positions (each marker's axes), or, as in the thesis, of the graph "
            "of markers (angles and lengths; places by inverse kinematics)"
        ),
    ] = "positions",
    pairing: Annotated[
        str,
        typer.Option(
            help="with --performer: a limb's frames are paired by place and swing (nearest), or by the swing alone, as the thesis prints "
            "it (swing; 9.9)"
        ),
    ] = "nearest",
    report: Annotated[
        File | None, typer.Option(help="a page (.html) with pictures: parts, each vertex's error, shape modes")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace a model or a report that exists")] = False,
) -> None:
    """Learn how a mesh moves with a few of its vertices (thesis, chapter 9). The file of markers says

    markers: {hoof_fl: 3215, hoof_fr: 1120, withers: 77, croup: 912}   # names of the live markers, numbers of vertices

    reference: [withers, croup]       # where the mesh is: the mean of these

    limbs: [hoof_fl, hoof_fr]         # optional: parts nearest to these follow them alone

    heading: [croup, withers]         # optional: the mesh faces from the one to the other, and turns with them (y is up)

    performer: {hoof_fl: LTOE}        # optional: the --performer's points, where they are called otherwise

    With --performer the mesh follows somebody of other proportions: frames are paired by the swing and place of each limb, in ranges of
    motion made equal; --ranges and --pairing say how. The model is used by operators.steering.SteerMesh.
    """
    from kinegraph.operators.steering.model.adapt import adapt
    from kinegraph.operators.steering.model.choose import choose
    from kinegraph.operators.steering.model.stored import KIND, to_arrays
    from kinegraph.stream.data.model_file import write_model
    from kinegraph.stream.text.progress import bar

    asked = {"alignment": alignment, "shapes": shapes, "blend": blend}
    ways = {"pose": pose, "regression": regression, "skeleton": skeleton, **asked}
    to_other = {"ranges": ranges, "pairing": pairing}
    parted = skeleton or any(asked[name] != known[0] for name, known in ASSEMBLIES.items())
    _refuse(output, report, method, asked, skeleton=skeleton, parted=parted, overwrite=overwrite)
    frames, topology, axes = _frames(recordings)
    table = _markers(markers, topology.vertices)
    _refuse_method(method, markers, table, ways, performed=performer is not None)
    graph = _body_graph(frames, topology, markers, table, to_other, performer=performer is not None)
    _tell_heading(recordings[0].name, frames[:, [table["markers"][name] for name in table["heading"]]])
    performed = _performed(performer, tuple(table["performer"].values()), axes) if performer else None
    if performer and performed is not None:
        _tell_heading(performer.name, performed[:, [list(table["markers"]).index(name) for name in table["heading"]]])
    say(f"{len(frames)} frames of {topology.vertices} vertices; learning ...")
    given = (topology.faces, table["markers"], table["reference"], table["limbs"], parts, modes, table["heading"])
    if part_error:
        given = (*given[:4], _fewest(frames, topology, parts, part_error, method), *given[5:])
    poses = _poses(frames, topology, markers, table, (pose, regression, skeleton), asked)
    way, other_body = ("parts" if parted else method or None), performer is not None
    with bar("learning") as progress:
        model, how, off, pull = choose(frames, *given, way, how=poses, performed=other_body, progress=progress)  # type: ignore[arg-type]
    facts = {"method": how, **ways}
    if report:
        from kinegraph.operators.steering.commands.report import write_report

        error = write_report(
            report, f"{output.name}: {topology.name or 'a mesh'}", model, how, off, frames, topology.faces,
            lambda rows: choose(rows, *given, how, pull, poses)[0], {**facts, **_softly(model)},
        )  # fmt: skip
        say(f"{report}: off by {error:.3f} % of the mesh's diagonal in every fourth frame, left out")
    if performed is not None:
        model = adapt(model, frames[:, model.vertices], performed, table["heading"], ranges, pairing, graph)  # type: ignore[arg-type]
        facts |= to_other
    header, arrays = to_arrays(model, topology, tuple(table["limbs"]))
    facts |= {"left_out": off, "softly": _softly(model), "trained_on": [path.name for path in recordings]}
    facts |= {"axes": axes.facts()} if axes else {}
    write_model(output, KIND, {**header, **facts, "performer": performer.name if performer else ""}, arrays)
    _tell(output, model, how, off, pull)


def _refuse(
    output: File,
    report: File | None,
    method: str,
    asked: dict[str, str],
    *,
    skeleton: bool,
    parted: bool,
    overwrite: bool,
) -> None:
    """Raises KinegraphError for files that are there and a method that is not."""
    from kinegraph.operators.steering.model.choose import METHODS

    for place in (output, report):
        if place and place.exists() and not overwrite:
            raise KinegraphError(f"{place}: exists; choose another, or replace it with --overwrite")
    if method not in ("", *METHODS):
        raise KinegraphError(f"--method: there is no method {method!r}; {nearest(method, METHODS)}")
    for name, known in ASSEMBLIES.items():
        if asked[name] not in known:
            raise KinegraphError(f"--{name}: there is no {name} {asked[name]!r}; {nearest(asked[name], known)}")
    if skeleton and asked["blend"] == "shared":
        raise KinegraphError(
            "--blend shared: a part that is there for each limb cannot hang from one; leave out --skeleton"
        )
    if skeleton and method not in ("", "parts"):
        raise KinegraphError(f"--skeleton: parts hang from one another; leave out --method {method}")
    if parted and method not in ("", "parts"):
        raise KinegraphError(
            f"--method {method}: --alignment, --shapes and --blend say how parts come to fit; leave one of them out"
        )


def _tell_heading(what: str, places: Samples) -> None:
    """Say so where the two markers of the heading, (f, 2, 3), lie above one another: then y is not what points up."""
    import numpy as np

    if places.shape[1] != 2:
        return
    ahead = places[:, 1] - places[:, 0]
    steep = np.abs(ahead[:, 1]) / np.maximum(np.linalg.norm(ahead, axis=1), 1e-9)
    if np.quantile(steep, 0.1) > STEEP:
        say(
            f"{what}: the heading's markers lie above one another, so that it has no heading: does y point up? turn it",
            err=True,
        )


def _fewest(frames: Samples, mesh: Topology, most: int, goal: float, method: str) -> int:
    """How few parts --part-error asks for."""
    import numpy as np

    from kinegraph.operators.steering.model.parts import edges_of, fewest_parts, seams_of
    from kinegraph.stream.text.progress import bar

    if method in ("straight", "local"):
        raise KinegraphError(f"--part-error: --method {method} has no parts; leave one of them out")
    with bar("parts") as progress:
        edges = np.concatenate([edges_of(mesh.faces), seams_of(frames)])
        count, left = fewest_parts(frames, edges, most, goal, progress)
    reached = "" if left <= goal else f", more than {goal:g} %: allow more --parts"
    say(f"{count} parts leave {left:.3f} % of the mesh's diagonal where each only turns and shifts{reached}")
    return count


def _softly(model: Steering) -> dict[str, float]:
    """How shapes are moved against their neighbours and markers, for the header; {} where they stay as predicted."""
    soft = model.settling.shapes if model.settling else None
    return {"beta": soft.beta, "marked": soft.marked} if soft else {}


def _refuse_method(method: str, markers: File, table: dict[str, Any], ways: dict[str, Any], *, performed: bool) -> None:
    """What cannot be asked for with these markers. Raises KinegraphError."""
    if ways["blend"] == "shared" and not table["limbs"]:
        raise KinegraphError(f"{markers}: --blend shared: names no limbs that could share a part")
    if table["limbs"] and method not in ("", "parts"):
        raise KinegraphError(
            f"{markers}: limbs move by themselves only where there are parts; leave out --method {method}"
        )
    if method == "local" and (performed or (ways["pose"], ways["regression"]) != ("positions", "kernel")):
        raise KinegraphError(
            "--method local: regions move with the markers that lie on them: by positions and kernels, and with no --performer; leave "
            "--method out"
        )


def _tell(output: File, model: Steering, how: Method, off: dict[Method, float], pull: MarkerPull | None) -> None:
    """What was learned, and how far off each method was."""
    if len(model.soft) and pull:
        say(f"what markers are off by is taken back around them, {100 * pull.width:.0f} % of the diagonal far")
    if model.settling and (soft := model.settling.shapes):
        say(
            f"shapes are moved against their neighbours and markers: beta ({100 * soft.beta:g} % of the diagonal)^2, a marker counts as "
            f"{soft.marked:g} vertices"
        )
    for name, error in off.items():
        say(
            f"{name}: off by {error:.3f} % of the mesh's diagonal in frames left out{', chosen' if name == how else ''}"
        )
    if how == "straight":
        say(f"{output}: straight to the vertices, {len(model.parts[0].modes)} components, {len(model.markers)} markers")
        return
    if how == "local":
        say(f"{output}: straight to the vertices, in {len(model.parts)} regions, {len(model.markers)} markers")
        return
    near_rigid = model.parts[:-1] if how == "both" else model.parts
    said_too = ", and half of it straight to the vertices" if how == "both" else ""
    say(f"{output}: {len(near_rigid)} parts, {len(model.markers)} markers{said_too}")
    for k, part in enumerate(near_rigid):
        alone = model.alone(part) or "all markers"
        say(
            f"  part {k}: {len(part.vertices)} vertices, by {alone}, width {part.learned.width:g}, ridge {part.learned.ridge:g}"
        )


def _poses(
    frames: Samples,
    mesh: Topology,
    markers: File,
    table: dict[str, Any],
    options: tuple[str, str, bool],
    assembly: dict[str, str],
) -> PoseRegression:
    """What --pose, --regression, --skeleton, --alignment, --shapes and --blend ask for."""
    from kinegraph.operators.steering.model.choose import regression_of
    from kinegraph.operators.steering.model.pose_parameters import POSES
    from kinegraph.operators.steering.model.regression import REGRESSIONS

    pose, regression, skeleton = options
    for name, asked, known in (("pose", pose, POSES), ("regression", regression, REGRESSIONS)):
        if asked not in known:
            raise KinegraphError(f"--{name}: there is no {name} {asked!r}; {nearest(asked, known)}")
    given = table["markers"], table["reference"], table["limbs"], table["heading"]
    try:
        other = [assembly[name] != known[0] for name, known in ASSEMBLIES.items()]
        return regression_of(frames, mesh.faces, *given, pose, regression, skeleton, *other)  # type: ignore[arg-type]
    except ValueError as error:
        raise KinegraphError(f"{markers}: --pose {pose}: {error}") from None


def _body_graph(
    frames: Samples, mesh: Topology, markers: File, table: dict[str, Any], asked: dict[str, str], *, performer: bool
) -> MarkerGraph | None:
    """The graph that --ranges graph and --pairing swing go by; None where neither is asked for."""
    from kinegraph.operators.steering.model.adapt import PAIRINGS, RANGES
    from kinegraph.operators.steering.model.choose import regression_of

    for name, known in (("ranges", RANGES), ("pairing", PAIRINGS)):
        if asked[name] not in known:
            raise KinegraphError(f"--{name}: there is no {name} {asked[name]!r}; {nearest(asked[name], known)}")
    usual = {"ranges": "positions", "pairing": "nearest"}
    one = next((f"--{name} {asked[name]}" for name in usual if asked[name] != usual[name]), "")
    if not one:
        return None
    if not performer:
        raise KinegraphError(f"{one}: only for a performer of another body; give --performer, or leave it out")
    given = table["markers"], table["reference"], table["limbs"], table["heading"]
    try:
        return regression_of(frames, mesh.faces, *given, "angles").graph
    except ValueError as error:
        raise KinegraphError(f"{markers}: {one}: {error}") from None


def _frames(recordings: list[File]) -> tuple[Samples, Topology, Axes | None]:
    """All frames of the one mesh that the recordings hold, and the axes that these declare."""
    import numpy as np

    from kinegraph.stream.batch.sessions import open_session, sessions_at
    from kinegraph.stream.domain.axes import Axes
    from kinegraph.stream.domain.mesh import Topology

    found: list[Any] = []
    axes: Axes | None = None
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
                    declared = Axes.of(stream.spec)
                    if mesh and declared != axes:
                        words = " and ".join(one.describe() if one else "axes not declared" for one in (axes, declared))
                        raise KinegraphError(f"{path}: {name} has other axes than the one before: {words}")
                    mesh, axes = other, declared
                    found.append(np.asarray(opened.read(name)[1], np.float64))
    if mesh is None:
        raise KinegraphError(
            "no stream of a mesh in these recordings; "
            "`kinegraph files import` makes one of a moving mesh: OBJ or PLY files, one a frame, or glTF"
        )
    frames = np.concatenate(found)
    frames = frames[np.isfinite(frames).all(axis=(1, 2))]
    if len(frames) < 2:
        raise KinegraphError(f"finite frames of the mesh: {len(frames)}; at least 2 are needed to learn how it moves")
    if len(frames) > MAX_FRAMES:
        frames = frames[np.linspace(0, len(frames) - 1, MAX_FRAMES).astype(int)]
    return frames, mesh, axes


def _performed(path: File, names: tuple[str, ...], axes: Axes | None) -> Samples:
    """Where the markers `names` were in the first stream of the recording that has them all, (n, m, 3) m, where all are seen.

    In the mesh's axes, where both declare them.
    """
    import numpy as np

    from kinegraph.operators.inputs.directions import turned_to
    from kinegraph.operators.inputs.lengths import metres
    from kinegraph.operators.inputs.marker_columns import marker_columns
    from kinegraph.stream.batch.sessions import open_session, sessions_at

    known: list[str] = []
    for session in sessions_at([path]):
        with open_session(session) as opened:
            for name, stream in opened.streams.items():
                spec = stream.spec
                known += [c for c in spec.channels if c not in known]
                if spec.is_event or spec.dtype.kind != "f" or not set(names) <= set(spec.channels):
                    continue
                order, signs = turned_to(axes, spec)
                columns = np.array([marker_columns(spec, one, "markers") for one in names])[:, order]
                rows = np.asarray(opened.read(name)[1], np.float64)
                found: Samples = rows.reshape(len(rows), -1)[:, columns] * metres(spec.units[0]) * np.array(signs)
                found = found[np.isfinite(found).all(axis=(1, 2))]
                if len(found) < 2:
                    raise KinegraphError(f"{path}: {name}: all markers are seen in {len(found)} samples; 2 are needed")
                return found
    missing = next((one for one in names if one not in known), names[0])
    raise KinegraphError(
        f"{path}: no stream holds all markers of the mesh; {missing!r}: {nearest(missing, known)}; `performer:` in the file of markers "
        "maps markers to the points that move them"
    )


def _performers(path: File, given: Any, markers: list[str]) -> dict[str, str]:
    """By marker the point of the performer that moves it: what `performer` says, else that of the same name."""
    if not isinstance(given := given or {}, dict):
        raise KinegraphError(
            f"{path}: performer is {given!r}; it must be a mapping of markers to the performer's points"
        )
    for name in given:
        if name not in markers:
            raise KinegraphError(f"{path}: performer: there is no marker {name!r}; {nearest(str(name), markers)}")
    return {name: str(given.get(name, name)) for name in markers}


def _markers(path: File, vertices: int) -> dict[str, Any]:
    """The file of markers, checked against the mesh."""
    table = marker_file(path, "names to numbers of vertices")
    for key in table:
        if key not in KEYS:
            raise KinegraphError(f"{path}: {key!r} is not known; {nearest(str(key), KEYS)}")
    for name, vertex in table["markers"].items():
        if not isinstance(vertex, int) or isinstance(vertex, bool) or not 0 <= vertex < vertices:
            raise KinegraphError(f"{path}: markers.{name} is {vertex!r}; the mesh has vertices 0 to {vertices - 1}")
        if other := next((n for n, v in table["markers"].items() if v == vertex and n != name), ""):
            raise KinegraphError(f"{path}: markers {other!r} and {name!r} are both vertex {vertex}; give each its own")
    for key in LISTS:
        table[key] = table.get(key) or []
        if not isinstance(table[key], list):
            raise KinegraphError(f"{path}: {key} is {table[key]!r}; it must be a list of markers: [{table[key]}]")
        for name in table[key]:
            if name not in table["markers"]:
                raise KinegraphError(
                    f"{path}: {key}: there is no marker {name!r}; {nearest(str(name), table['markers'])}"
                )
    table["performer"] = _performers(path, table.get("performer"), list(table["markers"]))
    if len(table["heading"]) not in (0, 2) or len(set(table["heading"])) != len(table["heading"]):
        raise KinegraphError(
            f"{path}: heading: must name two markers, from the one to the other of which the mesh faces"
        )
    if not table["reference"]:
        table["reference"] = [name for name in table["markers"] if name not in table["limbs"]] or list(table["markers"])
    return table
