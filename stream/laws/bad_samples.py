"""Law 6: bad samples and long silences are met on purpose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kinegraph.stream.chunk import NS, Array, StreamSpec, utc
from kinegraph.stream.laws.case_samples import CaseSamples, Tapes, pause, spoil
from kinegraph.stream.laws.chunking import steps
from kinegraph.stream.laws.laws import Conformance
from kinegraph.stream.laws.play import Player, differ
from kinegraph.stream.laws.violations import Broken


def bad_samples(trial: Conformance) -> None:
    """Law 6: a stretch of NaN, and of infinity, in one number of each float input in turn."""
    for port, tape in trial.tapes.items():
        if tape.is_float and len(tape) >= 8:
            _bad_stretch(trial, port, tape)


def _bad_stretch(trial: Conformance, port: str, tape: CaseSamples) -> None:
    slowest = max([tape.spec.period_ns, *(o.spec.period_ns for o in trial.reference.outputs.values())])
    length = max(3, len(tape) // 20, 3 * slowest // tape.spec.period_ns if tape.spec.period_ns else 0)
    rows = slice(len(tape) // 4, min(len(tape) // 4 + length, len(tape) // 2))
    column = tape.columns().shape[1] // 2
    runs = []
    for value in (np.nan, np.inf, -np.inf):
        tapes = spoil(trial.tapes, port, rows, column, value)
        how = f"{value} in samples {rows.start}..{rows.stop - 1} of '{port}', number {column}"
        with trial.warm(how):
            runs.append(trial.play(steps(tapes, max(1, len(tape) // 7)), tapes))
            if "infinity" not in trial.excused and (difference := differ(runs[0], runs[-1])):
                raise Broken("infinity", f"{difference} (as with NaN)")
    with trial.warm(f"nan in samples {rows.start}..{rows.stop - 1} of '{port}', number {column}"):
        channel = int(np.unravel_index(column, tape.spec.shape)[tape.spec.channel_axis]) if tape.spec.shape else 0
        for name, output in runs[0].outputs.items():
            if len(trial.tapes) == 1 and _keeps_channels(tape.spec, output.spec):
                _channel_by_channel(trial, name, runs[0], channel)
        _recovers(trial, runs[0], int(tape.time[rows.stop - 1]))


def _channel_by_channel(trial: Conformance, name: str, run: Player, bad: int) -> None:
    good, now = trial.reference.outputs[name], run.outputs[name]
    if "channels" not in trial.excused:
        if good.time.tobytes() != now.time.tobytes():
            raise Broken("channels", f"output '{name}': the stamps change")
        for c in range(good.spec.shape[good.spec.channel_axis]):
            if c != bad and _channel(good.spec, good.data, c).tobytes() != _channel(good.spec, now.data, c).tobytes():
                raise Broken("channels", f"output '{name}': channel {c} changes, channel {bad} was bad")
    if "nan" not in trial.excused and not np.isnan(_channel(now.spec, now.data, bad)).any():
        raise Broken("nan", f"output '{name}': channel {bad} has no NaN")


def _recovers(trial: Conformance, run: Player, bad_until: int) -> None:
    """In the last tenth of what comes out, as many values are finite, and about as many samples come, as without the bad ones."""
    if "poison" in trial.excused:
        return
    for name, good in trial.reference.outputs.items():
        now = run.outputs[name]
        late = bad_until + (trial.last - bad_until) * 2 // 3
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


def gaps(trial: Conformance) -> None:
    """Law 6: a silence far longer than any limit, reported by every input."""
    lead = max(trial.tapes.values(), key=len)
    at = int(lead.time[len(lead) // 2])
    shift = round((10 * trial.limit_s + 1000) * NS)
    tapes = pause(trial.tapes, at, shift, marked=True)
    if not any(tape.lost.any() for tape in tapes.values()):
        return
    how = f"a silence of {shift / NS:g} s before {utc(at + shift)}"
    with trial.warm(how):
        run = trial.play(steps(tapes, max(1, trial.longest // 20)), tapes)
        middle = at + shift // 2
        outputs = run.outputs.values()
        after = sum(int((o.time > middle).sum()) for o in outputs)
        if after and "gaps" not in trial.excused and not any(o.pending_gap or any(o.lost) for o in outputs):
            raise Broken("gaps", f"{after} samples come after the silence, and all of them have lost=0")
        if hasattr(trial.case.operator, "reset_gap_s") and "reset" not in trial.excused:
            _restarts(trial, run, tapes, middle)


def _restarts(trial: Conformance, run: Player, tapes: Tapes, middle: int) -> None:
    """Signals after the silence are those of a new instance that begins there."""
    rest = {port: tape.keep(tape.time > middle) for port, tape in tapes.items()}
    rest = {port: replace(tape, lost=np.zeros_like(tape.lost)) for port, tape in rest.items()}
    if not any(len(tape) for tape in rest.values()):
        return
    new = trial.play(steps(rest, max(1, trial.longest // 20)), rest)
    for name, output in run.outputs.items():
        if output.spec.is_event:
            continue
        late = output.time > middle
        same_stamps = output.time[late].tobytes() == new.outputs[name].time.tobytes()
        if not same_stamps or output.data[late].tobytes() != new.outputs[name].data.tobytes():
            what = "values" if same_stamps else "stamps"
            raise Broken("reset", f"output '{name}': after the silence the {what} are not those of a new instance")


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
