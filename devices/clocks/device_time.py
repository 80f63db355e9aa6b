"""A device's own time, unwrapped: it starts again at some value, is set while it runs, and now and then a number is wrong."""

from __future__ import annotations

import numpy as np

from kinegraph.devices.clocks.device_clock import JUMP_NS, DeviceClock
from kinegraph.stream.chunk import Times

SLACK_NS = 10_000_000_000
"""A device's time may advance by this much more than what has passed here: what was made during a stall comes all at once."""
STILL_NS, STILL_STEPS = 500_000_000, 4
"""A time that has not advanced for longer, nor for this many of its steps, while records came, has stopped."""
FIRST_NS = 3_000_000_000
"""The same while no step is known."""
COARSE = 0.1
"""If more of its steps are 0, it is coarser than the records."""
BELIEVED = 3
"""This many numbers in a row that fit each other, but not what was before, mean that the device's clock was set or started again."""


class DeviceTime:
    """Turns what a device says into ns that only grow, for a clock that maps them."""

    def __init__(self, clock: DeviceClock, wraps_ns: int = 0) -> None:
        """`wraps_ns`: at which value the device's time wraps around; 0: never."""
        self._clock, self._wraps = clock, wraps_ns
        self._raw: int | None = None
        self._value = self._arrival = 0
        self._former: tuple[int, int, int] | None = None
        """Raw, value and arrival of the number before the last one."""
        self._usual = 0
        """The smaller of the last two steps."""
        self._step = 0
        self._doubtful: list[int] = []
        self._moved, self._advance = 0, 0
        """When it last advanced (arrival), and by how much."""
        self._stands = False
        self._reads = self._same = self._finest = 0
        self.restarted = False
        """Whether with the last number the device's clock was found to have been set, or to have started again."""
        self.jump_ns = 0
        """By how much."""

    @property
    def coarse_ns(self) -> int:
        """How coarse it is, where it often does not tell one record from the next; else 0."""
        return self._finest if self._same > COARSE * self._reads else 0

    def read(self, raw_ns: int, arrival_ns: int, *, again: bool = False) -> int | None:
        """Unwrapped ns; None for a number that cannot be right. `again`: the record is the one before it once more.

        A time that stands still is set by the arrivals, until it advances again.
        """
        self.restarted = False
        if self._raw is None:
            self._moved = arrival_ns
            return self._accept(raw_ns, raw_ns, arrival_ns)
        if raw_ns == self._raw and not again:
            return self._same_again(raw_ns, arrival_ns)
        value = self._value + self._step_from(self._raw, raw_ns, arrival_ns - self._arrival)
        if self._follows(value, arrival_ns):
            self._learn(value - self._value)
        elif (past := self._past_the_last(raw_ns, arrival_ns)) is not None:
            value = past
        else:
            return self._doubt(raw_ns, arrival_ns)
        return self._accept(value, raw_ns, arrival_ns)

    def go_on(self, last_ns: int, n: int, arrival_ns: int) -> float | None:
        """How far apart n > 0 numbers of one arrival are (ns) that lie evenly between the last one and `last_ns`.

        None, with nothing changed, where one of them leaps. What `read_even` does for them, without the numbers.
        """
        if self._raw is None or self._doubtful or self._former is None:
            return None
        passed = arrival_ns - self._arrival
        whole = self._step_from(self._raw, last_ns, passed)
        step = whole / n
        least = min(step, self._usual)
        if step < 1 or least < 0 or max(step, self._usual) - least > JUMP_NS or whole > passed + SLACK_NS:
            return None
        self.restarted = self._stands = False
        self._step = self._usual = self._advance = round(step)
        value = self._value + whole
        self._former = last_ns - self._step, value - self._step, arrival_ns
        self._raw, self._value, self._arrival, self._moved = last_ns, value, arrival_ns, arrival_ns
        return step

    @property
    def value(self) -> int:
        """The last number, unwrapped."""
        return self._value

    def _same_again(self, raw_ns: int, arrival_ns: int) -> int:
        """The value of a record with the same time as the record before it."""
        self._reads, self._same = self._reads + 1, self._same + 1
        stood = arrival_ns - self._moved
        if self._stands:
            value = self._value + arrival_ns - self._arrival
        elif stood > (max(STILL_NS, STILL_STEPS * self._advance) if self._advance else FIRST_NS):
            self._stands = self.restarted = True
            value, self.jump_ns = self._value + stood, -stood
        else:
            value = self._value
            self._learn(0)
        return self._accept(value, raw_ns, arrival_ns)

    def read_even(self, raw_ns: Times, arrival_ns: int) -> Times | None:
        """What `read` gives for each of n > 1 numbers (n,) of one arrival; None, with nothing changed, where one of them leaps."""
        if self._raw is None or self._doubtful or self._former is None:
            return None
        first = self._step_from(self._raw, int(raw_ns[0]), arrival_ns - self._arrival)
        steps = np.diff(raw_ns)
        least = min(first, int(steps.min()), self._usual)
        if least < 0 or max(first, int(steps.max())) - least > JUMP_NS or first > arrival_ns - self._arrival + SLACK_NS:
            return None
        values: Times = self._value + first + (raw_ns - raw_ns[0])
        self.restarted = False
        before, self._step = first if len(steps) == 1 else int(steps[-2]), int(steps[-1])
        self._usual = min(before, self._step)
        self._former = int(raw_ns[-2]), int(values[-2]), arrival_ns
        self._moved, self._advance, self._stands = arrival_ns, self._step, False
        self._raw, self._value, self._arrival = int(raw_ns[-1]), int(values[-1]), arrival_ns
        return values

    def _step_from(self, before_ns: int, raw_ns: int, elapsed_ns: int) -> int:
        step = raw_ns - before_ns
        if self._wraps:
            step %= self._wraps
            step += self._wraps * max(0, round((elapsed_ns - step) / self._wraps))
        return step

    def _follows(self, value: int, arrival_ns: int) -> bool:
        """Whether a number can come after the last one: not back, not further than time has passed, and no leap into the future."""
        step = value - self._value
        if not 0 <= step <= arrival_ns - self._arrival + SLACK_NS:
            return False
        leapt = self._former is not None and step - self._usual > JUMP_NS
        return not (leapt and self._clock.is_ahead(value, arrival_ns))

    def _past_the_last(self, raw_ns: int, arrival_ns: int) -> int | None:
        """The value, where the number goes on from the last but one as the device's pace has it: then the last one was wrong."""
        if self._former is None or self._doubtful:
            return None
        raw, value, arrival = self._former
        step = self._step_from(raw, raw_ns, arrival_ns - arrival)
        return value + step if abs(step - 2 * self._usual) <= self._usual // 2 else None

    def _learn(self, step: int) -> None:
        self._usual = min(step, self._step) if self._former else step
        self._step = step

    def _accept(self, value: int, raw_ns: int, arrival_ns: int) -> int:
        if raw_ns != self._raw and self._raw is not None:
            self._reads, self._stands = self._reads + 1, False
            self._advance, self._moved = max(value - self._value, 0), arrival_ns
            if self._advance:
                self._finest = min(self._finest or self._advance, self._advance)
        known = self._raw is not None and not self.restarted
        self._former = (self._raw, self._value, self._arrival) if known and self._raw is not None else None
        self._value, self._raw, self._arrival = value, raw_ns, arrival_ns
        self._doubtful.clear()
        return value

    def _doubt(self, raw_ns: int, arrival_ns: int) -> int | None:
        if self._doubtful and not 0 <= raw_ns - self._doubtful[-1] <= SLACK_NS:
            self._doubtful.clear()
        self._doubtful.append(raw_ns)
        if len(self._doubtful) < BELIEVED:
            return None
        assert self._raw is not None
        self.jump_ns = raw_ns - self._raw - (arrival_ns - self._arrival)
        self.restarted = True
        return self._accept(raw_ns, raw_ns, arrival_ns)
