"""Simulated people who do what people do before a camera, written from anatomy and timing: joints, joint angles, and what is done when.

A body is a chain of segments of usual lengths (Winter's shares of the height) whose joint angles move from posture to posture with the
smooth speed of reaching movements (minimum jerk). Nothing here is taken from what the segmentation looks for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from kinegraph.devices.people.exerciser import JOINTS
from kinegraph.stream.chunk import Samples

RATE = 30.0
ANGLES = (
    "lean", "bend_side", "head",
    "flex_l", "abduct_l", "elbow_l", "flex_r", "abduct_r", "elbow_r",
    "hip_l", "knee_l", "hip_r", "knee_r", "hip_out_l", "hip_out_r", "jump",
)  # fmt: skip
"""Degrees of freedom, in radians (`jump`: m above the ground): trunk forward and to the right, head back, per side the arm forward and
sideways, elbow, thigh forward and sideways, knee."""
INDEX = {name: k for k, name in enumerate(ANGLES)}
STAND = {"abduct_l": 0.12, "abduct_r": 0.12, "elbow_l": 0.2, "elbow_r": 0.2}

Posture = dict[str, float]


@dataclass(frozen=True, slots=True)
class Done:
    """An action from `start` to `end` (s), done `count` times (0: no repetition at all); `kind`: exercise, everyday, walking or standing.

    middles  when each repetition was half done; ranges: how far each went, as a share of the full one
    """

    start: float
    end: float
    label: str
    kind: str
    count: int
    middles: tuple[float, ...] = ()
    ranges: tuple[float, ...] = ()


def both(**posture: float) -> Posture:
    """The same with both arms or legs."""
    return {f"{name}_{side}": value for name, value in posture.items() for side in "lr"}


EXERCISES: dict[str, tuple[list[tuple[float, Posture]], float]] = {
    # postures gone through in one repetition with the share of its time at which each is reached, and how long it takes (s)
    "arm raises": ([(0.5, both(abduct=2.6))], 2.2),
    "squats": ([(0.5, {**both(hip=1.5, knee=1.9, flex=1.2), "lean": 0.5})], 2.6),
    "curls": ([(0.5, both(elbow=2.3))], 2.0),
    "front raises": ([(0.5, both(flex=1.6))], 2.4),
    "punches": ([(0.25, {"flex_l": 1.5, "elbow_l": 0.1}), (0.5, {}), (0.75, {"flex_r": 1.5, "elbow_r": 0.1})], 1.4),
    "knee raises": ([(0.25, {"hip_l": 1.4, "knee_l": 1.6}), (0.5, {}), (0.75, {"hip_r": 1.4, "knee_r": 1.6})], 2.0),
    "jumping jacks": ([(0.5, {**both(abduct=2.7, hip_out=0.45), "jump": 0.03})], 1.1),
    "toe touches": ([(0.5, {**both(flex=1.7), "lean": 1.4})], 3.0),
    "side bends": ([(0.25, {"bend_side": 0.45}), (0.5, {}), (0.75, {"bend_side": -0.45})], 3.0),
    "small side bends": ([(0.5, {"bend_side": 0.26})], 2.2),
    "kicks": ([(0.35, {"hip_r": 0.5, "knee_r": 1.3}), (0.5, {"hip_r": 1.4, "knee_r": 0.1})], 1.6),
    "quarter squats": ([(0.5, both(hip=0.5, knee=0.8))], 1.8),
    "wrist to shoulder, one arm": ([(0.5, {"elbow_r": 2.2, "flex_r": 0.3})], 1.8),
    "windmill": ([(0.33, both(abduct=1.5)), (0.66, both(abduct=2.9))], 2.0),
}
LARGE = ("arm raises", "squats", "toe touches", "jumping jacks")
SMALL = ("small side bends", "quarter squats", "wrist to shoulder, one arm")
LEFT_OUT: dict[str, tuple[list[tuple[float, Posture]], float]] = {
    # exercises that nothing is chosen by: made to judge with
    "lunges": (
        [
            (0.25, {"hip_l": 1.2, "knee_l": 1.4, "hip_r": -0.2, "knee_r": 1.1}), (0.5, {}),
            (0.75, {"hip_r": 1.2, "knee_r": 1.4, "hip_l": -0.2, "knee_l": 1.1}),
        ],
        4.0,
    ),
    "shoulder presses": ([(0.25, both(abduct=0.9, elbow=2.2)), (0.5, both(abduct=2.9)), (0.75, both(abduct=0.9, elbow=2.2))], 3.0),
    "good mornings": ([(0.5, {"lean": 0.9, **both(flex=0.3, elbow=1.8)})], 2.8),
    "one arm up": ([(0.5, {"flex_r": 2.8})], 2.0),
    "leg to the side": ([(0.5, {"hip_out_r": 0.6})], 1.9),
    "low arm raises": ([(0.5, both(abduct=0.55))], 1.7),
    "heel to seat": ([(0.5, {"knee_l": 1.5})], 1.6),
}  # fmt: skip
LARGE_LEFT_OUT = ("lunges", "shoulder presses", "good mornings", "one arm up")
SMALL_LEFT_OUT = ("leg to the side", "low arm raises", "heel to seat")


@dataclass(slots=True)
class Person:
    """Somebody with a size, tempo and steadiness of their own, who does one thing after the other; `frames` are made as they are asked."""

    seed: int
    height: float = 0.0
    pace: float = 0.0
    done: list[Done] = field(default_factory=list)
    _rows: list[Samples] = field(default_factory=list)
    _path: list[Samples] = field(default_factory=list)

    def __post_init__(self) -> None:
        rng = np.random.default_rng((self.seed, 1))
        self.rng, self.size = rng, rng.uniform(0.9, 1.1)
        self.height = rng.uniform(1.55, 1.9)
        self.pace = rng.uniform(0.8, 1.25)
        self.now = vector(STAND)
        self.place, self.heading, self._n = np.zeros(2), 0.0, 0

    rng: np.random.Generator = field(init=False)
    size: float = field(init=False)
    now: Samples = field(init=False)
    place: Samples = field(init=False)
    heading: float = field(init=False)
    _n: int = field(init=False)

    @property
    def time(self) -> float:
        """Seconds so far."""
        return self._n / RATE

    def to(self, posture: Posture, seconds: float) -> None:
        """Move to a posture, all joints at once, and slightly beside it as nobody does anything twice alike."""
        target = vector({**STAND, **posture})
        frames = max(1, round(seconds * RATE))
        s = np.arange(1, frames + 1) / frames
        s = s**3 * (10 - 15 * s + 6 * s**2)
        self._add(self.now + s[:, None] * (target - self.now))
        self.now = target

    def hold(self, seconds: float) -> None:
        self._add(np.repeat(self.now[None], max(1, round(seconds * RATE)), 0))

    def _add(self, rows: Samples, path: Samples | None = None) -> None:
        self._rows.append(rows)
        self._path.append(np.tile([*self.place, self.heading], (len(rows), 1)) if path is None else path)
        self._n += len(rows)

    def _begun(
        self,
        label: str,
        kind: str,
        start: float,
        count: int = 0,
        middles: Sequence[float] = (),
        ranges: Sequence[float] = (),
    ) -> None:
        self.done.append(Done(start, self.time, label, kind, count, tuple(middles), tuple(ranges)))

    def stand(self, seconds: float) -> None:
        """Stand, with a shift of weight now and then."""
        start = self.time
        while self.time < start + seconds - 0.5 / RATE:
            left = start + seconds - self.time
            self.hold(min(left, self.rng.uniform(1.5, 5.0)))
            if start + seconds - self.time > 1.5 and self.rng.random() < 0.4:
                self.to({"bend_side": self.rng.normal(0.0, 0.02), "lean": self.rng.normal(0.0, 0.02)}, 0.8)
        self._begun("stand", "standing", start)

    def drink(self) -> None:
        side, start = self.rng.choice(["l", "r"]), self.time
        cup = {f"flex_{side}": 0.9, f"elbow_{side}": 1.3}
        mouth = {f"flex_{side}": 0.8, f"abduct_{side}": 0.4, f"elbow_{side}": 2.4}
        self.to(cup, self.rng.uniform(0.8, 1.3))
        for _ in range(int(self.rng.integers(1, 3))):
            self.to(mouth, self.rng.uniform(0.9, 1.4))
            self.to({**mouth, "head": 0.35, f"elbow_{side}": 2.5}, 0.5)
            self.hold(self.rng.uniform(0.8, 2.0))
            self.to(cup, self.rng.uniform(0.8, 1.3))
            self.hold(self.rng.uniform(0.3, 1.5))
        self.to({}, 1.0)
        self._begun("drink", "everyday", start)

    def stretch(self) -> None:
        start = self.time
        self.to(both(abduct=2.8, elbow=0.3), self.rng.uniform(1.6, 2.6))
        self.to({**both(abduct=2.9, elbow=0.2), "lean": -0.2, "head": 0.3}, self.rng.uniform(0.8, 1.5))
        self.hold(self.rng.uniform(1.0, 3.0))
        for way in self.rng.permutation([-1.0, 1.0])[: int(self.rng.integers(0, 3))]:
            self.to({**both(abduct=2.8), "bend_side": 0.35 * way}, self.rng.uniform(1.2, 2.0))
            self.hold(self.rng.uniform(0.8, 2.5))
        self.to({}, self.rng.uniform(1.2, 2.2))
        self._begun("stretch", "everyday", start)

    def scratch(self) -> None:
        side, start = self.rng.choice(["l", "r"]), self.time
        at = {f"flex_{side}": self.rng.uniform(0.6, 1.4), f"abduct_{side}": 0.5, f"elbow_{side}": 2.3}
        self.to(at, self.rng.uniform(0.6, 1.0))
        for _ in range(int(self.rng.integers(3, 9))):
            self.to(
                {**at, f"elbow_{side}": at[f"elbow_{side}"] + self.rng.uniform(-0.15, 0.15)},
                self.rng.uniform(0.12, 0.2),
            )
        self.to({}, self.rng.uniform(0.6, 1.1))
        self._begun("scratch", "everyday", start)

    def tie_shoes(self) -> None:
        start = self.time
        for side in self.rng.permutation(["l", "r"])[: int(self.rng.integers(1, 3))]:
            down = {
                "lean": 1.1,
                f"hip_{side}": 1.9,
                f"knee_{side}": 2.0,
                "hip_l": 1.3,
                "hip_r": 1.3,
                "knee_l": 1.7,
                "knee_r": 1.7,
            }
            down |= both(flex=1.6, elbow=0.4)
            self.to(down, self.rng.uniform(1.2, 1.8))
            for _ in range(int(self.rng.integers(6, 16))):
                hands = {
                    name: down.get(name, 0.1) + self.rng.normal(0.0, 0.14)
                    for name in both(flex=0.0, elbow=0.0, abduct=0.0)
                }
                self.to({**down, **hands}, self.rng.uniform(0.25, 0.7))
            self.to({}, self.rng.uniform(1.2, 1.8))
        self._begun("tie shoes", "everyday", start)

    def talk(self, seconds: float) -> None:
        start = self.time
        while self.time < start + seconds:
            hands = {}
            for side in "lr":
                if self.rng.random() < 0.6:
                    hands |= {
                        f"flex_{side}": abs(self.rng.normal(0.4, 0.3)),
                        f"abduct_{side}": abs(self.rng.normal(0.2, 0.15)),
                    }
                    hands |= {f"elbow_{side}": self.rng.uniform(0.6, 1.8)}
            self.to({**hands, "head": self.rng.normal(0.0, 0.08)}, self.rng.uniform(0.35, 0.9))
            self.hold(self.rng.exponential(0.5))
        self.to({}, 0.7)
        self._begun("talk", "everyday", start)

    def telephone(self) -> None:
        """Take a telephone, look at it, hold it to the ear, put it away. This and the next two are left out of every choice."""
        side, start = self.rng.choice(["l", "r"]), self.time
        look = {f"flex_{side}": 0.4, f"elbow_{side}": 1.7}
        self.to(look, self.rng.uniform(0.8, 1.3))
        for _ in range(int(self.rng.integers(0, 5))):
            self.to({**look, f"elbow_{side}": self.rng.normal(1.7, 0.08), "head": -0.2}, self.rng.uniform(0.3, 0.8))
            self.hold(self.rng.exponential(0.8))
        ear = {f"flex_{side}": 0.5, f"abduct_{side}": 0.4, f"elbow_{side}": 2.5}
        self.to(ear, self.rng.uniform(0.7, 1.1))
        for _ in range(int(self.rng.integers(1, 5))):
            self.hold(self.rng.uniform(0.8, 2.5))
            self.to({**ear, "lean": self.rng.normal(0.0, 0.05), "head": self.rng.normal(0.0, 0.1)}, 0.6)
        self.to({}, self.rng.uniform(0.8, 1.2))
        self._begun("telephone", "everyday", start)

    def tidy(self) -> None:
        """Pick things up from the floor or a table and put them elsewhere."""
        start = self.time
        for _ in range(int(self.rng.integers(2, 6))):
            side = self.rng.choice(["l", "r"])
            low = self.rng.random() < 0.5
            reach = {
                f"flex_{side}": self.rng.uniform(0.8, 1.5),
                f"abduct_{side}": self.rng.uniform(0.0, 0.5),
                f"elbow_{side}": 0.2,
            }
            if low:
                reach |= {
                    "lean": self.rng.uniform(0.7, 1.2),
                    **both(hip=self.rng.uniform(0.3, 1.0), knee=self.rng.uniform(0.3, 1.2)),
                }
            self.to(reach, self.rng.uniform(0.7, 1.5))
            self.hold(self.rng.uniform(0.1, 0.5))
            self.to(
                {f"flex_{side}": 0.3, f"elbow_{side}": 1.4, "bend_side": self.rng.normal(0, 0.1)},
                self.rng.uniform(0.6, 1.1),
            )
            self.to(
                {f"flex_{side}": self.rng.uniform(0.6, 1.8), f"abduct_{side}": self.rng.uniform(0.0, 0.9)},
                self.rng.uniform(0.6, 1.1),
            )
            self.to({}, self.rng.uniform(0.6, 1.1))
        self._begun("tidy", "everyday", start)

    def jacket(self) -> None:
        """Put on a jacket and button it."""
        start = self.time
        for side, other in (("l", "r"), ("r", "l")):
            self.to(
                {f"abduct_{side}": self.rng.uniform(0.6, 1.2), f"flex_{side}": -0.3, f"elbow_{other}": 1.5},
                self.rng.uniform(0.8, 1.4),
            )
            self.to(
                {f"abduct_{side}": 0.9, f"elbow_{side}": 2.0, f"flex_{other}": 0.7, f"elbow_{other}": 2.1},
                self.rng.uniform(0.7, 1.4),
            )
        for k in range(int(self.rng.integers(3, 6))):
            at = both(flex=0.55 - 0.1 * k, elbow=1.75 - 0.1 * k)
            for _ in range(int(self.rng.integers(2, 5))):
                self.to({name: v + self.rng.normal(0.0, 0.05) for name, v in at.items()}, self.rng.uniform(0.2, 0.5))
        self.to({}, self.rng.uniform(0.7, 1.2))
        self._begun("jacket", "everyday", start)

    def walk(self, seconds: float) -> None:
        """Walk about, turning now and then."""
        start, stride_s = self.time, 1.12 / self.pace**0.5
        frames = round(seconds * RATE)
        phase = 2 * np.pi * np.cumsum(self.rng.normal(1.0, 0.03, frames)) / (RATE * stride_s)
        on = np.minimum(1.0, np.minimum(np.arange(frames), np.arange(frames)[::-1]) / 12.0)
        rows = np.repeat(vector(STAND)[None], frames, 0)
        for side, sign in (("l", 1.0), ("r", -1.0)):
            rows[:, INDEX[f"hip_{side}"]] = on * (0.1 + 0.42 * sign * np.sin(phase))
            rows[:, INDEX[f"knee_{side}"]] = on * (0.15 + 0.9 * np.clip(sign * np.cos(phase), 0, None) ** 1.5)
            rows[:, INDEX[f"flex_{side}"]] += on * -0.35 * sign * np.sin(phase)
            rows[:, INDEX[f"elbow_{side}"]] += on * 0.25
        turn = np.zeros(frames)
        k = 0
        while k < frames:
            k += int(self.rng.uniform(1.5, 4.0) * RATE)
            turn[k : k + 30] = self.rng.normal(0.0, 1.2) / 30
        heading = self.heading + np.cumsum(turn * on)
        speed = on * 1.25 / stride_s * self.height / 1.7 / RATE
        path = self.place + np.cumsum(speed[:, None] * np.stack([np.sin(heading), np.cos(heading)], 1), 0)
        self._add(rows, np.column_stack([path, heading]))
        self.place, self.heading, self.now = path[-1], float(heading[-1]), vector(STAND)
        self._begun("walk", "walking", start)

    def exercise(
        self,
        name: str,
        count: int,
        *,
        pauses: float = 0.0,
        drift: float = 0.0,
        partial: Sequence[int] = (),
        size: float = 1.0,
    ) -> None:
        """A set: `drift`: how much slower the last repetition is, as a share; those numbered in `partial` go half as far."""
        postures, takes_s = (EXERCISES | LEFT_OUT)[name]
        start, middles, ranges = self.time, [], []
        for k in range(count):
            takes = takes_s / self.pace * (1.0 + drift * k / max(1, count - 1)) * self.rng.normal(1.0, 0.05)
            far = self.size * size * self.rng.normal(1.0, 0.05) * (0.4 if k in partial else 1.0)
            begun, at = self.time, 0.0
            for share, posture in [*postures, (1.0, {})]:
                goal = {
                    j: STAND.get(j, 0.0) + far * (v - STAND.get(j, 0.0)) + self.rng.normal(0.0, 0.02)
                    for j, v in posture.items()
                }
                self.to(goal, (share - at) * takes)
                at = share
            middles.append((begun + self.time) / 2)
            ranges.append(0.4 if k in partial else 1.0)
            if pauses and k < count - 1:
                self.hold(pauses * self.rng.uniform(0.7, 1.3))
        self._begun(name, "exercise", start, count, middles, ranges)

    def angles(self) -> Samples:
        """Joint angles (n, 16), with the unsteadiness of somebody who is alive."""
        rows = np.concatenate(self._rows)
        rng, n = np.random.default_rng((self.seed, 2)), len(rows)
        slow = np.cumsum(rng.normal(size=(n + 60, rows.shape[1])), 0)
        slow = np.apply_along_axis(np.convolve, 0, slow - ema(slow, 40), np.hanning(31) / 15.0, "same")[30 : 30 + n]
        made: Samples = rows + 0.018 * slow / max(1e-9, slow.std()) * (np.arange(rows.shape[1]) < 15)
        return made

    def joints(self, noise_mm: float = 0.0) -> Samples:
        """The twenty joints (n, 20, 3) in m before a camera, x to the person's right, y up, z away from it."""
        made = skeleton(self.angles(), np.concatenate(self._path), self.height)
        made += np.random.default_rng((self.seed, 3)).normal(0.0, noise_mm / 1000.0, made.shape)
        return made


