"""The screen's table of muscles: the modes of their peaks, how far they have moved, and their targets, beside their numbers."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from kinegraph.devices.outlets.terminal.cycle_table import CycleTable, cycle_table
from kinegraph.operators.cycles.statistics.cycle_targets import CycleTargets, TargetBand
from kinegraph.operators.cycles.statistics.operator import CycleStatistics
from kinegraph.operators.emg.mixtures.operator import PeakMixtures
from kinegraph.stream.chunk import Chunk
from kinegraph.stream.errors import InputError
from tests.gait.test_emg_drift import drifted, moved
from tests.gait.test_emg_mixtures_live import bursts
from tests.support.emg_run import drive

FIELDS = ("peak", "peak_pct")


def test_modes_distance_and_targets_stand_beside_a_muscles_numbers(capsys: pytest.CaptureFixture[str]) -> None:
    inputs = moved(bursts(40), 30, 8)
    cycles = {port: inputs[port] for port in ("closed", "cycles")}
    high = float(inputs["cycles"][2][-1, :, 0].max())
    bands = (TargetBand("TA", 0.0, 10 * high), TargetBand("TA", 5 * high, 10 * high, 40.0, 60.0, "peak"))
    statistics = drive(CycleStatistics(), cycles)["out"]
    given = {
        "modes": drive(PeakMixtures(), inputs)["modes"],
        "distance": drifted(inputs)["distance"],
        "targets": drive(CycleTargets(bands), cycles)["targets"],
    }
    screen = CycleTable(fields=FIELDS)
    specs = {
        "closed": inputs["closed"][0],
        "statistics": statistics[0],
        **{port: one[0] for port, one in given.items()},
    }
    screen.open(specs)
    for port, (_, times, rows) in given.items():
        for k in range(len(rows)):
            screen.process(port, Chunk(times[k : k + 1], rows[k : k + 1], int(times[k])))
    last = statistics[2][statistics[2]["number"] == statistics[2]["number"].max()]
    table = cycle_table("", last, FIELDS, statistics[0], screen.state.notes)
    console = Console(width=300, record=True, file=io.StringIO())
    console.print(table)
    shown = console.export_text()
    row = given["distance"][2][-len(last)]
    assert f"{row['from_first']:.2f} ({row['limit']:.2f})" in shown
    modes = given["modes"][2]
    newest = modes[(modes["name"] == "TA") & (modes["number"] == modes["number"].max())]
    assert ", ".join(f"{m['place_pct']:.0f} ({m['weight']:.0%})" for m in newest) in shown, (
        "the newest cycle's modes only"
    )
    assert "within" in shown and "below" in shown
    assert "of 40 cycles within" in capsys.readouterr().out.splitlines()[-1]
    with pytest.raises(InputError, match="place_pct"):
        CycleTable(fields=FIELDS).open({**specs, "modes": inputs["closed"][0]})
