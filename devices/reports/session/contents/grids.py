"""What a report says of limbs and stages: tables ready to be printed, and which curves stand over one another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinegraph.devices.reports.session.contents import each_burst, labels
from kinegraph.devices.reports.session.contents.data import Grid, LimbPanel, Report
from kinegraph.devices.reports.session.contents.groups import Groups
from kinegraph.devices.reports.session.contents.running import Running
from kinegraph.devices.reports.session.contents.tally import Tally, numbers
from kinegraph.stream.chunk import Samples, Specs

SHOWN = ("peak", "mean")
"""What the table of stages shows of a muscle; the CSV file has the rest."""
MEASURES = {"peak": "peak", "mean": "mean", "integrated": "iEMG", "duration_s": "stride time", "stance_pct": "stance"}
SYMMETRY = (
    "Symmetry index of Robinson (1987): 100 × (X2 − X1) / half of their sum, X1 the {0} limb, X2 the {1} limb, of neighbouring cycles: 0 is"
    " alike, positive: {1} is larger. Mean over the session with its 95 % interval (Student's t); strides are taken as independent,"
    " which walking is only in part. Amplitudes that are not normalised compare electrodes, too."
)
BESIDE = (
    "Mean curves of both at the same percentage of each limb's own cycle: lowest and highest point, range, and by how much {1} differs from"
    " {0} (root mean square over the cycle, and where it is most)."
)
BURSTS = (
    "When a muscle is active, by a double threshold with hysteresis (Hodges and Bui 1996; thresholds under Settings). Onset, offset and"
    " duration of the burst that holds the cycle's peak: circular mean ± deviation; an offset below the onset lies in the next cycle. Bars:"
    " in which share of the cycles the muscle was active, from 0 % (white) to 100 % (dark)."
)
FREQUENCY = (
    "Median of each cycle's power spectrum of the raw EMG, mean ± standard deviation over the cycles, and the straight line through them."
    " It falls as a muscle tires; walking, it also follows the speed and the electrode."
)
NORMS = (
    "For how much of the cycle the mean curve lies outside the laboratory's own bands ({0}; drawn green behind the curves), and where it is"
    " furthest outside. They hold for the people, the speed, the electrodes and the filters that they were made with."
)
FOOTFALLS = (
    "Phase: when in the reference limb's stride the limb touches down. Duty factor: for how much of the stride it stands. Support is the"
    " share of the stride with two feet or more on the ground, flight that with no foot."
)


def accepted_of(tally: Tally, specs: Specs, channel: int) -> int:
    """How many cycles of a channel's limb were accepted."""
    limbs = dict(specs["cycles"].meta.get("limbs") or {})
    name = specs["cycles"].channels[channel]
    for i, limb in enumerate(tally.groups.limbs):
        if name in limbs[limb]:
            return int(tally.groups.limb_gait[i].n.max(initial=0))
    return tally.accepted


def fill_groups(report: Report, tally: Tally, specs: Specs) -> None:
    """Put limbs and stages into a report, where there are any."""
    groups, spec = tally.groups, specs["cycles"]
    limbs, named = dict(spec.meta.get("limbs") or {}), dict(spec.meta.get("muscles") or {})
    if limbs:
        where = {name: i for i, name in enumerate(spec.channels)}
        muscles = dict.fromkeys(named.get(name, name) for name in spec.channels)
        for muscle in muscles:
            mine = [(limb, where[name]) for limb, names in limbs.items() for name in names if named[name] == muscle]
            report.panels.append(LimbPanel(muscle, [i for _, i in mine], [limb for limb, _ in mine]))
        report.grids.append(_limbs(groups))
    if groups.feet:
        phases = [float(r.centre()[0]) for r in groups.phases]
        duties = [float(r.centre()[0]) for r in groups.duties]
        report.footfalls = list(zip(groups.feet, phases, duties, strict=True))
        report.grids.append(_footfalls(groups))
    if groups.indices:
        if labels.is_angle(spec) and len(limbs) == 2:
            beside = _beside(report.panels, tally.curve.centre(), list(limbs))
            report.grids += [beside] if beside.rows else []
        report.grids.append(
            _symmetry(
                groups,
                [str(name) for name in specs["symmetry"].meta.get("pair", ("", ""))],
                angles=labels.is_angle(spec),
            )
        )
    if groups.burst_names:
        report.grids.append(_bursts(groups, spec.channels))
    if tally.each_burst.seen:
        report.grids.append(
            each_burst.grid(tally.each_burst, spec.channels, spec.units[0] if len(spec.units) == 1 else "")
        )
    if tally.frequencies.seen:
        report.grids.append(_frequencies(tally, spec.channels))
    if tally.peaks.names:
        unit = spec.units[0] if len(spec.units) == 1 else ""
        grid = tally.peaks.grid(unit)
        grid.rows.sort(key=lambda row: place_of(row[0], spec.channels))
        report.grids.append(grid)
        report.modes = [tally.peaks.of(name).tolist() for name in spec.channels]
    if "low" in specs and "high" in specs:
        report.grids += [_norms(tally, specs)] if np.isfinite(tally.norms).any() else []
    if tally.typed.count:
        report.grids.append(tally.typed.grid(max(tally.started, 0)))
    if groups.stages:
        report.stages = list(groups.stages)
        report.grids += _stages(tally, specs)


