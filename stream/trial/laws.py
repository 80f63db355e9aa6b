"""The laws of DESIGN, one check each, on one case of one operator."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from stream.chunk import NS, Array, StreamSpec, empty, utc
from stream.errors import KinegraphError
from stream.operator import Case, Operator
from stream.trial.broken import RULES, Broken
from stream.trial.cut import Delivery, anyhow, describe, steps, whole
from stream.trial.play import Player, differ
from stream.trial.tape import Draw, Tape, Tapes, pause, repeat, span, spoil, tapes_of, with_faults
from stream.trial.watch import compiling

ROUNDS = 8
"""How often a case is repeated to see whether the state stops growing."""
HOUR_NS = 3600 * NS


class Trial:
    """One case of an operator, held to the laws. Making it is the warm-up; every method raises `Broken`."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.tapes = tapes_of(case)
        self.excused = type(case.operator).departures
        if unknown := self.excused.keys() - RULES.keys():
            raise Broken("cases", f"`departures` names {sorted(unknown)}, which are no rules")
        if not self.tapes or not any(len(tape) for tape in self.tapes.values()):
            raise Broken("cases", "the case has no samples")
        self._pristine = _copy(self.tapes)
        self.reference = self._play(whole(self.tapes))
        self._enough()
        self.operator: Operator[Any] = self.reference.operator
        limits = [v for name, v in _parameters(case.operator).items() if name.endswith("gap_s") and v is not None]
        self.limit_s = float(max([1.0, *limits]))

    def _enough(self) -> None:
        count = sum(len(output) for output in self.reference.outputs.values())
        least = max(self.case.least, 1 if self.reference.outputs else 0)
        if count < least:
            raise Broken("cases", f"{count} samples came out, the case promises at least {least}")

    def _play(self, delivery: Delivery, tapes: Tapes | None = None) -> Player:
        """A run from the beginning to the end; afterwards the inputs must be as they were."""
        before = None if tapes is None else _copy(tapes)
        player = Player(self.case, _jitter_ns(self.tapes), frozenset(self.excused)).play(delivery)
        for port, tape in (self.tapes if tapes is None else tapes).items():
            old = (self._pristine if before is None else before)[port]
            if old.time.tobytes() != tape.time.tobytes() or old.data.tobytes() != tape.data.tobytes():
                raise Broken("inputs", f"the samples given to input '{port}' were changed")
        return player

    def checks(self) -> dict[str, Callable[[], None]]:
        """What is tried without chance, by name."""
        return {
            "replay": self.replay,
            "memory": self.memory,
            "delay": self.delay,
            "time": self.time,
            "bad samples": self.bad_samples,
            "gaps": self.gaps,
        }

    @contextmanager
    def warm(self, how: str = "") -> Iterator[None]:
        """Nothing compiles meanwhile, and whatever is broken is told with `how` it was brought about."""
        with compiling() as kernels:
            try:
                yield
            except Broken as broken:
                raise Broken(broken.rule, broken.what, broken.how or how) from broken.__cause__
        if kernels:
            raise Broken("compile", f"met for the first time: {'; '.join(kernels)}", how)

    def attempt(self, draw: Draw) -> None:
        """Laws 1 and 3: faults and a cutting drawn by chance, once straight through, once through snapshots."""
        tapes, faults = with_faults(draw, self.tapes, self.limit_s)
        delivery = anyhow(draw, tapes)
        places = {draw(0, len(delivery) - 1) for _ in range(draw(1, 3))}
        by_file = bool(draw(0, 1))
        cutting = "\n".join([f"chunks: {describe(delivery)}", *faults])
        with self.warm(cutting):
            reference = self._play(whole(tapes), tapes)
            if difference := differ(reference, straight := self._play(delivery, tapes)):
                raise Broken("cuts", difference)
        how = f"{cutting}\nsnapshot before chunk {sorted(places)}, {'through a file' if by_file else 'in memory'}"
        with self.warm(how):
            if difference := differ(straight, self._play_with_snapshots(delivery, places, by_file)):
                raise Broken("state", difference)

    def _play_with_snapshots(self, delivery: Delivery, places: set[int], by_file: bool) -> Player:
        player = Player(self.case, _jitter_ns(self.tapes), frozenset(self.excused))
        for k, (port, chunk) in enumerate(delivery):
            if k in places:
                player.hand_over(by_file=by_file)
            player.feed(port, chunk)
        player.close()
        return player

    def replay(self) -> None:
        """Law 2: two fresh instances give the same chunks, `until` included."""
        with self.warm():
            delivery = steps(self.tapes, max(1, self._longest // 20))
            one, two = self._play(delivery), self._play(delivery)
            if one.log != two.log:
                k = next((k for k, (a, b) in enumerate(zip(one.log, two.log, strict=False)) if a != b), -1)
                raise Broken("replay", f"the second run differs in emission {k}. {differ(one, two)}")
            if difference := differ(self.reference, one):
                raise Broken("cuts", difference, f"chunks: {describe(delivery)}")

    def memory(self) -> None:
        """Law 4: the case again and again; the snapshot's size in the second half stays within that of the first.

        A single late step (room that doubles, a rare long cycle) is given the benefit of four times as many rounds.
        """
        for rounds in (ROUNDS, 4 * ROUNDS):
            sizes = self._sizes(rounds)
            first, second = max(sizes[: len(sizes) // 2]), max(sizes[len(sizes) // 2 :])
            if second <= first:
                return
        raise Broken(
            "memory",
            f"a snapshot takes up to {second} bytes, it took at most {first} in the first {rounds // 2} of {rounds} rounds",
        )

    def _sizes(self, rounds: int) -> list[int]:
        """What a snapshot takes after each chunk, while the case is repeated."""
        player = Player(self.case, _jitter_ns(self.tapes), frozenset(self.excused))
        sizes = []
        with self.warm(f"the case {rounds} times in a row"):
            for port, chunk in steps(repeat(self.tapes, rounds), max(1, self._longest // 10), ends=False):
                player.feed(port, chunk)
                sizes.append(player.state_bytes)
        return sizes

    def delay(self) -> None:
        """Law 5: sample by sample, nothing comes later than declared."""
        start = max(0, self._longest - 2000)
        with self.warm("one sample at a time"):
            player = self._play(steps(self.tapes, 1, start))
        stamps = np.sort(np.concatenate([tape.time for tape in self.tapes.values()]))
        wait = int(np.diff(stamps).max(initial=0))
        declared = round(self.operator.delay_s * NS)
        for name, output in player.outputs.items():
            if output.lag_ns > declared + wait + 1000 and "delay" not in self.excused:
                raise Broken(
                    "delay",
                    f"output '{name}' has samples {output.lag_ns / NS:g} s behind the newest input; "
                    f"declared are {self.operator.delay_s:g} s (and {wait / NS:g} s between inputs)",
                )

    def time(self) -> None:
        """Law 5: an hour of nothing."""
        player = Player(self.case, _jitter_ns(self.tapes), frozenset(self.excused))
        _, last = span(self.tapes)
        with self.warm("all samples, then an hour in which only `until` advances"):
            for port, chunk in steps(self.tapes, max(1, self._longest // 8), ends=False):
                player.feed(port, chunk)
            for port, tape in self.tapes.items():
                player.feed(port, empty(tape.spec, last + HOUR_NS))
            self._time_passed(player, last)

    def _time_passed(self, player: Player, last: int) -> None:
        periods = [spec.period_ns for spec in player.specs.values()]
        for name, output in player.outputs.items():
            reached = (
                last
                + HOUR_NS
                - round(self.operator.delay_s * NS)
                - 2 * max(output.spec.period_ns, *periods)
                - 1_000_000
            )
            if output.until < reached and "time" not in self.excused:
                raise Broken(
                    "time",
                    f"output '{name}' is complete until {utc(output.until)} only, the inputs until {utc(last + HOUR_NS)}",
                )

    def bad_samples(self) -> None:
        """Law 6: a stretch of NaN, and of infinity, in one number of each float input in turn."""
        for port, tape in self.tapes.items():
            if tape.is_float and len(tape) >= 8:
                self._bad_stretch(port, tape)

    def _bad_stretch(self, port: str, tape: Tape) -> None:
        slowest = max([tape.spec.period_ns, *(o.spec.period_ns for o in self.reference.outputs.values())])
        length = max(3, len(tape) // 20, 3 * slowest // tape.spec.period_ns if tape.spec.period_ns else 0)
        rows = slice(len(tape) // 4, min(len(tape) // 4 + length, len(tape) // 2))
        column = tape.columns().shape[1] // 2
        runs = []
        for value in (np.nan, np.inf, -np.inf):
            tapes = spoil(self.tapes, port, rows, column, value)
            how = f"{value} in samples {rows.start}..{rows.stop - 1} of '{port}', number {column}"
            with self.warm(how):
                runs.append(self._play(steps(tapes, max(1, len(tape) // 7)), tapes))
                if "infinity" not in self.excused and (difference := differ(runs[0], runs[-1])):
                    raise Broken("infinity", f"{difference} (as with NaN)")
        with self.warm(f"nan in samples {rows.start}..{rows.stop - 1} of '{port}', number {column}"):
            channel = int(np.unravel_index(column, tape.spec.shape)[tape.spec.channel_axis]) if tape.spec.shape else 0
            for name, output in runs[0].outputs.items():
                if len(self.tapes) == 1 and _keeps_channels(tape.spec, output.spec):
                    self._channel_by_channel(name, runs[0], channel)
            self._recovers(runs[0], int(tape.time[rows.stop - 1]))

    def _channel_by_channel(self, name: str, run: Player, bad: int) -> None:
        good, now = self.reference.outputs[name], run.outputs[name]
        if "channels" not in self.excused:
            if good.time.tobytes() != now.time.tobytes():
                raise Broken("channels", f"output '{name}': the stamps change")
            for c in range(good.spec.shape[good.spec.channel_axis]):
                if (
                    c != bad
                    and _channel(good.spec, good.data, c).tobytes() != _channel(good.spec, now.data, c).tobytes()
                ):
                    raise Broken("channels", f"output '{name}': channel {c} changes, channel {bad} was bad")
        if "nan" not in self.excused and not np.isnan(_channel(now.spec, now.data, bad)).any():
            raise Broken("nan", f"output '{name}': channel {bad} has no NaN")

    def _recovers(self, run: Player, bad_until: int) -> None:
        """In the last tenth of what comes out, as many values are finite, and about as many samples come, as without the bad ones."""
        if "poison" in self.excused:
            return
        for name, good in self.reference.outputs.items():
            now = run.outputs[name]
            late = bad_until + (self._last - bad_until) * 2 // 3
            expected, found = good.data[good.time > late], now.data[now.time > late]
            if len(expected) > 1 and not len(found):
                raise Broken(
                    "poison",
                    f"output '{name}': no sample comes after {utc(late)}; without the bad ones there are {len(expected)}",
                )
            if now.spec.dtype.names is None and len(expected) and np.issubdtype(now.spec.dtype, np.floating):
                before, after = np.isfinite(expected[-1]), np.isfinite(found[-1])
                if (before & ~after).any():
                    raise Broken(
                        "poison",
                        f"output '{name}' is {found[-1][~after & before][0]} to the end, long after the bad samples",
                    )

    def gaps(self) -> None:
        """Law 6: a silence far longer than any limit, reported by every input."""
        lead = max(self.tapes.values(), key=len)
        at = int(lead.time[len(lead) // 2])
        shift = round((10 * self.limit_s + 1000) * NS)
        tapes = pause(self.tapes, at, shift, told=True)
        if not any(tape.lost.any() for tape in tapes.values()):
            return
        how = f"a silence of {shift / NS:g} s before {utc(at + shift)}"
        with self.warm(how):
            run = self._play(steps(tapes, max(1, self._longest // 20)), tapes)
            middle = at + shift // 2
            outputs = run.outputs.values()
            after = sum(int((o.time > middle).sum()) for o in outputs)
            if after and "gaps" not in self.excused and not any(o.owed or any(o.lost) for o in outputs):
                raise Broken("gaps", f"{after} samples come after the silence, none of them says that anything is lost")
            if hasattr(self.case.operator, "reset_gap_s") and "reset" not in self.excused:
                self._begins_anew(run, tapes, middle)

    def _begins_anew(self, run: Player, tapes: Tapes, middle: int) -> None:
        """Signals after the silence are those of a new instance that begins there."""
        rest = {port: tape.keep(tape.time > middle) for port, tape in tapes.items()}
        rest = {port: replace(tape, lost=np.zeros_like(tape.lost)) for port, tape in rest.items()}
        if not any(len(tape) for tape in rest.values()):
            return
        new = self._play(steps(rest, max(1, self._longest // 20)), rest)
        for name, output in run.outputs.items():
            if output.spec.is_event:
                continue
            late = output.time > middle
            same_stamps = output.time[late].tobytes() == new.outputs[name].time.tobytes()
            if not same_stamps or output.data[late].tobytes() != new.outputs[name].data.tobytes():
                what = "values" if same_stamps else "stamps"
                raise Broken("reset", f"output '{name}': after the silence the {what} are not those of a new instance")

    @property
    def _longest(self) -> int:
        return max(len(tape) for tape in self.tapes.values())

    @property
    def _last(self) -> int:
        return span(self.tapes)[1]


def trials(cls: type[Operator[Any]]) -> list[Callable[[], Trial]]:
    """What makes a trial of each case of a class; raises `Broken` where it has none."""
    try:
        cases = list(cls.cases())
    except KinegraphError:
        raise
    except Exception as error:
        raise Broken("cases", f"cases() raised {type(error).__name__}: {error}") from error
    if not cases:
        raise Broken("cases", f"{cls.__name__} has none")
    return [lambda case=case: Trial(case) for case in cases]  # type: ignore[misc]


def _copy(tapes: Tapes) -> Tapes:
    return {port: replace(tape, time=tape.time.copy(), data=tape.data.copy()) for port, tape in tapes.items()}


def _parameters(operator: Operator[Any]) -> dict[str, Any]:
    return {name: getattr(operator, name) for name in getattr(operator, "__dataclass_fields__", {})}


def _jitter_ns(tapes: Tapes) -> int:
    """How far regular inputs' stamps are from one period apart."""
    off = [np.abs(np.diff(t.time) - t.spec.period_ns).max(initial=0) for t in tapes.values() if t.spec.period_ns]
    return int(max(off, default=0))


def _keeps_channels(before: StreamSpec, after: StreamSpec) -> bool:
    """Whether an output has the input's channels, so that the rule "channel by channel" can be asked of it."""
    floats = np.issubdtype(after.dtype, np.floating)
    return bool(
        floats
        and before.shape == after.shape
        and before.channels == after.channels
        and before.channel_axis == after.channel_axis
    )


def _channel(spec: StreamSpec, data: Array, channel: int) -> Array:
    return np.ascontiguousarray(data.take(channel, axis=1 + spec.channel_axis)) if spec.shape else data