def ema(x: Samples, frames: int) -> Samples:
    """A slow mean of each column."""
    made = np.empty_like(x)
    mean = x[0].copy()
    for i, row in enumerate(x):
        mean += (row - mean) / frames
        made[i] = mean
    return made


def vector(posture: Posture) -> Samples:
    made = np.zeros(len(ANGLES))
    for name, value in posture.items():
        made[INDEX[name]] = value
    return made


def skeleton(angles: Samples, path: Samples, height: float) -> Samples:
    """Joints of bodies in these postures; the lower foot is on the ground."""
    a = {name: angles[:, k] for name, k in INDEX.items()}
    zero, n = np.zeros(len(angles)), len(angles)
    thigh, shank, trunk, upper, fore = (share * height for share in (0.245, 0.246, 0.29, 0.186, 0.146))
    up = np.stack([np.sin(a["bend_side"]), np.cos(a["bend_side"]) * np.cos(a["lean"]), -np.sin(a["lean"])], 1)
    place = {"hip_center": np.zeros((n, 3)), "spine": 0.4 * trunk * up, "shoulder_center": trunk * up}
    tilt = a["lean"] - a["head"]
    place["head"] = place["shoulder_center"] + 0.15 * height * np.stack(
        [np.sin(a["bend_side"]), np.cos(tilt), -np.sin(tilt)], 1
    )
    feet = []
    for side, sign in (("l", -1.0), ("r", 1.0)):
        hip = np.stack([zero + 0.055 * sign * height, zero - 0.03, zero], 1)
        out = a[f"hip_out_{side}"] * sign
        knee = hip + thigh * np.stack(
            [np.sin(out), -np.cos(out) * np.cos(a[f"hip_{side}"]), -np.sin(a[f"hip_{side}"])], 1
        )
        low = a[f"hip_{side}"] - a[f"knee_{side}"]
        ankle = knee + shank * np.stack([np.sin(out), -np.cos(out) * np.cos(low), -np.sin(low)], 1)
        across = np.stack([np.cos(a["bend_side"]), -np.sin(a["bend_side"]), zero], 1)
        shoulder = place["shoulder_center"] + 0.11 * height * sign * across - 0.04 * up
        raised = a[f"abduct_{side}"] * sign

        def along(flex: Samples, raised: Samples = raised) -> Samples:
            return np.stack([np.sin(raised), -np.cos(raised) * np.cos(flex), -np.cos(raised) * np.sin(flex)], 1)

        elbow = shoulder + upper * along(a[f"flex_{side}"])
        wrist = elbow + fore * along(a[f"flex_{side}"] + a[f"elbow_{side}"])
        place |= {
            f"shoulder_{side}": shoulder,
            f"elbow_{side}": elbow,
            f"wrist_{side}": wrist,
            f"hand_{side}": wrist + 0.3 * (wrist - elbow),
        }
        place |= {
            f"hip_{side}": hip,
            f"knee_{side}": knee,
            f"ankle_{side}": ankle,
            f"foot_{side}": ankle + np.array([0.0, -0.05, -0.12]),
        }
        feet.append(ankle[:, 1])
    made = np.stack([place[joint] for joint in JOINTS], 1)
    made[:, :, 1] += (a["jump"] - np.minimum(*feet))[:, None]
    c, s = np.cos(path[:, 2])[:, None], np.sin(path[:, 2])[:, None]
    x, z = made[:, :, 0].copy(), made[:, :, 2].copy()
    made[:, :, 0], made[:, :, 2] = c * x + s * z + path[:, :1], -s * x + c * z + path[:, 1:2] + 2.8
    return made


def a_session(seed: int, exercises: Sequence[str] = tuple(EXERCISES)) -> Person:
    """A mixed session of one to two minutes: exercises, everyday actions and walking one after the other."""
    person = Person(seed)
    rng = np.random.default_rng((seed, 4))
    acts: list[Callable[[], None]] = []
    names = list(rng.permutation(list(exercises))[: int(rng.integers(3, 6))])
    acts += [
        lambda name=name: person.exercise(str(name), int(rng.integers(3, 9)), drift=rng.uniform(-0.15, 0.2))
        for name in names
    ]  # type: ignore[misc]
    everyday = [
        person.drink,
        person.stretch,
        person.scratch,
        lambda: person.walk(rng.uniform(4, 9)),
        lambda: person.stand(rng.uniform(3, 7)),
    ]
    acts += [everyday[k] for k in rng.permutation(len(everyday))[: int(rng.integers(2, 5))]]
    if rng.random() < 0.6:
        person.hold(rng.uniform(0.3, 2.0))
    for k in rng.permutation(len(acts)):
        acts[k]()
        if rng.random() < 0.5:
            person.hold(rng.uniform(0.2, 1.2))
    return person
