"""The importers of laboratories' exports: each recognises its own files by their content, and loads its reader when it reads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kinegraph.devices.formats.importer import Importer
from kinegraph.stream.errors import RecordingError

if TYPE_CHECKING:
    from kinegraph.devices.formats.column_table import ImportOptions
    from kinegraph.stream.recording.series import Series


def _through(made: Any) -> tuple[list[Series], ImportOptions]:
    """What a reader that is known by its name only gives."""
    series, options = made
    return series, options


def _of(module: str) -> Any:
    """A module of formats/lab/, or of another format's folder ("edf.reader")."""
    return import_module(f"kinegraph.devices.formats.{module if '.' in module else f'lab.{module}'}")


def _grammar(
    what: str,
    suffixes: tuple[str, ...],
    module: str,
    read: str,
    knows: str = "knows",
    kind: str = "",
    *,
    untried: bool = False,
) -> Importer:
    """An importer with its reader and its content check in a module of this folder."""

    def claims(path: Path, head: bytes) -> bool:
        text = _of("text_lines").decoded(head)
        return "\0" not in text[:200] and bool(getattr(_of(module), knows)(text.lstrip("\ufeff")))

    def read_all(files: Sequence[Path], options: ImportOptions, last: bool) -> tuple[list[Series], ImportOptions]:
        return _through(_of("reading").reader(kind or what, getattr(_of(module), read))(files, options, last))

    return Importer(what, suffixes, read_all, order=30, claims=claims, untried=untried)


def _is_edf(path: Path, head: bytes) -> bool:
    return bool(_of("edf.reader").knows(head))


def _edf(files: Sequence[Path], options: ImportOptions, last: bool) -> tuple[list[Series], ImportOptions]:
    def read(path: Path, asked: Any) -> Any:
        made = _of("edf.reader").read_edf(path, asked)
        _of("bids").correct_units(made, path)
        return made

    return _through(_of("reading").reader("an EDF or BDF file", read)(files, options, last))


def _is_bids_motion(path: Path, head: bytes) -> bool:
    return bool(_of("bids").is_motion(path))


def _bids_motion(files: Sequence[Path], options: ImportOptions, last: bool) -> tuple[list[Series], ImportOptions]:
    return _through(_of("reading").reader("a BIDS table of motion", _of("bids").read_motion)(files, options, last))


def _is_matlab(path: Path, head: bytes) -> bool:
    return bool(_of("matlab").knows(head))


def _matlab(files: Sequence[Path], options: ImportOptions, last: bool) -> tuple[list[Series], ImportOptions]:
    """Arrays that are streams as somebody says; without a word every matrix that is long enough, if the file tells its rate."""
    from kinegraph.devices.formats.column_table import ColumnTable, make
    from kinegraph.stream.data.bounded import reading
    from kinegraph.stream.data.tables import FileColumn

    table = ColumnTable()
    for file in files:
        if not file.is_file():
            raise RecordingError(f"{file}: there is no such file")
        with reading(file, "a MATLAB file"):
            arrays = _of("matlab").read_arrays(file)
        table.put(file, {name: FileColumn(array, file) for name, array in arrays.items()})
        options.findings.kinds[file] = "MATLAB arrays: " + ", ".join(f"{n} {a.shape}" for n, a in arrays.items())
        if not options.streams and not options.events:
            _by_default(file, arrays, options)
    return make(table, options), options


def _untimed(file: Path, name: str, stream: str) -> str:
    return f"{file.name}: {name} has neither times nor a rate; give --rate {stream}=HZ; times below count samples"


MIN_SAMPLES = 16
"""A shorter array is taken for something else than a signal."""


def _by_default(file: Path, arrays: dict[str, Any], options: ImportOptions) -> None:
    """Every matrix of numbers with more than a few rows; a vector of that length called time, or the file's rate, says when."""
    long = {name: a for name, a in arrays.items() if a.dtype.kind in "iuf" and a.ndim <= 3 and len(a) >= MIN_SAMPLES}
    times = {
        name
        for name, a in long.items()
        if a.ndim == 1 and name.rpartition(".")[2].lower() in ("t", "time", "times", "t_s")
    }
    has_rate = bool(options.of(options.rate, "") or options.of(options.time, ""))
    for name in sorted(long.keys() - times):
        rate = _of("matlab").rate_of(arrays, name)
        has_time = has_rate or bool(rate)
        stream = f"{file.stem}.{name.rpartition('.')[2]}"
        stream = f"{file.stem}.{name.replace('.', '_')}" if stream in options.streams else stream
        time = next((t for t in times if len(long[t]) == len(long[name])), "")
        if not (time or has_time or stream in options.rate or options.preview):
            raise RecordingError(
                f"{file}: {name!r} {long[name].shape} has no times, and the file no rate; give --rate {stream}=HZ"
            )
        options.streams[stream] = [f"{file.stem}:{name}"]
        if time and stream not in options.rate:
            options.time[stream] = f"{file.stem}:{time}"
        elif stream not in options.rate and not options.rate.get(""):
            options.rate[stream] = str(rate or 1.0)
            if not rate:
                options.findings.doubts.append(_untimed(file, name, stream))
    if not options.streams:
        listed = ", ".join(f"{name} {a.shape}" for name, a in arrays.items())
        raise RecordingError(
            f"{file}: there is no matrix of {MIN_SAMPLES} samples or more in it; it holds {listed or 'nothing'}"
        )


