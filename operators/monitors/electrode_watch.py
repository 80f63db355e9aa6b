"""Alarms about electrodes, while somebody can still press one on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.operators.emg.quality import QUALITY
from kinegraph.stream.chunk import Chunk, Specs, StreamSpec, Times
from kinegraph.stream.domain.alarm import ON, OVER, FoundAlarms, alarm_chunk, alarms_spec
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import Case, Operator
from kinegraph.stream.params import param

ADVICE = {
    "missing samples": "bring the sensor nearer to its receiver, look at its battery",
    "flat line": "the electrode or its cable has come off: press it on, plug it in",
    "clipping": "lower the amplifier's gain, or see whether the electrode is loose",
    "mains hum": "press the electrodes on, the reference electrode first; move cables away from mains",
    "artefact": "tape the cable down, press the electrode on",
    "baseline noise": "clean the skin, press the electrode on or take a new one",
}
"""What to do, by what is wrong."""


@dataclass(slots=True)
class ElectrodeState:
    """Per channel (c,), by name: windows in a row that were not good, and that were; whether there is an alarm, and what it says."""

    names: list[str]
    trouble: Times
    good: Times
    on: Times
    reasons: list[str]


@dataclass(frozen=True, slots=True)
class ElectrodeWatch(Operator[ElectrodeState]):
    """Signal quality (`operators.emg.quality.SignalQuality`) in, an alarm per channel out as soon as it is not good, with what to do.

    A bad window is an alarm at once, a doubtful one if the next is not good either: with windows of 1 s a fault is reported within 2 s. The
    alarm is over after `settle` good windows in a row. Stamped like the window.

    >>> given, made = tried(ElectrodeWatch)
    >>> len(given["in"]), made[["subject", "state", "what"]][0].item()
    (60, ('TA', 'on', 'flat line'))
    """

    settle: int = param(2, least=1, most=60, help="good windows in a row after which an alarm is over")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if spec.dtype != QUALITY:
            raise InputError("in", spec.describe(), "signal quality, as operators.emg.quality.SignalQuality gives")
        nothing = np.zeros(0, np.int64)
        window_s = float(spec.meta.get("window_s", 0.0))
        self.set_state(
            ElectrodeState([], nothing, nothing.copy(), nothing.copy(), []),
            decision_s={"out": window_s} if window_s else None,
        )
        return alarms_spec(spec.meta)

    def process(self, port: str, chunk: Chunk) -> Chunk:
        found: FoundAlarms = []
        for stamp, row in zip(chunk.time.tolist(), chunk.data, strict=True):
            alarm = self._look(str(row["name"]), str(row["flag"]), str(row["reason"]), int(row["onset"]))
            if alarm:
                found.append((stamp, alarm))
        return alarm_chunk(found, chunk)

    @classmethod
    def cases(cls) -> list[Case]:
        rows = np.zeros(60, QUALITY)
        rows["name"] = ["TA", "SO"] * 30
        rows["flag"], rows["reason"] = "good", ""
        rows["flag"][10:20:2], rows["reason"][10:20:2] = "bad", "flat line"
        rows["flag"][31:41:2], rows["reason"][31:41:2] = "doubtful", "artefact"
        stamps = (1 + np.arange(60) // 2) * 1_000_000_000
        rows["onset"], rows["end"] = stamps - 1_000_000_000, stamps
        return [Case(cls(), {"in": (StreamSpec((), QUALITY, units=("",)), stamps, rows)}, least=4)]

    def _look(self, name: str, flag: str, reason: str, onset: int) -> tuple[int, str, str, str, str] | None:
        s = self.state
        if name not in s.names:
            s.names.append(name)
            s.reasons.append("")
            s.trouble, s.good, s.on = (np.append(a, 0) for a in (s.trouble, s.good, s.on))
        i = s.names.index(name)
        s.good[i] = s.good[i] + 1 if flag == "good" else 0
        s.trouble[i] = 0 if flag == "good" else s.trouble[i] + 1
        if s.on[i] and s.good[i] >= self.settle:
            s.on[i] = 0
            return onset, name, OVER, s.reasons[i], ""
        new = flag == "bad" or s.trouble[i] >= 2
        if new and (not s.on[i] or (flag == "bad" and reason != s.reasons[i])):
            s.on[i], s.reasons[i] = 1, reason
            return onset, name, ON, reason, ADVICE.get(reason, "")
        return None
