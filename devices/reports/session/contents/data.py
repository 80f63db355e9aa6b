"""What a session's report is made of: plain numbers and texts, kept in one file until the page is drawn from it."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from kinegraph.stream.chunk import Samples
from kinegraph.stream.data.bounded import arrays, reading
from kinegraph.stream.params import adapter
from kinegraph.stream.system.atomic_file import complete


@dataclass(slots=True)
class ReportValue:
    """A number for people: "57.1 ± 0.9 strides/min". `spread` is a standard deviation."""

    label: str
    value: float
    unit: str = ""
    spread: float = float("nan")
    decimals: int = 1


@dataclass(slots=True)
class Column:
    """A column of the table of muscles. `note` stands under the table."""

    heading: str
    unit: str = ""
    decimals: int = 1
    note: str = ""


@dataclass(frozen=True, slots=True)
class Muscle:
    """One muscle: its row of the table (a value and a standard deviation per column) and the remarks on its signal.

    troubled  share of the time in which the signal was not good
    verdict   "good", "doubtful" or "bad"; "" where quality was not measured
    """

    name: str
    site: str = ""
    verdict: str = ""
    remark: str = ""
    values: list[tuple[float, float]] = field(default_factory=list)
    troubled: float = 0.0


@dataclass(frozen=True, slots=True)
class Rejected:
    """A cycle that was left out of everything."""

    time_s: float
    duration_s: float
    reason: str


@dataclass(frozen=True, slots=True)
class Noticed:
    """An alarm of the session: since when, for how long (NaN: to the end), with whom, and what."""

    time_s: float
    lasted_s: float
    subject: str
    what: str


@dataclass(frozen=True, slots=True)
class Stream:
    """What came in by one stream, and what did not."""

    name: str
    what: str
    samples: int
    gaps: int = 0
    lost: int = 0


@dataclass(frozen=True, slots=True)
class Setting:
    """One node of the graph."""

    node: str
    use: str
    parameters: str
    delay_ms: float = float("nan")


@dataclass(frozen=True, slots=True)
class LimbPanel:
    """A muscle of several limbs: where each limb's curve stands among the channels, and the limbs' names."""

    name: str
    channels: list[int]
    limbs: list[str]


@dataclass(slots=True)
class Grid:
    """A table that is ready to be printed: headings with units, rows of texts; the first column is text, the others are numbers."""

    title: str
    note: str
    columns: list[tuple[str, str]]
    rows: list[list[str]]


@dataclass(slots=True)
class Report:
    """Everything on the page but the curves. Times in ns of session time (UTC)."""

    title: str
    unit: str
    normalisation: str
    started: int = 0
    ended: int = 0
    interim: bool = False
    facts: list[tuple[str, str]] = field(default_factory=list)
    accepted: int = 0
    rejected: int = 0
    reasons: list[tuple[str, int]] = field(default_factory=list)
    rejections: list[Rejected] = field(default_factory=list)
    alarms: list[Noticed] = field(default_factory=list)
    alarmed: int = 0
    gait: list[ReportValue] = field(default_factory=list)
    columns: list[Column] = field(default_factory=list)
    muscles: list[Muscle] = field(default_factory=list)
    pairs: list[ReportValue] = field(default_factory=list)
    pairs_note: str = ""
    streams: list[Stream] = field(default_factory=list)
    settings: list[Setting] = field(default_factory=list)
    versions: list[tuple[str, str]] = field(default_factory=list)
    graph: str = ""
    table_file: str = ""
    stance_percent: float = float("nan")
    envelopes: bool = True
    """Whether the curves are envelopes of EMG, not an angle's, a moment's or a force's."""
    panels: list[LimbPanel] = field(default_factory=list)
    grids: list[Grid] = field(default_factory=list)
    stages: list[str] = field(default_factory=list)
    footfalls: list[tuple[str, float, float]] = field(default_factory=list)
    modes: list[list[list[float]]] = field(default_factory=list)
    hanging: list[tuple[str, float]] = field(default_factory=list)
    """Muscles, and the change (%) of their means in stance and swing where contacts are `contact_ms` off."""
    contact_ms: float = 0.0
    unjudged: list[tuple[str, int]] = field(default_factory=list)
    """Watches that had too few cycles to say anything: the report's input, and how many they need of a limb."""
    unnamed: list[str] = field(default_factory=list)
    """Channels with names of no muscle that has a reference pattern."""


@dataclass(slots=True)
class Curves:
    """Time-normalised curves of m muscles.

    mean, sd   (100, m)     over all accepted cycles; NaN where there are too few
    single     (k, 100, m)  some of the single cycles, evenly chosen
    active     (100, m)     in which share of the cycles each muscle was active
    stages     (s, 100, m)  mean curves of each stage
    norms      (2, 100, m)  normative bands, low and high; NaN for a muscle without them
    """

    mean: Samples
    sd: Samples
    single: Samples
    active: Samples = field(default_factory=lambda: np.zeros((0, 0)))
    stages: Samples = field(default_factory=lambda: np.zeros((0, 0, 0)))
    norms: Samples = field(default_factory=lambda: np.zeros((0, 0, 0)))


def save(path: Path, report: Report, curves: Curves) -> None:
    """Write both into one file, whole or not at all. Raises OSError."""
    with complete(path) as draft, draft.open("wb") as file:
        head = np.frombuffer(json.dumps(asdict(report)).encode(), np.uint8)
        np.savez(
            file,
            report=head,
            mean=curves.mean,
            sd=curves.sd,
            single=curves.single.astype(np.float32),
            stages=curves.stages,
            active=curves.active,
            norms=curves.norms,
        )


def load(path: Path) -> tuple[Report, Curves]:
    """What `save` wrote."""
    with reading(path, "a report's data"):
        file = arrays(path)
        report: Report = adapter(Report).validate_json(file["report"].tobytes())
        return report, Curves(
            file["mean"], file["sd"], file["single"].astype(np.float64), file["active"], file["stages"], file["norms"]
        )
