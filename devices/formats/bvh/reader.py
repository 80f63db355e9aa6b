"""BVH files (Biovision hierarchy): joint positions and the angles they come from."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from kinegraph.devices.formats.kinematics import blocks, in_turn, place
from kinegraph.devices.formats.timing import grid_of, snapped
from kinegraph.stream.chunk import Samples, StreamSpec
from kinegraph.stream.data.tables import read_text
from kinegraph.stream.domain.skeleton import JointTree
from kinegraph.stream.errors import RecordingError, nearest
from kinegraph.stream.recording.series import Series

CHANNELS = ("Xposition", "Yposition", "Zposition", "Xrotation", "Yrotation", "Zrotation")
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}


@dataclass(slots=True)
class Joint:
    """A joint, or the end of a limb (which has no channels); `first` is the column of its first channel."""

    name: str
    parent: int
    offset: list[float] = field(default_factory=list)
    channels: list[str] = field(default_factory=list)
    first: int = 0


def read_bvh(path: Path, unit: str = "", scale: float = 1.0, start_ns: int = 0) -> list[Series]:
    """Streams: the file's name, joint positions (joints, 3) in world coordinates, ends of limbs included ("Head_end"); with ".angles"
    behind it, the file's own channels, turns in degrees; and, if the unit is given, with ".pose" behind it the same motion as poses
    (stream/domain/skeleton.py), in metres. There a joint that has positions is at the median of these from its parent.

    BVH says neither unit nor axes; `unit` names what `scale` times the numbers are. A joint with position channels stands where these say,
    in its parent's frame, instead of at its offset. Raises RecordingError with file and line.
    """
    lines = read_text(path, "BVH").split("\n")
    joints, at = _hierarchy(path, lines)
    rate, at = _timing(path, lines, at)
    width = sum(len(joint.channels) for joint in joints)
    frames = _frames(path, lines, at, width)
    time = grid_of(rate, np.arange(len(frames)), start_ns)
    spec = StreamSpec((len(joints), 3), rate_hz=rate, channels=tuple(j.name for j in joints), units=(unit,))
    named = [(joint.name, channel) for joint in joints for channel in joint.channels]
    angles = StreamSpec(
        (width,),
        rate_hz=rate,
        channels=tuple(f"{name}.{channel}" for name, channel in named),
        units=tuple("deg" if channel.endswith("rotation") else unit for _, channel in named),
    )
    moved = frames * np.array([1.0 if channel.endswith("rotation") else scale for _, channel in named])
    posed = unit in METRES
    to_m = scale * METRES[unit] if posed else 0.0
    turning = [j for j, joint in enumerate(joints) if joint.channels or joint.parent < 0] if posed else []
    placed, poses = np.empty((len(frames), len(joints), 3)), np.empty((len(frames), 3 + 4 * len(turning)))
    for block in blocks(len(frames)):
        steps, turns = _steps_and_turns(joints, frames[block])
        placed[block] = place([joint.parent for joint in joints], steps, turns, ends=False) * scale
        poses[block, :3] = to_m * steps[0]
        for k, j in enumerate(turning):
            poses[block, 3 + 4 * k : 7 + 4 * k] = Rotation.from_matrix(turns[j]).as_quat(scalar_first=True)
    made = [Series(path.stem, spec, time, placed), Series(f"{path.stem}.angles", angles, time, moved)]
    if posed:
        made.append(Series(f"{path.stem}.pose", _tree(joints, turning, frames, to_m).spec(rate), time, poses))
    return made


def _tree(joints: list[Joint], kept: list[int], frames: Samples, to_m: float) -> JointTree:
    """The joints that turn, as a skeleton."""
    offsets = to_m * np.array([joints[j].offset for j in kept])
    for row, j in zip(offsets[1:], kept[1:], strict=True):
        for i, channel in enumerate(joints[j].channels, joints[j].first):
            if channel.endswith("position"):
                row["XYZ".index(channel[0])] = to_m * float(np.median(frames[:, i]))
    parents = [kept.index(joints[j].parent) if joints[j].parent >= 0 else -1 for j in kept]
    return JointTree(tuple(joints[j].name for j in kept), np.array(parents), offsets)


def _steps_and_turns(joints: list[Joint], frames: Samples) -> tuple[list[Samples], list[Samples]]:
    """Per joint its place (n, 3) and its rotation (n, 3, 3), seen from its parent."""
    steps, turns = [], []
    for joint in joints:
        step = np.tile(np.array(joint.offset), (len(frames), 1))
        axes, columns = "", []
        for i, channel in enumerate(joint.channels, joint.first):
            if channel.endswith("position"):
                step[:, "XYZ".index(channel[0])] = frames[:, i]
            else:
                axes += channel[0].lower()
                columns.append(i)
        steps.append(step)
        turns.append(in_turn(axes, frames[:, columns]))
    return steps, turns


def _hierarchy(path: Path, lines: list[str]) -> tuple[list[Joint], int]:
    """The joints in the file's order, and the line after them."""
    joints: list[Joint] = []
    open_ones: list[int] = []
    entering: str | None = None
    columns = 0
    for number, line in enumerate(lines, 1):
        words = line.split()
        if not words:
            continue
        word, where = words[0].upper(), f"{path}: line {number}"
        if number == 1 or (not joints and word == "HIERARCHY"):
            if word != "HIERARCHY":
                raise RecordingError(f"{where}: a BVH file begins with HIERARCHY, this one with {words[0]!r}")
        elif word == "MOTION":
            if open_ones or not joints:
                raise RecordingError(f"{where}: MOTION comes before the hierarchy is closed with }}")
            return joints, number
        elif word in ("ROOT", "JOINT", "END"):
            if (word == "ROOT") != (not open_ones) or (word == "ROOT" and joints):
                raise RecordingError(f"{where}: {words[0]} cannot stand here; one ROOT holds all joints")
            parent = open_ones[-1] if open_ones else -1
            name = " ".join(words[1:]) if word != "END" else _end(joints, parent)
            if not name or any(joint.name == name for joint in joints):
                raise RecordingError(f"{where}: every joint needs a name of its own, {name!r} is not")
            joints.append(Joint(name, parent))
            entering = name
        elif word == "{":
            if entering is None:
                raise RecordingError(f"{where}: {{ without a joint before it")
            open_ones.append(len(joints) - 1)
            entering = None
        elif word == "}":
            if not open_ones:
                raise RecordingError(f"{where}: }} without a {{ that it closes")
            _complete(where, joints[open_ones.pop()])
        elif word == "OFFSET" and open_ones:
            joints[open_ones[-1]].offset = _numbers(where, words[1:], 3, "OFFSET")
        elif word == "CHANNELS" and open_ones:
            joint = joints[open_ones[-1]]
            joint.channels, joint.first = _channels(where, words[1:]), columns
            columns += len(joint.channels)
        else:
            raise RecordingError(f"{where}: {words[0]!r} is not a word of a BVH hierarchy")
    raise RecordingError(f"{path}: line {len(lines)}: the file ends before MOTION; it was cut off")


