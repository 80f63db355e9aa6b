"""The mean curves of a session as a table: a row per stage, muscle and point of the cycle."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kinegraph.devices.reports.session.contents.running import Running
from kinegraph.devices.reports.session.contents.tally import Tally
from kinegraph.stream.chunk import Specs
from kinegraph.stream.data.csv_writer import Sheet
from kinegraph.stream.system.atomic_file import complete


def write_curves(path: Path, tally: Tally, specs: Specs, recording: str) -> None:
    """Write them, whole or not at all; each row names the `recording`. Raises OSError."""
    spec, groups = specs["cycles"], tally.groups
    parts: list[tuple[str, Running]] = list(zip(groups.stages, groups.stage_curves, strict=True)) or [("", tally.curve)]
    limb = {channel: name for name, mine in dict(spec.meta.get("limbs") or {}).items() for channel in mine}
    unit = f" ({spec.units[0]})" if len(spec.units) == 1 and spec.units[0] else ""
    with complete(path) as draft, draft.open("w", newline="", encoding="utf-8") as file:
        sheet = Sheet(file)
        sheet.writerow(["stage", "limb", "muscle", "cycles", "cycle_pct", f"mean{unit}", f"sd{unit}", "recording"])
        for stage, curve in parts:
            mean, sd = curve.centre(), curve.spread()
            for i, name in enumerate(spec.channels):
                if not np.isfinite(mean[:, i]).any():
                    continue
                for p in range(len(mean)):
                    numbers = int(curve.n[p, i]), p, float(mean[p, i]), float(sd[p, i])
                    sheet.writerow([stage, limb.get(name, ""), name, *numbers, recording])
