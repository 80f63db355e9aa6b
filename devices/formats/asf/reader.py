"""ASF/AMC files (Acclaim): a skeleton, and the motion of a body that has it."""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from kinegraph.devices.formats.kinematics import blocks, in_turn, place
from kinegraph.devices.formats.timing import grid_of
from kinegraph.stream.chunk import Samples, StreamSpec
from kinegraph.stream.data.tables import read_text
from kinegraph.stream.domain.axes import BODY
from kinegraph.stream.domain.skeleton import JointTree
from kinegraph.stream.errors import RecordingError, nearest
from kinegraph.stream.recording.series import Series

TURNS = {"rx": "x", "ry": "y", "rz": "z"}
UNITS = {":RADIANS": True, ":DEGREES": False}
MOVES = {"tx": 0, "ty": 1, "tz": 2}
CMU_CM = 2.54
"""What lengths stand for once divided by the file's unit of length, as at CMU: inches."""


@dataclass(slots=True)
class Bone:
    """A bone of the skeleton: it points from its parent's end to its own, in world axes while the body is at rest."""

    name: str
    direction: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    length: float = 0.0
    axis: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    order: str = "xyz"
    dof: list[str] = field(default_factory=list)


@dataclass(slots=True)
class Skeleton:
    path: Path
    bones: list[Bone]
    parents: list[int]
    length_unit: float = 1.0
    radians: bool = False


def read_amc(path: Path, skeleton: Skeleton, rate_hz: float = 120.0, start_ns: int = 0) -> list[Series]:
    """Three streams: the file's name, where the bones end (bones, 3) in cm, the root first; with ".angles" behind it, the file's own
    channels, turns in degrees; and with ".pose" the pose of the skeleton in m (see `stream.domain.skeleton`), a joint where each bone
    begins.

    AMC files do not say their rate: 120 Hz, as at CMU, unless told otherwise. Lengths are taken for inches over the unit that the
    skeleton states, as at CMU. Turns are in degrees or radians as the file says, else as its skeleton says. Raises RecordingError with
    file and line.
    """
    names, rows, radians = _motion(path, skeleton)
    degrees = rows * np.array([np.degrees(1.0) if radians and c[1] in TURNS else 1.0 for c in names])
    cm = CMU_CM / skeleton.length_unit
    degrees *= np.array([cm if c[1] not in TURNS else 1.0 for c in names])
    time = grid_of(rate_hz, np.arange(len(rows)), start_ns)
    posed = not any(dof in MOVES for bone in skeleton.bones[1:] for dof in bone.dof)
    bones = len(skeleton.bones)
    ends, poses = np.empty((len(rows), bones, 3)), np.empty((len(rows), 3 + 4 * bones if posed else 0))
    for block in blocks(len(rows)):
        steps, turns = _steps_and_turns(skeleton, names, degrees[block], cm)
        ends[block] = place(skeleton.parents, steps, turns, ends=True)
        if posed:
            poses[block, :3] = steps[0] / 100.0
            for k, turn in enumerate(turns):
                poses[block, 3 + 4 * k : 7 + 4 * k] = Rotation.from_matrix(turn).as_quat(scalar_first=True)
    names_of_bones, placed = tuple(b.name for b in skeleton.bones), {"axes": BODY.facts()}
    spec = StreamSpec(ends.shape[1:], rate_hz=rate_hz, channels=names_of_bones, units=("cm",), meta=placed)
    angles = StreamSpec(
        (len(names),),
        rate_hz=rate_hz,
        channels=tuple(f"{bone}.{dof}" for bone, dof in names),
        units=tuple("deg" if dof in TURNS else "cm" for _, dof in names),
    )
    made = [Series(path.stem, spec, time, ends), Series(f"{path.stem}.angles", angles, time, degrees)]
    if posed:
        made.append(Series(f"{path.stem}.pose", _tree(skeleton, cm / 100.0).spec(rate_hz), time, poses))
    return made