EMGWORKS = _grammar("Delsys EMGworks", (".csv",), "delsys", "read_emgworks", "is_emgworks")
DISCOVER = _grammar("Delsys Trigno Discover", (".csv",), "delsys", "read_discover", "is_discover")
NORAXON = _grammar("Noraxon", (".csv",), "noraxon", "read_noraxon")
VICON = _grammar("Vicon Nexus", (".csv",), "vicon", "read_vicon")
QUALISYS = _grammar("Qualisys", (".tsv",), "qualisys", "read_qualisys")
TRC = _grammar("OpenSim markers", (".trc",), "opensim", "read_trc", "is_trc")
STORAGE = _grammar("OpenSim storage", (".mot", ".sto"), "opensim", "read_storage", "is_storage")
MT_MANAGER = _grammar("Xsens MT Manager, Movella DOT", (".txt", ".csv"), "mt_manager", "read_mt_manager")
APDM = _grammar("APDM", (".csv",), "apdm", "read_apdm")
OPENBCI = _grammar("OpenBCI GUI", (".txt",), "openbci", "read_openbci")
CONSENSYS = _grammar("Shimmer Consensys", (".csv",), "consensys", "read_consensys")
POLAR = _grammar("Polar Sensor Logger", (".txt",), "polar", "read_polar")
FORCES = _grammar("Cortex forces", (".forces",), "cortex", "read_forces", "is_forces")
ANC = _grammar("Cortex analogue", (".anc",), "cortex", "read_anc", "is_anc")
MVNX = _grammar("Xsens MVN", (".mvnx",), "mvnx", "read_mvnx", untried=True)
EDF = Importer("EDF and BDF", (".edf", ".bdf"), _edf, order=30, claims=_is_edf)
BIDS_MOTION = Importer("BIDS motion", (".tsv",), _bids_motion, order=29, claims=_is_bids_motion)
MATLAB = Importer("MATLAB", (".mat",), _matlab, order=90, claims=_is_matlab)


def _binary(what: str, suffix: str, module: str, read: str, knows: Callable[[Any, Path, bytes], bool]) -> Importer:
    """An importer of files that are no text."""

    def claims(path: Path, head: bytes) -> bool:
        return knows(_of(module), path, head)

    def read_all(files: Sequence[Path], options: ImportOptions, last: bool) -> tuple[list[Series], ImportOptions]:
        return _through(_of("lab.reading").reader(what, getattr(_of(module), read))(files, options, last))

    return Importer(what, (suffix,), read_all, order=30, claims=claims)


GT3X = _binary("ActiGraph", ".gt3x", "wearables.actigraph", "read_gt3x", lambda m, _, head: bool(m.is_gt3x(head)))
AGD = _binary(
    "ActiLife epochs", ".agd", "wearables.actigraph", "read_agd", lambda m, path, head: bool(m.is_agd(path, head))
)
AXIVITY = _binary("Axivity", ".cwa", "wearables.axivity", "read_cwa", lambda m, _, head: bool(m.knows(head)))
ACTILIFE = _grammar("ActiLife export", (".csv",), "wearables.actigraph", "read_csv", "is_csv")
AWD = _grammar("Actiwatch", (".awd",), "wearables.actiwatch", "read_awd", "is_awd")
ACTIWARE = _grammar("Actiware, MotionWare", (".csv",), "wearables.actiwatch", "read_actiware", "is_actiware")
MOTIONWATCH = _grammar("MotionWatch", (".mtn",), "wearables.actiwatch", "read_motionwatch", "is_motionwatch")
GENEACTIV = _grammar("GENEActiv", (".bin",), "wearables.geneactiv", "read_bin")
OPENSIGNALS = _grammar("OpenSignals", (".txt",), "wearables.opensignals", "read_opensignals")