def _end(joints: list[Joint], parent: int) -> str:
    """What the end of a limb is called; where a joint has several, by number from the second on."""
    ends = sum(
        joint.parent == parent and not joint.channels and joint.name.startswith(f"{joints[parent].name}_end")
        for joint in joints
    )
    return f"{joints[parent].name}_end{ends + 1 if ends else ''}"


def _complete(where: str, joint: Joint) -> None:
    if not joint.offset:
        raise RecordingError(f"{where}: joint {joint.name!r} has no OFFSET")


def _channels(where: str, words: list[str]) -> list[str]:
    if not words or not words[0].isdecimal() or int(words[0]) != len(words) - 1:
        raise RecordingError(
            f"{where}: CHANNELS is followed by their number and as many names, not by {' '.join(words)!r}"
        )
    named = [word.capitalize() for word in words[1:]]
    for word, name in zip(words[1:], named, strict=True):
        if name not in CHANNELS:
            raise RecordingError(f"{where}: {word!r} is not a channel; {nearest(word, CHANNELS)}")
    if len(set(named)) < len(named):
        raise RecordingError(f"{where}: a joint has each channel once, not {' '.join(words[1:])!r}")
    return named


def _numbers(where: str, words: list[str], count: int, what: str) -> list[float]:
    try:
        made = [
            float(word.replace(",", ".")) for word in words
        ]  # words have blanks between them: a comma is a decimal one
    except ValueError:
        made = []
    if len(made) != count or not np.isfinite(made).all():
        raise RecordingError(f"{where}: {what} needs {count} numbers, not {' '.join(words)!r}")
    return made


def _timing(path: Path, lines: list[str], at: int) -> tuple[float, int]:
    """The rate in Hz, and the line (counted from 0) where frames begin; what "Frames:" says is checked against them."""
    facts: dict[str, tuple[float, int]] = {}
    while at < len(lines) and len(facts) < 2:
        key, colon, value = lines[at].partition(":")
        at += 1
        if not key.strip():
            continue
        name, where = " ".join(key.lower().split()), f"{path}: line {at}"
        if not colon or name not in ("frames", "frame time"):
            raise RecordingError(
                f"{where}: 'Frames:' and 'Frame Time:' must come here, not {lines[at - 1].strip()!r:.60}"
            )
        facts[name] = _numbers(where, value.split(), 1, name)[0], at
    if len(facts) < 2:
        raise RecordingError(
            f"{path}: line {len(lines)}: the file ends before 'Frames:' and 'Frame Time:'; it was cut off"
        )
    period, line = facts["frame time"]
    if not 1e-6 < period < 1e6:
        raise RecordingError(f"{path}: line {line}: a frame time of {period:g} s is impossible")
    count = sum(1 for text in lines[at:] if text.strip())
    if count != facts["frames"][0]:
        raise RecordingError(
            f"{path}: line {facts['frames'][1]}: {facts['frames'][0]:g} frames are announced, {count} are there"
        )
    if not count:
        raise RecordingError(f"{path}: line {facts['frames'][1]}: there is a skeleton, but not one frame of motion")
    return snapped(1.0 / period), at


def _frames(path: Path, lines: list[str], at: int, width: int) -> Samples:
    body = [line for line in lines[at:] if line.strip()]
    try:
        made: Samples = np.loadtxt(body, ndmin=2, comments=None)
        if made.shape == (len(body), width) and np.isfinite(made).all():
            return made
    except ValueError:
        pass
    numbered = ((number, line.split()) for number, line in enumerate(lines[at:], at + 1))
    return np.array(
        [_numbers(f"{path}: line {number}", words, width, "a frame") for number, words in numbered if words]
    )
