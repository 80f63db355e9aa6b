"""Other programs' formats in: what an importer is, which there are, and files read by those that know them.

An importer is an entry point of the group `kinegraph.importers`, so that any package can add a format to `kinegraph files import`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from kinegraph.devices.formats.installed import installed
from kinegraph.stream.errors import RecordingError

if TYPE_CHECKING:
    from kinegraph.devices.formats.column_table import ImportOptions
    from kinegraph.stream.recording.series import Series

GROUP = "kinegraph.importers"
Reader: TypeAlias = "Callable[[Sequence[Path], ImportOptions, bool], tuple[list[Series], ImportOptions]]"


@dataclass(frozen=True, slots=True)
class Importer:
    """A kind of file.

    what      in words, for the help: "XDF"
    suffixes  what the names of such files end in: (".xdf", ".xdfz")
    read      takes all files of this kind, what is wished of streams, and whether no other importer follows; gives the streams, and the
              options that concern other files. Raises RecordingError that names the file
    order     of several importers the lower is asked first; one that takes every wish for its own comes late
    claims    whether a file is of this kind by its content (its path, its first bytes), whatever its name ends in; None: by its name only
    untried   whether no file of a real program was at hand to try it on: such files are refused unless that is wished
    """

    what: str
    suffixes: tuple[str, ...]
    read: Reader
    order: int = 50
    claims: Callable[[Path, bytes], bool] | None = None
    untried: bool = False


@cache
def importers() -> dict[str, Importer]:
    """All that are installed, by name; raises KinegraphError for one that cannot be loaded."""
    return installed(GROUP, "importer")


FOREIGN = {
    ".hpf": "a recording of Delsys EMGworks, which only that reads; export it as CSV with EMGworks or the Delsys File Utility",
    ".shpf": "a recording of Delsys Trigno Discover, which only that reads; export it as CSV there",
    ".tdf": "a recording of BTS (SMART, EMG-Analyzer), which only that reads; export it as C3D there",
    ".asc": "an export of AMTI NetForce without names of its columns; export it with a header line as CSV, or as C3D",
    ".bsf": "a recording of AMTI NetForce, which only that reads; export it as text with a header line (CSV), or as C3D",
    ".dat": "a recording of Kistler BioWare, which only that reads; export it as text with a header line, or as C3D",
    ".nev": "a recording of Noraxon MyoResearch, which only that reads; export it as CSV or C3D there",
    ".mvn": "a recording of Xsens MVN, which only that reads; export it as MVNX or C3D there",
    ".mtb": "a log of Xsens MT Manager, which only that reads; export it as text there",
    ".qtm": "a recording of Qualisys Track Manager, which only that reads; export it as TSV or C3D there",
    ".acq": "a recording of BIOPAC AcqKnowledge, which is not read; save it there as EDF or text",
    ".adicht": "a recording of ADInstruments LabChart, which is not read; export it there as EDF, MATLAB or text",
    ".poly5": "a recording of TMSi Polybench, which is not read; convert it there to EDF",
    ".h5": "an HDF5 file, which is not read; OpenSignals and others write text, too: export that",
}
"""By suffix: files of other programs that are not read, saved by what, and what is to be exported instead."""
HEAD = 1 << 16
"""Bytes of a file that show its kind."""


def listed() -> str:
    """For the help: what can be imported."""
    return "; ".join(f"{one.what}: {', '.join(one.suffixes)}" for one in importers().values())


def importer_of(file: Path, by_suffix: Mapping[str, Importer]) -> Importer:
    """The importer that claims a file by its content, else the one of its suffix. Raises RecordingError for an unknown format."""
    head = _head(file)
    if not head and file.is_file() and file.stat().st_size == 0:
        raise RecordingError(f"{file}: the file is empty")
    for one in sorted(importers().values(), key=lambda one: one.order):
        if head and one.claims is not None and one.claims(file, head):
            return one
    found = by_suffix.get(file.suffix.lower())
    if found is None:
        if head.startswith(b"\x89MCAP"):
            raise RecordingError(f"{file}: is a recording already; `kinegraph info` shows it")
        if foreign := FOREIGN.get(file.suffix.lower()):
            raise RecordingError(f"{file}: this looks like {foreign}")
        raise RecordingError(
            f"{file}: its content does not show what kind of file this is; its name must end in {', '.join(sorted(by_suffix))}"
        )
    return found


def _head(file: Path) -> bytes:
    try:
        with file.open("rb") as opened:
            return opened.read(HEAD)
    except OSError:
        return b""


def _suffixes(kinect: bool) -> dict[str, Importer]:
    """By suffix, the importer of files that no one claims: one without a content check comes before those with one."""
    every = sorted(importers().values(), key=lambda one: one.claims is None)
    by_suffix = {suffix: one for one in every for suffix in one.suffixes}
    if kinect:
        by_suffix |= dict.fromkeys(importers()["table"].suffixes, importers()["motion"])
        by_suffix |= {".npz": importers()["table"], ".npy": importers()["motion"]}
    return by_suffix


def read_files(files: Sequence[Path], options: ImportOptions, *, kinect: bool = False) -> list[Series]:
    """The streams of all files, each kind by its own importer; `kinect`: tables hold the joints of a skeleton. Raises RecordingError."""
    by_suffix = _suffixes(kinect)
    kinds: list[tuple[Importer, list[Path]]] = []
    for file in files:
        if file.exists() and not (file.is_file() or file.is_dir()):
            raise RecordingError(f"{file}: is a pipe or a device; write what comes out of it to a file first")
        one = (
            by_suffix[file.suffix.lower()]
            if kinect and file.suffix.lower() in by_suffix
            else importer_of(file, by_suffix)
        )
        mine = next((mine for other, mine in kinds if other is one), None)
        if mine is None:
            kinds.append((one, [file]))
        else:
            mine.append(file)
    kinds.sort(key=lambda kind: kind[0].order)
    series: list[Series] = []
    for one, mine in kinds:
        if one.untried and not options.untried:
            raise RecordingError(
                f"{mine[0]}: the reader of {one.what} files was only tried on files that we wrote ourselves, never on a real export; "
                "--untried reads it all the same: compare what --preview shows with the program that wrote the file"
            )
        try:
            made, options = one.read(mine, options, one is kinds[-1][0])
        except RecordingError as error:
            if any(str(file) in str(error) for file in mine):
                raise
            raise RecordingError(f"{', '.join(map(str, mine))}: {error}") from None
        for file in mine:
            options.findings.kinds.setdefault(file, one.what)
        for stream in made:
            _pass_gate(stream, mine[0] if len(mine) == 1 else Path(stream.name), options)
        series += made
    return series


def _pass_gate(one: Series, file: Path, options: ImportOptions) -> None:
    """Compare what a stream claims with its samples, as `options.claims` has it; signs of rotations become continuous."""
    from kinegraph.devices.formats.timing import lost_by_stamps, snapped
    from kinegraph.stream.domain.claims import WRONG_BY_STAMPS, ClaimGate, check_series
    from kinegraph.stream.domain.rotation import RotationSigns, rotations

    remedy = "read it at its own rate with --claims measured"
    gate = ClaimGate(one.name, one.spec, wrong=WRONG_BY_STAMPS, remedy=remedy)
    for finding in check_series(gate, one.time, one.data, one.lost):
        options.findings.find(file, finding, options.claims)
        if finding.kind == "rate" and options.claims == "measured":
            rate = snapped(gate.measured_hz)
            one.spec, one.lost = one.spec.derive(rate_hz=rate), lost_by_stamps(one.time, rate)
    if starts := rotations(one.spec):
        one.data = RotationSigns(starts).of(one.data)