def place_of(name: str, channels: Sequence[str]) -> int:
    """Where a muscle stands among the channels; what joins several comes last."""
    return list(channels).index(name) if name in channels else len(channels)


def _text(running: Running, i: int, decimals: int) -> str:
    centre, spread = float(running.centre()[i]), float(running.spread()[i])
    if not np.isfinite(centre):
        return "–"
    return f"{centre:z.{decimals}f}" + (f" ± {spread:z.{decimals}f}" if np.isfinite(spread) else "")


def _steps(gait: Running, per_stride: int) -> str:
    """The cadence in steps/min."""
    steps = per_stride * float(gait.centre()[0])
    return f"{steps:.1f}" if np.isfinite(steps) else "–"


def _limbs(groups: Groups) -> Grid:
    columns = [
        ("Limb", ""),
        ("Cycles", ""),
        ("Cadence", "strides/min"),
        ("Cadence", "steps/min"),
        ("Cycle", "s"),
        ("Stance", "%"),
    ]
    per_stride = max(2, len(groups.limbs))
    rows = [
        [
            limb,
            str(int(gait.n.max(initial=0))),
            _text(gait, 0, 1),
            _steps(gait, per_stride),
            _text(gait, 1, 3),
            _text(gait, 2, 1),
        ]
        for limb, gait in zip(groups.limbs, groups.limb_gait, strict=True)
    ]
    return Grid("Limb by limb", "Mean ± standard deviation over the limb's accepted cycles.", columns, rows)


def _footfalls(groups: Groups) -> Grid:
    rows = [
        [limb, _text(phase, 0, 1), _text(duty, 0, 1)]
        for limb, phase, duty in zip(groups.feet, groups.phases, groups.duties, strict=True)
    ]
    gaits = ", ".join(f"{gait} {n}" for gait, n in zip(groups.gaits, groups.strides, strict=True))
    support = " ".join(
        f"{name} {_text(groups.support, i, 1)} {unit}".strip() + ("." if i == 2 else ",")
        for i, (name, unit) in enumerate((("Double support", "%"), ("flight", "%"), ("feet on the ground", "(mean)")))
    )
    note = f"{FOOTFALLS} {support} Strides by gait: {gaits or 'none'}."
    return Grid("Footfalls", note, [("Limb", ""), ("Phase", "% of stride"), ("Duty factor", "%")], rows)


def _beside(panels: Sequence[LimbPanel], mean: Samples, names: list[str]) -> Grid:
    """Two limbs' mean curves of angles at the same percentage of each one's own cycle."""
    rows = []
    for panel in panels:
        curves = mean[:, panel.channels]
        if len(panel.channels) != 2 or np.isnan(curves).any():
            continue
        ends = [f"{low:z.1f} to {high:z.1f}" for low, high in zip(curves.min(0), curves.max(0), strict=True)]
        spans, apart = np.ptp(curves, axis=0), curves[:, 1] - curves[:, 0]
        most = int(np.abs(apart).argmax())
        rows.append([
            panel.name, *ends, *(f"{span:.1f}" for span in spans), f"{np.sqrt(np.mean(apart**2)):.1f}", f"{apart[most]:+.1f} at {most} %",
        ])  # fmt: skip
    columns = [
        ("Angle", ""),
        *((f"{name}, from to", "deg") for name in names),
        *((f"{name}, range", "deg") for name in names),
    ]
    return Grid(
        "Left beside right" if names == ["left", "right"] else "Limb beside limb",
        BESIDE.format(*names),
        [*columns, ("Apart, RMS", "deg"), ("Most", "deg")],
        rows,
    )


def _symmetry(groups: Groups, pair: list[str], *, angles: bool) -> Grid:
    rows = []
    for name, (mean, low, high, pairs) in zip(groups.index_names, groups.indices, strict=True):
        muscle, _, measure = name.partition("|")
        if muscle and angles:
            continue
        wide = f"{low:z.1f} to {high:z.1f}" if np.isfinite(low) else "–"
        rows.append([f"{muscle} {MEASURES.get(measure, measure)}".strip(), f"{mean:z.1f}", wide, str(int(pairs))])
    columns = [("Measure", ""), ("Index", "%"), ("95 % interval", "%"), ("Pairs of cycles", "")]
    return Grid("Symmetry", SYMMETRY.format(*pair), columns, sorted(rows))