def _steps_and_turns(
    skeleton: Skeleton, names: list[tuple[str, str]], degrees: Samples, cm: float
) -> tuple[list[Samples], list[Samples]]:
    """Per bone the way to its end (n, 3) in cm, and its rotation (n, 3, 3), seen from its parent."""
    steps, turns = [], []
    for bone in skeleton.bones:
        columns = {dof: names.index((bone.name, dof)) for dof in bone.dof}
        spun = [dof for dof in bone.dof if dof in TURNS]
        rest = in_turn(bone.order[::-1], np.array([bone.axis[::-1]]))[0]
        moved = in_turn("".join(TURNS[dof] for dof in spun[::-1]), degrees[:, [columns[dof] for dof in spun[::-1]]])
        turns.append(np.einsum("ij,njk,lk->nil", rest, moved, rest))
        step = np.tile(np.array(bone.direction) * bone.length * cm, (len(degrees), 1))
        for dof, axis in MOVES.items():
            if dof in columns:
                step[:, axis] += degrees[:, columns[dof]]
        steps.append(step)
    return steps, turns


def _tree(skeleton: Skeleton, to_m: float) -> JointTree:
    """A joint at the beginning of each bone, which ends where its children begin."""
    bones, parents = skeleton.bones, skeleton.parents
    ends = [np.array(bone.direction) * bone.length * to_m for bone in bones]
    offsets = np.array([ends[p] if p > 0 else np.zeros(3) for p in parents])
    names = ("hips", *(bone.name for bone in bones[1:]))  # "root" is what a pose calls the position
    return JointTree(names, np.array(parents), offsets)


