"""Ordinary cameras through PyAV: files that PyAV wrote, and a camera that serves JPEG pictures over HTTP."""

from __future__ import annotations

import errno
import struct
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.cameras.video import Video, container
from kinegraph.devices.cameras.video.importer import VIDEO
from kinegraph.devices.cameras.video.simulator import CLIPS, NetworkCamera, clip_from, network_camera, simulated
from kinegraph.devices.formats.column_table import ImportOptions
from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import DeviceError, ParameterError, RecordingError
from tests.support.device_feed import check, reading, wait_for

av = pytest.importorskip("av")
WIDTH, HEIGHT = 64, 48
RATE = 25


def picture(k: int) -> np.ndarray:
    """A grey ramp with a bright left half whose level tells the frame."""
    made = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    made[:, : WIDTH // 2] = 10 * k % 200 + 20
    return made


def film(path: Path, ticks: list[int]) -> Path:
    """A video whose frame i is shown at ticks[i] / RATE."""
    with av.open(str(path), "w") as made:
        stream = made.add_stream("mpeg4", rate=RATE)
        stream.width, stream.height, stream.bit_rate = WIDTH, HEIGHT, 4_000_000
        stream.codec_context.time_base = Fraction(1, RATE)
        for k, tick in enumerate(ticks):
            frame = av.VideoFrame.from_ndarray(picture(k), format="rgb24")
            frame.pts, frame.time_base = tick, Fraction(1, RATE)
            made.mux(stream.encode(frame))
        made.mux(stream.encode())
    return path


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return film(tmp_path_factory.mktemp("video") / "whole.mp4", list(range(20)))


def played(source: Video) -> object:
    with reading(source) as feed:
        wait_for(lambda: feed.error is not None or feed.count("image") >= source._file().frames)
    assert feed.error is None, feed.error
    check(source, feed)
    return feed


def turned(path: Path, to: Path, a: int, b: int, c: int, d: int) -> Path:
    """The same file as a telephone writes it that was held otherwise: the track's matrix shows (x, y) at (ax + cy, bx + dy)."""
    raw = path.read_bytes()
    plain = struct.pack(">9i", 1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
    at = raw.index(plain, raw.index(b"tkhd"))
    to.write_bytes(
        raw[:at] + struct.pack(">9i", a << 16, b << 16, 0, c << 16, d << 16, 0, 0, 0, 1 << 30) + raw[at + 36 :]
    )
    return to


@pytest.mark.quick
def test_a_file_has_its_own_size_rate_and_times(whole: Path) -> None:
    source = Video(str(whole), realtime=False)
    spec = source.specs()["image"]
    assert (spec.shape, spec.rate_hz) == ((HEIGHT, WIDTH, 3), RATE)
    feed = played(source)
    assert np.diff(feed.time("image")).tolist() == [NS // RATE] * 19
    levels = [frame[10:-10, 8:24].mean() for frame in feed.data("image")]
    np.testing.assert_allclose(levels, [10 * k + 20 for k in range(20)], atol=4)


def test_frames_that_a_file_lacks_are_counted(tmp_path: Path) -> None:
    kept = [k for k in range(40) if k not in (7, 8, 20)]
    feed = played(Video(str(film(tmp_path / "gaps.mp4", kept)), realtime=False))
    assert sorted(feed.lost("image").values()) == [1, 2]
    assert feed.problems["lost frame"] == 3


def test_a_file_without_an_even_rate_is_irregular(tmp_path: Path) -> None:
    ticks = np.cumsum(np.random.default_rng(1).integers(2, 9, 40)).tolist()
    path = tmp_path / "uneven.mkv"
    assert Video(str(film(path, ticks))).specs()["image"].rate_hz is None
    times = played(Video(str(path), realtime=False)).time("image")
    np.testing.assert_allclose(np.diff(times) / NS, np.diff(ticks) / RATE, atol=2e-3)


def test_pictures_are_made_as_large_as_the_graph_says_and_are_not_squeezed(whole: Path) -> None:
    assert Video(str(whole), width=32).specs()["image"].shape == (24, 32, 3)
    assert played(Video(str(whole), width=32, realtime=False)).data("image").shape[1:] == (24, 32, 3)
    with reading(Video(str(whole), width=32, height=32, realtime=False)) as feed:
        wait_for(lambda: feed.error is not None)
    assert "would be squeezed into 32 x 32; write width: 32 and height: 24" in str(feed.error)


def test_a_mirror_exchanges_left_and_right(whole: Path) -> None:
    plain, mirrored = (played(Video(str(whole), mirror=m, realtime=False)).data("image")[9] for m in (False, True))
    assert np.array_equal(plain[:, ::-1], mirrored) and plain[:, 8].mean() > plain[:, -8].mean()


@pytest.mark.parametrize("matrix", [(0, 1, -1, 0), (-1, 0, 0, -1), (0, -1, 1, 0)])
@pytest.mark.parametrize("mirror", [False, True])
def test_a_telephones_film_is_shown_upright(
    whole: Path, tmp_path: Path, matrix: tuple[int, int, int, int], mirror: bool
) -> None:
    source = Video(str(turned(whole, tmp_path / "turned.mp4", *matrix)), mirror=mirror, realtime=False)
    plain = played(Video(str(whole), realtime=False)).data("image")[9]
    a, b, c, d = matrix
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    across, down = a * x + c * y, b * x + d * y
    shown = np.zeros(source.specs()["image"].shape, np.uint8)
    shown[down - down.min(), across - across.min()] = plain
    assert shown.shape == ((WIDTH, HEIGHT, 3) if b else (HEIGHT, WIDTH, 3))
    made = played(source).data("image")
    assert np.array_equal(made[9], shown[:, ::-1] if mirror else shown) and len(made) == 20
    if b:
        assert Video(source.url, width=24).specs()["image"].shape == (32, 24, 3)


def test_a_file_that_is_no_video_is_refused_before_the_session(tmp_path: Path) -> None:
    path = tmp_path / "notes.mp4"
    path.write_bytes(b"not a video at all" * 100)
    with pytest.raises(ParameterError, match="a video file"):
        Video(str(path)).specs()
    with pytest.raises(ParameterError, match="a video file that is there"):
        Video(str(tmp_path / "gone.mp4")).specs()
    assert "there is no video" in Video(str(tmp_path / "gone.mp4")).missing()


def test_a_film_that_is_cut_off_ends_with_what_it_holds(whole: Path, tmp_path: Path) -> None:
    path = film(tmp_path / "whole.mkv", list(range(20)))
    cut = tmp_path / "cut.mkv"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size * 6 // 10])
    with reading(Video(str(cut), realtime=False)) as feed:
        wait_for(lambda: feed.error is not None or feed.count("image") >= 8)
    assert 5 <= feed.count("image") < 20


def test_a_camera_on_the_network_is_read_and_opened_again_when_it_is_gone() -> None:
    with network_camera(WIDTH, HEIGHT, 30.0) as camera:
        source = Video(camera.url, width=WIDTH, height=HEIGHT)
        assert not source.missing()
        with reading(source) as feed:
            wait_for(lambda: feed.error is not None or feed.count("image") > 5)
            assert feed.error is None, feed.error
            camera.unplug()
            wait_for(lambda: feed.error is not None)
        assert isinstance(feed.error, DeviceError)
        check(source, feed)
        with reading(source) as feed:
            wait_for(lambda: feed.error is not None)
        assert "cannot be opened as a video" in str(feed.error)
        camera.plug()
        with reading(source) as feed:
            wait_for(lambda: feed.error is not None or feed.count("image") > 5)
        assert feed.error is None, feed.error


def test_the_simulated_camera_shows_what_its_number_says() -> None:
    with simulated(Video(width=160, height=120)) as source, reading(source) as feed:
        wait_for(lambda: feed.error is not None or feed.count("image") > 3)
    assert feed.error is None, feed.error
    assert source.specs()["image"].meta["camera"]["fx"] == pytest.approx(0.87 * 160), "as the clip was made"
    assert feed.data("image").shape[1:] == (120, 160, 3)
    blue = feed.data("image")[0, 70:100, 70:90].astype(int)
    assert (blue[..., 2] > blue[..., 0] + 40).mean() > 0.9, "the person's shirt"


@pytest.mark.parametrize("clip", CLIPS.values(), ids=CLIPS)
def test_a_shipped_clip_repeats_and_a_late_viewer_need_not_see_it_from_its_beginning(clip: Path) -> None:
    facts = container.file_facts(str(clip))
    length = facts.frames / facts.rate_hz
    assert clip.stat().st_size < 400_000 and (facts.width, facts.height, length) == (640, 480, pytest.approx(8.0))
    begins, ends, _ = next(clip_from(clip, 3 * length + 0.05))
    assert (begins, ends) == (pytest.approx(3 * length), pytest.approx(3 * length + 1 / facts.rate_hz))


def test_what_is_read_without_hurry_is_simulated_by_a_film() -> None:
    """A slow computer loses nothing of it."""
    with simulated(Video(realtime=False, shows="walker")) as source:
        facts = container.file_facts(source.url)
        assert source.is_file and (facts.width, facts.height, facts.rate_hz) == (640, 480, 30.0)
        assert facts.frames == 5 * container.file_facts(str(CLIPS["walker"])).frames
        with container.opened(source.url, 0, 0, 0.0) as (opened, _):
            times = [packet.pts * packet.time_base for packet in opened.demux(video=0) if packet.pts is not None]
    assert max(times) == pytest.approx(40.0, abs=0.05)


def test_a_camera_that_cannot_keep_up_is_unplugged_nevertheless(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its frames are all too late, so none is sent."""

    def late(clip: Path, seconds: float) -> Iterator[tuple[float, float, None]]:
        yield -2.0, -1.0, None
        camera.unplug()
        yield -2.0, -1.0, None
        pytest.fail("it still decodes")

    monkeypatch.setattr("kinegraph.devices.cameras.video.simulator.clip_from", late)
    camera = NetworkCamera(WIDTH, HEIGHT, 30.0)
    try:
        assert not list(camera.pictures())
    finally:
        camera.close()


def test_what_is_missing_is_named() -> None:
    assert "nothing answers at 127.0.0.1:9" in Video("http://127.0.0.1:9/video").missing()
    assert "there is no webcam /dev/video77" in Video("/dev/video77").missing()


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.EACCES, "no permission: sudo usermod -aG video"),
        (errno.EBUSY, "another program has it open; close that one first"),
        (errno.ENODEV, "it is not connected"),
        (errno.EINVAL, "it does not offer this size or rate"),
        (errno.ENOTTY, "it is no webcam; kinegraph devices shows"),
    ],
)
def test_a_webcam_is_asked_for_its_size_and_rate_and_a_refusal_names_what_helps(
    monkeypatch: pytest.MonkeyPatch, number: int, remedy: str
) -> None:
    asked: list[tuple[str, dict[str, object]]] = []

    def refuse(url: str, **given: object) -> None:
        asked.append((url, given))
        raise OSError(number, "the kernel's words", url)

    monkeypatch.setattr(av, "open", refuse)
    with reading(Video("/dev/video3", width=1280, height=720, fps=29.97, lost_after_s=2.0)) as feed:
        wait_for(lambda: feed.error is not None)
    assert isinstance(feed.error, DeviceError) and remedy in str(feed.error)
    options = {"video_size": "1280x720", "framerate": "29.97"}
    assert asked == [("/dev/video3", {"format": "v4l2", "options": options, "timeout": (5.0, 2.0)})]


def test_a_webcam_that_is_gone_is_named_as_such() -> None:
    with reading(Video("/dev/video77")) as feed:
        wait_for(lambda: feed.error is not None)
    assert str(feed.error) == "/dev/video77 cannot be opened as a video (it is not connected)"


def test_a_webcam_may_be_named_by_the_name_that_stays() -> None:
    named = Video("/dev/v4l/by-id/usb-046d_C920-video-index0")
    assert not named.is_file and named.size() == (640, 480)
    assert "there is no webcam /dev/v4l/by-id/usb-046d_C920-video-index0" in named.missing()


def test_a_webcams_exposure_is_fixed_by_the_kernels_controls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """videodev2.h: VIDIOC_S_CTRL takes a control's number and value; exposure is in units of 100 µs, and 1 is manual."""
    asked = []
    monkeypatch.setattr(
        "fcntl.ioctl", lambda camera, request, given: asked.append((request, *struct.unpack("=Ii", given)))
    )
    (tmp_path / "video0").touch()
    container.set_exposure(str(tmp_path / "video0"), 8.0)
    assert asked == [(0xC008561C, 0x009A0901, 1), (0xC008561C, 0x009A0902, 80)]
    monkeypatch.undo()
    with pytest.raises(DeviceError, match="does not take exposure_ms: 8"):
        container.set_exposure(str(tmp_path / "video0"), 8.0)


def test_webcams_are_listed_by_the_kernels_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for node, index, name in (
        ("video0", "0", "Laptop Camera"),
        ("video1", "1", "Laptop Camera"),
        ("video10", "0", "C920"),
    ):
        (tmp_path / node).mkdir()
        (tmp_path / node / "index").write_text(index + "\n")
        (tmp_path / node / "name").write_text(name + "\n")
    monkeypatch.setattr(container, "WEBCAMS", tmp_path)
    assert container.webcams() == [("/dev/video0", "Laptop Camera"), ("/dev/video10", "C920")]
    assert Video().address() == "/dev/video0"


def test_a_password_stays_out_of_the_recording() -> None:
    from kinegraph.devices.cameras.video.source import without_password

    assert without_password("rtsp://anna:secret@10.0.0.7:554/live") == "rtsp://10.0.0.7:554/live"
    assert without_password("films/a@b.mp4") == "films/a@b.mp4"


def test_a_video_is_imported_with_its_times(whole: Path) -> None:
    (series,), _ = VIDEO.read([whole], ImportOptions(), True)
    assert series.name == "whole" and series.data.shape == (20, HEIGHT, WIDTH, 3)
    assert np.diff(series.time).tolist() == [NS // RATE] * 19
    assert VIDEO.claims is not None and VIDEO.claims(whole, whole.read_bytes()[:64])


def test_a_video_that_would_fill_the_disk_is_not_imported(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kinegraph.devices.cameras.video.importer.MAX_BYTES", 10_000)
    with pytest.raises(RecordingError, match="play it in a graph instead"):
        VIDEO.read([whole], ImportOptions(), True)
