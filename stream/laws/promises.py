"""Law 5 in the large: what an operator promises about time, and what its specs say of settling."""

from __future__ import annotations

import numpy as np

from kinegraph.stream.chunk import NS, empty, utc
from kinegraph.stream.laws.case_samples import span
from kinegraph.stream.laws.chunking import steps
from kinegraph.stream.laws.laws import Conformance
from kinegraph.stream.laws.play import Player
from kinegraph.stream.laws.violations import Broken

HOUR_NS = 3600 * NS


def delay(trial: Conformance) -> None:
    """Law 5: sample by sample, nothing comes later than declared."""
    start = max(0, trial.longest - 2000)
    with trial.warm("one sample at a time"):
        player = trial.play(steps(trial.tapes, 1, start))
    stamps = np.sort(np.concatenate([tape.time for tape in trial.tapes.values()]))
    wait = int(np.diff(stamps).max(initial=0))
    declared = round(trial.operator.delay_s * NS)
    for name, output in player.outputs.items():
        if output.lag_ns > declared + wait + 1000 and "delay" not in trial.excused:
            raise Broken(
                "delay",
                f"output '{name}' has samples {output.lag_ns / NS:g} s behind the newest input; "
                f"declared are {trial.operator.delay_s:g} s (and {wait / NS:g} s between inputs)",
            )


def time(trial: Conformance) -> None:
    """Law 5: an hour of nothing."""
    player = trial.player()
    _, last = span(trial.tapes)
    with trial.warm("all samples, then an hour in which only `until` advances"):
        for port, chunk in steps(trial.tapes, max(1, trial.longest // 8), ends=False):
            player.feed(port, chunk)
        for port, tape in trial.tapes.items():
            player.feed(port, empty(tape.spec, last + HOUR_NS))
        _time_passed(trial, player, last)


def _time_passed(trial: Conformance, player: Player, last: int) -> None:
    periods = [spec.period_ns for spec in player.specs.values()]
    for name, output in player.outputs.items():
        reached = (
            last + HOUR_NS - round(trial.operator.delay_s * NS) - 2 * max(output.spec.period_ns, *periods) - 1_000_000
        )
        if output.until < reached and "time" not in trial.excused:
            raise Broken(
                "time",
                f"output '{name}' is complete until {utc(output.until)} only, the inputs until {utc(last + HOUR_NS)}",
            )


def settling(trial: Conformance) -> None:
    """Law 6: a regular signal's spec tells what has still to settle in its inputs, too."""
    longer = {port: spec.derive(settling_s=spec.settling_s + 5.0) for port, spec in trial.reference.specs.items()}
    opened = trial.case.operator.unopened().open(longer)
    for name, output in trial.reference.outputs.items():
        declared = opened[name].settling_s
        if output.spec.rate_hz and declared < output.spec.settling_s + 5.0 - 1e-9 and "settling" not in trial.excused:
            raise Broken(
                "settling",
                f"output '{name}' settles in {declared:g} s where the inputs take 5 s longer than in the case; "
                f"there it does in {output.spec.settling_s:g} s",
            )
