"""A mesh that follows a few markers, live (thesis, chapter 9)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from kinegraph.operators.inputs.directions import turned_to
from kinegraph.operators.inputs.lengths import length_of, metres
from kinegraph.operators.inputs.marker_columns import marker_columns, marker_names
from kinegraph.operators.steering.model.assemble_kernel import (
    add_part,
    columns,
    gather_marks,
    predict,
    predict_linear,
    put,
)
from kinegraph.operators.steering.model.fit import Steering
from kinegraph.operators.steering.model.ground import MAX_SHARE, around_feet, stand_on_ground
from kinegraph.operators.steering.model.marker_frame import see_from
from kinegraph.operators.steering.model.part import Part
from kinegraph.operators.steering.model.pose_parameters import tell_pose
from kinegraph.operators.steering.model.regions import Regions
from kinegraph.operators.steering.model.regression import FAR
from kinegraph.operators.steering.model.settling import ROUNDS, settle
from kinegraph.operators.steering.model.skeleton import hang
from kinegraph.operators.steering.model.soft import faded, pull_mesh
from kinegraph.operators.steering.model.stored import KIND, MAKER, from_model
from kinegraph.operators.steering.swapped_markers import NAMED, ExchangedNames
from kinegraph.stream.chunk import NS, Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.data.model_file import read_model
from kinegraph.stream.domain.axes import Axes, in_axes
from kinegraph.stream.errors import InputError, ParameterError, nearest
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

QUADRUPED = Path(__file__).with_name("quadruped.npz")
MODELS = {"quadruped": QUADRUPED, "dog": Path(__file__).with_name("dog.npz")}
"""The models that come with kinegraph, by the word that stands for each in `model`."""


def model_file(model: Path | None) -> Path:
    """The file of a model, or of the one that comes with kinegraph under this word; of the simple quadruped without one."""
    return MODELS.get(str(model), model) if model else QUADRUPED


@dataclass(slots=True)
class SteerMeshState:
    """known (m,): which markers have been seen; marks (m, 3) from the centre (3,) of the references, turned back by the heading (2,);
    latest (v, 3), the newest mesh; earlier (m, 3), the marks of the sample before; begun (1,), whether there was one; names:
    of which markers the names seem to be exchanged; travelled (3,) and feet (k, 9): see operators/steering/model/ground.py; last (1,), the
    newest stamp."""

    known: Array
    marks: Samples
    centre: Samples
    heading: Samples
    latest: Samples
    outside: Samples
    earlier: Samples
    begun: Array
    names: ExchangedNames
    travelled: Samples
    feet: Samples
    last: Times


class _Steered(Operator[SteerMeshState]):
    """What does not change while samples come: the model, the columns of its markers, and room."""

    __slots__ = ("around", "columns", "feet", "learned", "regions", "room", "scale", "together")
    around: Samples
    feet: Times
    learned: Steering
    columns: Times
    scale: Samples
    together: Samples
    regions: Regions | None
    room: tuple[Samples, Samples, Samples, list[Samples], list[Samples]]


@dataclass(frozen=True, slots=True)
class SteerMesh(_Steered):
    """Markers (points, 3) in; out comes the mesh that a model (`kinegraph motion train steering`) has learned to move with them.

    mesh      its vertices (vertices, 3) m, with the triangles in the spec
    quality   how far the markers are from all poses of the training, in kernel widths (the largest of all parts): beyond some 3 the mesh
              goes back to its mean pose, rather than anywhere else
    names     an event when two markers seem to bear each other's names: exchanging them would bring the markers back to the training, in
              ten samples one after the other, and no other pair would do as well; and one when that is cured

    Where the model says which way its markers face, the mesh turns with them about the vertical, y. The input has the model's markers by
    their names; `markers` names others in their place. A marker that is not seen has moved with the reference markers since it was;
    before all have been seen, the mesh keeps the training's mean pose. An input that declares its axes is turned to those of the model,
    where that declares its own. No delay.

    The pose goes in as the model says: positions of markers, or the angles, lengths and directions of table 9.1. Parts are placed each by
    itself, or hang from one another as a virtual skeleton.

    Thesis 9.3 and 9.4, with kernel ridge for the linear maps, and every part placed by its own regression instead of one after the other:
    on the horse that halves the error. Alignment and blending (9.16) are by weights along the surface. Marked vertices are soft constraints
    (9.14): what the mesh is off by at its markers is taken back around them, as far as that helped in frames left out of the training. Feet
    of `ground` do not slide (9.6): the mesh goes on over those that are down, and each is held where it came down.

    >>> given, made = tried(SteerMesh)
    >>> given["in"].shape, made["mesh"][-1, 0].round(2)
    ((60, 18), array([ 0.32, -0.17, -0.51]))
    """

    inputs = {"in": Input(finite=True)}
    outputs: ClassVar[tuple[str, ...]] = ("mesh", "quality", "names")

    model: Path | None = param(
        None,
        help="what `kinegraph motion train steering` has made, or `dog`; left out: a simple quadruped, to try things with",
    )
    markers: Mapping[str, str] | None = param(None, help="marker of the model: point of the input, where names differ")
    ground: tuple[str, ...] = param(
        (), help="markers of the model that are feet: one that is down keeps its place (y is up)"
    )

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        unit = length_of(spec)
        model = read_model(model_file(self.model), KIND, MAKER)
        learned, mesh = from_model(model)
        axes = Axes.from_facts(model.header.get("axes"))
        order, signs = turned_to(axes, spec)
        columns = [[at[a] for a in order] for at in self._columns(spec, learned.markers)]
        m = len(learned.markers)
        rest = resting(learned, mesh.vertices)
        for name in self.ground:
            if name not in learned.markers:
                raise ParameterError(
                    "ground", list(self.ground), f"markers of the model: {nearest(name, learned.markers)}"
                )
        feet = np.array([learned.markers.index(name) for name in self.ground], np.int64)
        object.__setattr__(self, "feet", feet)
        object.__setattr__(self, "around", around_feet(rest, learned.vertices[feet]))
        object.__setattr__(self, "learned", learned)
        object.__setattr__(self, "columns", np.array(columns, np.int64))
        object.__setattr__(self, "scale", metres(unit) * np.array(signs))
        together = np.zeros((len(learned.parts), max(len(part.learned.mean) for part in learned.parts)))
        predicted = [room[: len(part.learned.mean)] for room, part in zip(together, learned.parts, strict=True)]
        object.__setattr__(self, "together", together)
        object.__setattr__(self, "regions", Regions.of(learned.parts))
        middles = [part.learned.centres.mean(axis=0) for part in learned.parts]
        features = np.zeros(learned.width) if learned.graph else np.zeros(0)
        object.__setattr__(self, "room", (np.zeros(3 * m), features, np.zeros((3, 3)), predicted, middles))
        self.set_state(
            SteerMeshState(
                np.zeros(m, np.bool_),
                np.zeros((m, 3)),
                np.zeros(3),
                np.array([1.0, 0.0]),
                rest,
                np.zeros(1),
                np.zeros((m, 3)),
                np.zeros(1, np.bool_),
                ExchangedNames.empty(),
                np.array([0.0, 0.0, np.inf]),
                np.zeros((len(feet), 9)),
                np.zeros(1, np.int64),
            )
        )
        meta = {key: value for key, value in in_axes(spec, axes).items() if key != "skeleton"}
        quality = StreamSpec((1,), rate_hz=spec.rate_hz, channels=("outside",), settling_s=spec.settling_s, meta=meta)
        names = StreamSpec((), NAMED, units=("ns", "", "", ""), meta=meta)
        return {
            "mesh": mesh.spec(spec.rate_hz, settling_s=spec.settling_s, meta=meta),
            "quality": quality,
            "names": names,
        }

    def _columns(self, spec: StreamSpec, wanted: Sequence[str]) -> list[tuple[int, int, int]]:
        """Where the model's markers stand in the input. Raises InputError, which names all that are not there, and ParameterError."""
        given, named = self.markers or {}, marker_names(spec)
        for name in given:
            if name not in wanted:
                raise ParameterError(
                    "markers", dict(given), f"by markers of the model: {name!r}, {nearest(name, wanted)}"
                )
        absent = [name for name in wanted if name not in given and name not in named and not name.isdecimal()]
        if named and absent:
            raise InputError(
                "in",
                f"markers {', '.join(named)}",
                f"the model's markers, of which {', '.join(absent)} {'are' if len(absent) > 1 else 'is'} not there: connect a "
                "source that has them, or say in `markers` which of the input's points stand for them",
            )
        return [marker_columns(spec, given.get(name, name), "markers") for name in wanted]

    def process(self, port: str, chunk: Chunk) -> Sequence[tuple[str, Chunk]]:
        s, n = self.state, len(chunk.time)
        x = self.room[0]
        made, quality = np.empty((n, *s.latest.shape)), np.empty((n, 1))
        events: list[tuple[int, str, str, str]] = []
        learned = self.learned
        for i in range(n):
            if gather_marks(
                chunk.data[i], self.columns, self.scale, learned.reference, learned.facing, s.known, s.marks, s.centre, s.heading, x
            ):  # fmt: skip
                s.outside[0] = 0.0
                s.latest[:] = 0.0 if len(learned.facing) else s.centre
                if self.regions:
                    s.outside[0] = self.regions.add(s.marks, s.latest)
                else:
                    self._add_parts(self._told())
                if len(learned.soft):
                    about = np.zeros(3) if len(learned.facing) else s.centre
                    share = faded(float(s.outside[0]))
                    pull_mesh(
                        s.marks,
                        about,
                        learned.vertices,
                        learned.soft,
                        learned.most,
                        share,
                        s.latest,
                        np.empty_like(s.marks),
                    )
                if len(learned.facing):
                    put(s.centre, s.heading, learned.reach, s.latest)
                if len(self.feet):
                    self._stand(int(chunk.time[i]))
            made[i], quality[i] = s.latest, s.outside
            marks = self.scale * chunk.data[i][self.columns]
            seen, far, now = bool(np.isfinite(marks).all()), float(s.outside[0]), int(chunk.time[i])
            if seen and (event := s.names.see(learned, marks, far, now, self.regions)):
                events.append(event)
        return [
            ("mesh", Chunk(chunk.time, made, chunk.until, chunk.lost)),
            ("quality", Chunk(chunk.time, quality, chunk.until, chunk.lost)),
            (
                "names",
                Chunk(np.array([row[0] for row in events], np.int64), np.array(events, NAMED), chunk.until, chunk.lost),
            ),
        ]

    def _stand(self, now: int) -> None:
        """Keep the feet that are down where they are."""
        s, learned = self.state, self.learned
        dt = min(max((now - int(s.last[0])) / NS, 0.0), 0.1) if s.last[0] else 0.0
        s.last[0] = now
        high = float(np.ptp(s.latest[:, 1]))
        stand_on_ground(
            s.latest, learned.vertices[self.feet], learned.spread[self.feet, 1], self.around, MAX_SHARE * high, dt, s.travelled, s.feet
        )  # fmt: skip

    def _told(self) -> Samples:
        """The features of the pose: the markers' positions, or the angles, lengths and directions of the model's graph."""
        s, (x, features, *_), graph = self.state, self.room, self.learned.graph
        if graph is None:
            return x
        if not s.begun[0]:
            s.earlier[:] = s.marks
        tell_pose(
            s.marks,
            s.earlier,
            graph.lead,
            graph.edges,
            graph.before,
            graph.lengths,
            graph.shares,
            graph.still,
            features,
        )
        s.earlier[:], s.begun[0] = s.marks, True
        return features

    def _add_parts(self, features: Samples) -> None:
        """Add every part to the newest mesh, at the pose `features` (width,)."""
        s, parts, (_, _, turn, predicted, middles) = self.state, self.learned.parts, self.room
        for part, y, middle in zip(parts, predicted, middles, strict=True):
            one = part.learned
            if one.linear:
                far = predict_linear(
                    features, part.features, one.centres, middle, one.weights, one.mean, one.scale, FAR, y
                )
            else:
                far = predict(features, part.features, one.centres, one.weights, one.mean, one.scale, y)
            s.outside[0] = max(s.outside[0], far)
            if part.parent >= 0:
                columns(predicted[part.parent], turn)
                sizes = np.array([len(parts[part.parent].vertices), len(part.vertices)])
                hang(y, predicted[part.parent], turn, part.above, part.own, sizes)
        if held := self.learned.settling:
            fade = faded(float(s.outside[0]))
            settle(self.together, s.marks, fade, held.greedy, held.borders, held.most, ROUNDS)
        for part, y in zip(parts, predicted, strict=True):
            add_part(y, part.vertices, part.weights, part.mean, _modes(part), turn, s.latest)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        names = ("hoof_fl", "hoof_fr", "hoof_hl", "hoof_hr", "withers", "croup")
        rng = np.random.default_rng(9)
        rows = rng.normal(0.0, 0.02, (60, 6, 3)).cumsum(axis=0) + from_model(read_model(QUADRUPED, KIND))[0].usual
        rows[20:25, 1] = np.nan
        spec = StreamSpec((6, 3), rate_hz=30.0, channels=names, units=("m",))
        given = {"in": (spec, grid(30.0, 60), rows.reshape(60, -1))}
        return [Case(cls(), given, least=120), Case(cls(ground=names[:4]), given, least=120)]


def _modes(part: Part) -> Samples:
    return part.modes.reshape(len(part.modes), -1, 3)


def resting(model: Steering, count: int) -> Samples:
    """The mesh (count, 3) in the mean pose of its training, about the place of its reference markers."""
    made, predicted = np.zeros((count, 3)), list[Samples]()
    for part in model.parts:
        y, turn = part.learned.mean.copy(), np.zeros((3, 3))
        if part.frame:
            see_from(
                model.usual,
                part.frame.weights,
                part.frame.usual,
                part.frame.shares,
                y[:9],
                np.zeros(model.usual.size),
                np.zeros((11, 4)),
            )
        if part.parent >= 0:
            columns(predicted[part.parent], turn)
            sizes = np.array([len(model.parts[part.parent].vertices), len(part.vertices)])
            hang(y, predicted[part.parent], turn, part.above, part.own, sizes)
        predicted.append(y)
    if model.settling:
        predicted = model.settling(predicted, model.usual, 0.0)
    for part, y in zip(model.parts, predicted, strict=True):
        add_part(y, part.vertices, part.weights, part.mean, _modes(part), np.zeros((3, 3)), made)
    return made