def _bursts(groups: Groups, channels: Sequence[str]) -> Grid:
    rows = []
    found = zip(groups.burst_names, groups.bursts, strict=True)
    for name, (cycles, each, *ends) in sorted(found, key=lambda each: place_of(each[0], channels)):
        cells = [
            f"{value:z.0f}" + (f" ± {sd:z.0f}" if np.isfinite(sd) else "") if np.isfinite(value) else "–"
            for value, sd in zip(ends[::2], ends[1::2], strict=True)
        ]
        rows.append([name, str(int(cycles)), f"{each:.1f}" if np.isfinite(each) else "–", *cells])
    columns = [("Muscle", ""), ("Cycles", ""), ("Bursts", "per cycle")]
    columns += [("Onset", "% of cycle"), ("Offset", "% of cycle"), ("Duration", "% of cycle")]
    return Grid("Bursts", BURSTS, columns, rows)


def _frequencies(tally: Tally, channels: Sequence[str]) -> Grid:
    """The median frequencies, and how they change."""
    rows = []
    for i, name in enumerate(channels):
        hz = tally.frequencies.of(i)[:, 2]
        if len(hz) > 1:
            slope = f"{tally.slopes[i]:+z.1f}" if np.isfinite(tally.slopes[i]) else "–"
            rows.append([name, str(len(hz)), f"{hz.mean():.1f} ± {hz.std(ddof=1):.1f}", slope])
    columns = [("Muscle", ""), ("Cycles", ""), ("Median frequency", "Hz"), ("Slope", "% per min")]
    return Grid("Median frequency", FREQUENCY, columns, rows)


def _norms(tally: Tally, specs: Specs) -> Grid:
    """The mean curves beside the laboratory's bands."""
    mean, (low, high) = tally.curve.centre(), tally.norms
    rows = []
    for i, name in enumerate(specs["cycles"].channels):
        if np.isnan(low[:, i]).any() or np.isnan(mean[:, i]).any():
            rows.append([name, "–", "–", "–", "–"])
            continue
        above, below = mean[:, i] > high[:, i], mean[:, i] < low[:, i]
        over = np.where(above, mean[:, i] - high[:, i], np.where(below, mean[:, i] - low[:, i], 0.0))
        furthest = int(np.abs(over).argmax())
        most = f"{over[furthest]:+.1f} at {furthest} %" if over.any() else "–"
        shares = [100 * share.mean() for share in (above | below, above, below)]
        rows.append([name, *(f"{share:.0f}" for share in shares), most])
    unit = specs["cycles"].units[0] if len(specs["cycles"].units) == 1 else ""
    columns = [
        ("Muscle", ""),
        ("Outside", "% of cycle"),
        ("Above", "% of cycle"),
        ("Below", "% of cycle"),
        ("Most", unit),
    ]
    return Grid("Beside the normative bands", NORMS.format(specs["low"].meta.get("norms", "a table")), columns, rows)


def _stages(tally: Tally, specs: Specs) -> list[Grid]:
    groups, spec = tally.groups, specs["cycles"]
    columns = [
        ("Stage", ""), ("Cycles", ""), ("Belt speed", "m/s"), ("Cadence", "strides/min"), ("Cadence", "steps/min"),
        ("Cycle", "s"), ("Stance", "%"),
    ]  # fmt: skip
    rows = [
        [
            stage,
            str(int(gait.n[0])),
            _text(gait, 3, 2),
            _text(gait, 0, 1),
            _steps(gait, max(2, len(groups.limbs))),
            _text(gait, 1, 3),
            _text(gait, 2, 1),
        ]
        for stage, gait in zip(groups.stages, groups.stage_gait, strict=True)
    ]
    made = [Grid("Stage by stage", "Cycles that lie wholly in a stage; mean ± standard deviation.", columns, rows)]
    fields = numbers(specs.get("statistics"))
    for field in (name for name in SHOWN if name in fields):
        column = labels.column(field, specs["statistics"])
        k = fields.index(field)
        cells = [
            [name, *(_muscle(by_stage, k, i, column.decimals if column else 1) for by_stage in groups.stage_fields)]
            for i, name in enumerate(spec.channels)
        ]
        heading = column.heading if column else field
        unit = specs["statistics"].unit_of(field)
        made.append(
            Grid(f"{heading} by stage", "", [("Muscle", ""), *((stage, unit) for stage in groups.stages)], cells)
        )
    return made


def _muscle(by_stage: Running, field: int, muscle: int, decimals: int) -> str:
    centre, spread = float(by_stage.centre()[field, muscle]), float(by_stage.spread()[field, muscle])
    if not np.isfinite(centre):
        return "–"
    return f"{centre:z.{decimals}f}" + (f" ± {spread:z.{decimals}f}" if np.isfinite(spread) else "")
