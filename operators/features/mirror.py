"""The features of the mirrored pose: left for right, and what points sideways the other way round (thesis 2.4)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.operators.inputs.channels import names_of
from kinegraph.stream.chunk import Samples, StreamSpec, Times
from kinegraph.stream.data.finite import finite
from kinegraph.stream.errors import InputError, ParameterError, nearest
from kinegraph.stream.filter import SampleWise
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import param

STACKED = re.compile(r"\[[+-]\d+\]$")


@kernel
def mirrored(x: Samples, source: Times, sign: Samples, out: Samples) -> None:
    """Column k of `out` (n, c) is column `source[k]` of `x` (n, c) times `sign[k]`; what is not finite is NaN."""
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            out[i, k] = sign[k] * finite(x[i, source[k]])


@dataclass(slots=True)
class MirrorState:
    source: Times
    sign: Samples


@dataclass(frozen=True, slots=True)
class Mirror(SampleWise[MirrorState]):
    """Features in, the features of the same movement seen in a mirror out: reflected at the body's sagittal plane. No delay, any rate.

    swap    pairs of channels that change places; a name also stands for its channels: `[ankle_l, ankle_r]` for ankle_l.x, .y and .z
    negate  channels that change their sign: what points sideways, and turns about axes in the plane. "*.x" stands for all that end so
    sides   whether the first of each pair is the left one. Otherwise results name the sides A and B, not left and right

    Without `swap` and `negate` a pose's own pairs are used (operators.features.pose.Pose). A channel may stand in one pair. Stacked
    features keep their offsets: ankle_l.x[-10] and ankle_r.x[-10]. The output's `meta["sides"]` is "LR", or "AB" where sides are not known;
    `meta["firsts"]` names the first of each pair.

    >>> Mirror(swap=[["arm_l", "arm_r"]])(np.array([[1.0, 2.0]]), rate_hz=30, channels=["arm_l", "arm_r"])
    array([[2., 1.]])
    """

    swap: tuple[tuple[str, str], ...] = param((), help="[channel, channel]: exchanged")
    negate: tuple[str, ...] = param((), help="channels that change their sign; *.x: all that end so")
    sides: bool = param(False, help="the first of each pair is the left one")

    kernel = mirrored

    def begin(self, spec: StreamSpec) -> MirrorState:
        if not spec.is_signal:
            raise InputError("in", spec.describe(), "a signal of features")
        names = names_of(spec)
        bare = [STACKED.sub("", name) for name in names]
        couples, turned = self._image(spec, bare)
        place = {name: i for i, name in enumerate(names)}
        source = [
            place[couples.get(plain, plain) + name[len(plain) :]] for name, plain in zip(names, bare, strict=True)
        ]
        sign = np.array([-1.0 if plain in turned else 1.0 for plain in bare])
        return MirrorState(np.array(source, np.int64), sign)

    def gives(self, spec: StreamSpec) -> StreamSpec:
        couples, _ = self._image(spec, [STACKED.sub("", name) for name in names_of(spec)])
        sided = self.sides or not (self.swap or self.negate)
        facts = {"mirrored": True, "sides": "LR" if sided else "AB", "firsts": list(couples)[::2]}
        return spec.derive(meta={**spec.meta, **facts})

    def _image(self, spec: StreamSpec, bare: list[str]) -> tuple[dict[str, str], set[str]]:
        """Which channels change places, and which their sign."""
        if self.swap or self.negate:
            return self._couples(bare), {name for given in self.negate for name in self._turned(given, bare)}
        own = spec.meta.get("mirror")
        if not own:
            raise ParameterError("swap", [], "a list of pairs, as the input says nothing about its sides")
        couples = {}
        for left, right in own["swap"]:
            couples[left], couples[right] = right, left
        return couples, set(own["negate"])

    def _couples(self, names: list[str]) -> dict[str, str]:
        """Each channel's counterpart, both ways; the first of each pair before the second."""
        found: dict[str, str] = {}
        for i, (first, second) in enumerate(self.swap):
            for a in self._named(f"swap[{i}]", first, names):
                b = second + a[len(first) :]
                if b not in names:
                    raise ParameterError(f"swap[{i}]", second, f"channels like those of {first!r}; there is no {b!r}")
                if a in found or b in found or a == b:
                    raise ParameterError(f"swap[{i}]", [first, second], "channels that stand in no other pair")
                found[a], found[b] = b, a
        return found

    def _turned(self, given: str, names: list[str]) -> list[str]:
        if given.startswith("*"):
            made = [name for name in names if name.endswith(given[1:])]
            if not made:
                raise ParameterError("negate", given, "the end of a channel's name")
            return made
        return self._named("negate", given, names)

    def _named(self, parameter: str, given: str, names: list[str]) -> list[str]:
        """The channel of this name, or all with this name and a dot as prefix."""
        made = [name for name in dict.fromkeys(names) if name == given or name.startswith(f"{given}.")]
        if not made:
            raise ParameterError(parameter, given, f"a channel of the input; {nearest(given, names)}")
        return made

    @classmethod
    def cases(cls) -> Sequence[Case]:
        data = np.random.default_rng(31).normal(size=(80, 4))
        angles = StreamSpec((4,), rate_hz=30.0, channels=("arm_l", "arm_r", "trunk.x", "trunk.z"), units=("deg",))
        pose = angles.derive(meta={"mirror": {"swap": [["arm_l", "arm_r"]], "negate": ["trunk.z"]}})
        return [
            Case(cls(swap=(("arm_l", "arm_r"),), negate=("*.x",)), {"in": (angles, grid(30.0, 80), data)}, least=80),
            Case(cls(), {"in": (pose, grid(30.0, 80), data)}, least=80),
        ]