def read_asf(path: Path) -> Skeleton:
    """The skeleton of an ASF file. Raises RecordingError with file and line."""
    root = Bone("root", dof=["tx", "ty", "tz", "rx", "ry", "rz"])
    made = Skeleton(path, [root], [-1])
    bones: dict[str, Bone] = {}
    links: list[tuple[int, list[str]]] = []
    section, bone = "", root
    lines = read_text(path, "ASF").split("\n")
    for number, line in enumerate(lines, 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        where = f"{path}: line {number}"
        if words[0].startswith(":"):
            section = words[0][1:].lower()
        elif section == "units":
            _units(where, made, words)
        elif section == "root":
            _bone(where, root, words)
        elif section == "bonedata":
            if words[0] == "begin":
                bone = Bone("")
            elif words[0] == "end":
                if not bone.name or bone.name in bones or bone.name == "root":
                    raise RecordingError(f"{where}: every bone needs a name of its own, {bone.name!r} is not")
                bones[bone.name] = bone
            else:
                _bone(where, bone, words)
        elif section == "hierarchy" and words[0] not in ("begin", "end"):
            links.append((number, words))
    if not bones or not links:
        raise RecordingError(
            f"{path}: line {len(lines)}: no bones, or no hierarchy; this is not an ASF file, or was cut off"
        )
    _link(made, bones, links)
    if made.radians:
        for bone in made.bones:
            bone.axis = [float(np.degrees(angle)) for angle in bone.axis]
    return made


def _units(where: str, made: Skeleton, words: list[str]) -> None:
    if words[0] == "length":
        made.length_unit = _numbers(where, words[1:], 1)[0]
        if made.length_unit <= 0.0:
            raise RecordingError(f"{where}: a unit of length of {made.length_unit:g} is impossible")
    elif words[0] == "angle":
        made.radians = words[1:2] in (["rad"], ["radians"])


def _bone(where: str, bone: Bone, words: list[str]) -> None:
    """Take one line of a bone's, or of the root's, description; lines that do not matter here are passed over."""
    key, rest = words[0].lower(), words[1:]
    if key == "name" and rest:
        bone.name = rest[0]
    elif key == "direction":
        bone.direction = _numbers(where, rest, 3)
    elif key == "length":
        bone.length = _numbers(where, rest, 1)[0]
    elif key == "orientation" or (key == "axis" and len(rest) == 4):
        bone.axis = _numbers(where, rest[:3], 3)
        bone.order = _order(where, rest[3]) if len(rest) == 4 else bone.order
    elif key == "axis" and len(rest) == 1:
        bone.order = _order(where, rest[0])
    elif key in ("dof", "order"):
        bone.dof = [word.lower() for word in rest]
        for dof in bone.dof:
            if dof not in TURNS and dof not in MOVES:
                raise RecordingError(
                    f"{where}: {dof!r} is not a degree of freedom; valid are {', '.join((*TURNS, *MOVES))}"
                )
        if len(set(bone.dof)) < len(bone.dof):
            raise RecordingError(f"{where}: a bone has each degree of freedom once, not {' '.join(rest)!r}")


def _order(where: str, text: str) -> str:
    if sorted(text.lower()) != ["x", "y", "z"]:
        raise RecordingError(f"{where}: {text!r} is not an order of the axes x, y and z")
    return text.lower()


def _link(made: Skeleton, bones: dict[str, Bone], links: list[tuple[int, list[str]]]) -> None:
    """Put the bones below their parents, which come before them."""
    at = {"root": 0}
    for number, (parent, *children) in links:
        where = f"{made.path}: line {number}"
        if parent not in at:
            raise RecordingError(f"{where}: {parent!r} stands below no bone above; {nearest(parent, at)}")
        for child in children:
            if child not in bones or child in at:
                known = [name for name in bones if name not in at]
                raise RecordingError(f"{where}: {child!r} is not a bone that is still free; {nearest(child, known)}")
            at[child] = len(made.bones)
            made.bones.append(bones[child])
            made.parents.append(at[parent])


def _motion(path: Path, skeleton: Skeleton) -> tuple[list[tuple[str, str]], Samples, bool]:
    """The channels (bone, degree of freedom), their values (frames, channels), and whether turns are in radians."""
    names = [(bone.name, dof) for bone in skeleton.bones for dof in bone.dof]
    first = {bone.name: names.index((bone.name, bone.dof[0])) for bone in skeleton.bones if bone.dof}
    width = {bone.name: len(bone.dof) for bone in skeleton.bones}
    values, row = array("d"), [math.nan] * len(names)
    begun, count, radians = 0, 0, skeleton.radians
    for number, line in enumerate(read_text(path, "AMC").split("\n"), 1):
        words = line.partition("#")[0].split()
        if not words or words[0].startswith(":"):
            radians = UNITS.get(words[0].upper() if words else "", radians)
            continue
        if len(words) == 1 and words[0].isdecimal():
            if begun:
                _whole(path, begun, row, names)
                values.extend(row)
                if int(words[0]) != count + 1:
                    raise RecordingError(f"{path}: line {number}: frame {words[0]} comes after frame {count}")
            count, begun, row = int(words[0]), number, [math.nan] * len(names)
        elif not begun:
            raise RecordingError(f"{path}: line {number}: a frame's number must come first, not {words[0]!r}")
        elif words[0] not in first:
            raise RecordingError(
                f"{path}: line {number}: {skeleton.path.name} has no moving bone {words[0]!r}; {nearest(words[0], first)}"
            )
        else:
            start = first[words[0]]
            if not math.isnan(row[start]):
                raise RecordingError(f"{path}: line {number}: frame {count} speaks of {words[0]!r} for the second time")
            row[start : start + width[words[0]]] = _numbers(f"{path}: line {number}", words[1:], width[words[0]])
    if not begun:
        raise RecordingError(f"{path}: holds no frames")
    _whole(path, begun, row, names)
    values.extend(row)
    return names, np.frombuffer(values).reshape(-1, len(names)), radians


def _whole(path: Path, begun: int, row: list[float], names: list[tuple[str, str]]) -> None:
    """Raises where a frame lacks a bone."""
    missing = next((name for value, (name, _) in zip(row, names, strict=True) if math.isnan(value)), None)
    if missing is not None:
        raise RecordingError(
            f"{path}: line {begun}: this frame says nothing about {missing!r}; the file was cut off, or is of another body"
        )


def _numbers(where: str, words: list[str], count: int) -> list[float]:
    try:
        made = [
            float(word.replace(",", ".")) for word in words
        ]  # words have blanks between them: a comma is a decimal one
    except ValueError:
        made = []
    if len(made) != count or not all(map(math.isfinite, made)):
        raise RecordingError(f"{where}: {count} numbers are needed here, not {' '.join(words)!r}")
    return made
