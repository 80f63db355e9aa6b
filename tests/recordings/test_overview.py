"""What the recorder leaves of a signal for who looks from afar: the same as a pass over all samples finds; without it nothing is lost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from kinegraph.devices.page.recorded.pyramid import Pyramid
from kinegraph.devices.page.recorded.viewing import RecordingHub
from kinegraph.stream.chunk import NS, Chunk, StreamSpec, grid
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.recording import Recorder, Recording
from kinegraph.stream.recording.format.layout import HEAD
from kinegraph.stream.recording.format.overview import MAX_GAPS, OverviewWriter, unpack, width_of
from kinegraph.stream.recording.read.records import DAMAGE
from kinegraph.stream.recording.recover import rewrite

RATE_HZ, SECONDS = 500.0, 30
SPEC = StreamSpec((3,), rate_hz=RATE_HZ, channels=("a", "b", "c"), units=("uV",))
START = 1_700_000_000 * NS + 12_345


def second(k: int) -> Chunk:
    time = grid(RATE_HZ, int(RATE_HZ), start_ns=START + k * NS)
    data = np.random.default_rng(k).normal(size=(len(time), 3)) * (k + 1)
    if k == 3:
        data[10:200, 1], data[20, 2] = np.nan, np.inf
    return Chunk(time, data, int(time[-1]), 500 if k == 12 else 1 if k == 20 else 0)


def record(path: Path, *, rotate_mb: float = 0.0) -> Path:
    recorder = Recorder(path, {"graph": ""}, RecordingOptions(rotate_mb=rotate_mb), wait=True)
    number = recorder.add_stream("emg", SPEC, "input")
    for sequence, k in enumerate(k for k in range(SECONDS) if k != 11):
        chunk = second(k)
        for part in (chunk.part(0, 100), chunk.part(100, 107), chunk.part(107, 500)):
            recorder.write(number, part, START + k * NS, sequence)
        if rotate_mb and k % 5 == 0:
            recorder.flush()
    recorder.close()
    recorder.check()
    return path


def passed_over(path: Path, width: int, first: int) -> Pyramid:
    """The pyramid that a pass over all samples makes."""
    with Recording.open(path) as recording:
        source = recording.streams["emg"]
        assert source.last
        found = Pyramid(SPEC, first, source.last, width=width)
        found.build(recording.chunks("emg"), lambda share: None)
    return found


@pytest.mark.parametrize("rotate_mb", [0.0, 0.05])
def test_what_the_recorder_saw_is_what_a_pass_over_all_samples_sees(tmp_path: Path, rotate_mb: float) -> None:
    path = record(tmp_path / "s", rotate_mb=rotate_mb)
    with Recording.open(path) as recording:
        assert len(recording.parts) > 1 if rotate_mb else len(recording.parts) == 1
        overviews = recording.overviews("emg")
        source = recording.streams["emg"]
        assert overviews and source.first and source.last
        seen = Pyramid.seen(SPEC, overviews, source.first, source.last)
    expected = passed_over(path, seen.width, seen.first)
    assert np.array_equal(seen.pieces, expected.pieces)
    assert np.array_equal(seen.low, expected.low, equal_nan=True)
    assert np.array_equal(seen.high, expected.high, equal_nan=True)
    if not rotate_mb:
        assert seen.gaps == expected.gaps and len(seen.gaps) == 2


def test_a_recording_with_an_overview_is_seen_from_afar_without_a_pass(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = record(tmp_path / "s")
    with Recording.open(path) as recording:
        hub = RecordingHub(recording)
        monkeypatch.setattr(Pyramid, "build", lambda *_: pytest.fail("all samples were read"))
        hub.build(lambda message: None)
        assert [*hub.pyramids] == [hub.names.index("emg")]


def test_a_file_that_was_recovered_has_one_again(tmp_path: Path) -> None:
    path = record(tmp_path / "s") / "session.0000.mcap"
    content = path.read_bytes()
    path.write_bytes(content[: content.index(b"kinegraph.overview/") - 40])
    rewrite(tmp_path / "s", None)
    with Recording.open(tmp_path / "s") as recording:
        assert recording.overviews("emg")


@pytest.mark.parametrize("spoilt", ["killed", "damaged", "no attachment"])
def test_without_an_overview_all_is_read(tmp_path: Path, spoilt: str) -> None:
    path = record(tmp_path / "s") / "session.0000.mcap"
    content = path.read_bytes()
    at = content.index(b"kinegraph.overview/")
    if spoilt == "killed":
        path.write_bytes(content[: at - 40])
    else:
        changed = bytearray(content)
        changed[at + (0 if spoilt == "no attachment" else 400)] ^= 0xFF
        path.write_bytes(changed)
    with Recording.open(path) as recording:
        assert recording.overviews("emg") is None
        hub = RecordingHub(recording)
        hub.build(lambda message: None)
        time, _ = recording.read("emg")
    assert len(time) == 500 * (SECONDS - 1)
    assert np.isfinite(hub.pyramids[hub.names.index("emg")].low).any()


def test_mcaps_own_reader_lists_it_and_reads_the_rest(tmp_path: Path) -> None:
    with (record(tmp_path / "s") / "session.0000.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert [attachment.name for attachment in reader.iter_attachments()] == ["kinegraph.overview/emg"]
        assert sum(1 for _ in reader.iter_messages(topics=["emg"])) > 0


@pytest.mark.parametrize(
    ("spec", "width"),
    [
        (SPEC, 1 << 26),
        (StreamSpec((16,), rate_hz=2000.0), 1 << 26),
        (StreamSpec((1,), rate_hz=10.0), 1 << 31),
        (StreamSpec((1,)), 0),
        (StreamSpec((3, 4), np.dtype("<u2"), 30.0), 0),
        (StreamSpec((), np.dtype([("onset", "<i8")])), 0),
        (StreamSpec((1000,), rate_hz=100.0), 0),
    ],
)
def test_which_streams_have_one(spec: StreamSpec, width: int) -> None:
    assert width_of(spec) == width


@pytest.mark.parametrize("damage", [b"", b"\0\0\0\0", b"\xff" * 40, b"\4\0\0\0{}  " + bytes(40)])
def test_what_is_no_overview_is_refused(damage: bytes) -> None:
    with pytest.raises(DAMAGE):
        unpack(damage, SPEC)


def test_gaps_have_a_bound() -> None:
    writer = OverviewWriter(SPEC, 1 << 26)
    times = np.arange(3000, dtype=np.int64) * NS
    writer._note_gaps(np.array([[3000, 0, 0, 0, 0]]), times)
    assert len(writer._gaps) == MAX_GAPS


def test_the_kernels_find_what_a_pass_by_numpy_finds() -> None:
    """Values: also NaN, infinite, beyond float32. Stamps: also before 1970, equal, with gaps told and untold."""
    rng = np.random.default_rng(5)
    period, width = SPEC.period_ns, 1 << 26
    data = rng.normal(size=(4000, 3)) * 10.0 ** rng.integers(-5, 45, (4000, 1))
    data[rng.random(data.shape) < 0.2] = np.nan
    data[700:800], data[900, 0] = np.nan, -np.inf
    steps = rng.choice([0, period, 2 * period, 2 * period + 1, 90 * period], 4000, p=[0.1, 0.86, 0.02, 0.01, 0.01])
    times = np.cumsum(steps) - 3 * NS
    rows = np.zeros((41, 5), np.int64)
    rows[:, 0] = [*rng.multinomial(4000, [1 / 40] * 40).tolist(), 0]
    rows[::7, 2], rows[40, 2] = [-1, 3, 0, 1, 2, 5], 9
    writer = OverviewWriter(SPEC, width)
    writer.add(HEAD.pack(len(rows), 4000, 0) + rows.tobytes() + times.tobytes() + data.tobytes())
    found = unpack(writer.pack(), SPEC)

    with np.errstate(over="ignore"):
        values = data.astype(np.float32)
    values[~np.isfinite(values)] = np.nan
    pieces, starts = np.unique(times // width, return_index=True)
    assert np.array_equal(found.pieces, pieces)
    assert np.array_equal(found.low, np.fmin.reduceat(values, starts), equal_nan=True)
    assert np.array_equal(found.high, np.fmax.reduceat(values, starts), equal_nan=True)
    begins = np.cumsum(rows[:, 0]) - rows[:, 0]
    reported = set(begins[(rows[:, 2] != 0) & (rows[:, 0] > 0)].tolist())
    torn = [i for i in range(4000) if i in reported or (i and times[i] - times[i - 1] > 2 * period)]
    assert found.gaps == [(int(times[max(i - 1, 0)]), int(times[i])) for i in torn] and len(torn) > 40


def test_stamps_that_run_backwards_make_further_pieces() -> None:
    """An operator's may, and `replay --verify` says so: what sums them up stays within its memory."""
    times = np.tile(np.array([5, 3, 9, 4], np.int64) * (1 << 26), 500)
    data = np.arange(6000.0).reshape(2000, 3)
    pieces, low, high = OverviewWriter(SPEC, 1 << 26)._extremes(data, times)
    assert pieces.tolist() == [5, 3, 9, 4] * 500
    assert np.array_equal(low, data) and np.array_equal(high, data)
