"""What a notebook does: slices of recordings, other packages' tables, live sessions, things that show themselves."""

from __future__ import annotations

import asyncio
from pathlib import Path

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.operators import Lowpass, Threshold
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.recording.series import write_recording

NS = 10**9
GRAPH = """
nodes:
  board: {use: devices.people.treadmill.Treadmill, realtime: false, duration_s: 20}
  smooth: {use: operators.filters.iir.Lowpass, from: board.emg, cutoff_hz: 6}
record: [smooth]
"""
HOSTILE = "<img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("notebook")
    (folder / "graph.yaml").write_text(GRAPH)
    kg.run(folder / "graph.yaml", folder / "s")
    return folder / "s"


def gappy() -> kg.Series:
    """Two channels at 100 Hz; 30 samples are missing after the first second."""
    spec = kg.StreamSpec((2,), rate_hz=100.0, channels=("TA", HOSTILE), units=("uV", "g"))
    places = np.r_[0:100, 130:200]
    lost = np.zeros(170, np.int64)
    lost[100] = 30
    return kg.Series("emg", spec, 5 * NS + places * 10**7, np.arange(340.0).reshape(170, 2), lost)


@pytest.mark.parametrize(("start", "end"), [(0.0, None), (3.0, 4.5), (19.0, 99.0), (30.0, None), (4.0, 4.0)])
def test_a_slice_is_what_the_whole_holds_there(session: Path, start: float, end: float | None) -> None:
    with kg.Recording.open(session) as recording:
        time, data = recording.read("smooth")
        begin = recording.begin_of_inputs
        wanted = (time >= begin + start * NS) & (time < begin + (99.0 if end is None else end) * NS)
        part = recording.series("smooth", start, end)
        assert (part.time == time[wanted]).all() and part.data.tobytes() == data[wanted].tobytes()
        assert part.spec.channels == recording.streams["smooth"].spec.channels
        with pytest.raises(KinegraphError, match="smooth"):
            recording.series("smoth")


def test_a_series_between_two_times() -> None:
    part = gappy().between(0.5, 1.5)
    assert len(part) == 70 and part.lost is not None and part.lost.sum() == 30
    assert len(gappy().between(1.9)) == 10 and not len(gappy().between(9))
    assert "170 samples of 2 channels" in repr(gappy())


def test_as_xarray(session: Path) -> None:
    xarray = pytest.importorskip("xarray", reason="xarray is not installed")
    made = gappy().to_xarray()
    assert isinstance(made, xarray.DataArray) and made.dims == ("time", "channel")
    assert made.sel(channel="TA").values.tolist() == gappy().data[:, 0].tolist()
    assert made["time"].values[0] == np.datetime64(5 * NS, "ns") and list(made["unit"].values) == ["uV", "g"]
    graph = kg.load(session.parent / "graph.yaml")
    graph.add("active", Threshold(level=20, channel="TA"), "smooth")
    events = graph.run(session, keep=["active.interval"])["active.interval"].to_xarray()
    assert isinstance(events, xarray.Dataset) and {"onset", "end", "peak"} <= set(events)


def test_as_polars() -> None:
    polars = pytest.importorskip("polars", reason="polars is not installed")
    made = gappy().to_polars()
    assert made.columns == ["time", "TA", HOSTILE] and made["time"].dtype == polars.Datetime("ns", "UTC")
    assert made["TA"].to_list() == gappy().data[:, 0].tolist()


def test_as_mne() -> None:
    pytest.importorskip("mne", reason="mne is not installed")
    made = gappy().to_mne()
    assert made.info["sfreq"] == 100 and made.get_channel_types() == ["emg", "misc"] and made.n_times == 200
    values = made.get_data()
    assert np.allclose(values[0, :100], gappy().data[:100, 0] * 1e-6) and (values[:, 100:130] == 0).all()
    assert np.allclose(values[1, 130:], gappy().data[100:, 1])
    (gap,) = made.annotations
    assert (
        gap["description"] == "BAD_gap" and gap["onset"] == pytest.approx(1.0) and gap["duration"] == pytest.approx(0.3)
    )
    one = gappy()
    kept = np.r_[0:40, 41:100]
    (gap,) = kg.Series("emg", one.spec, one.time[kept], one.data[kept]).to_mne().annotations
    assert gap["onset"] == pytest.approx(0.4) and gap["duration"] == pytest.approx(0.01), (
        "a single sample is a gap, too"
    )
    events = kg.Series("none", kg.StreamSpec((1,)), np.zeros(3, np.int64), np.zeros((3, 1)))
    with pytest.raises(KinegraphError, match="regular"):
        events.to_mne()


def test_what_shows_itself_is_text(tmp_path: Path) -> None:
    write_recording(tmp_path / "s.mcap", [gappy()], {"graph": "", "session": {}})
    with kg.Recording.open(tmp_path / "s.mcap") as recording:
        shown = recording._repr_html_()
        assert "emg" in shown and "170" in shown and ">1</td>" in shown
    graph = kg.Graph("low")
    graph.add("emg", kg.Input(channels=["TA", HOSTILE], rate_hz=1000, units=["uV"]))
    graph.add("smooth", Lowpass(cutoff_hz=6), "emg", record=True)
    results = graph.run(np.zeros((100, 2)))
    pages = [graph._repr_html_(), results._repr_html_(), results["smooth"].spec._repr_html_(), shown]
    assert "Lowpass" in pages[0] and "smooth" in pages[1] and "TA" in pages[2]
    assert not [page for page in pages if "<img" in page]


def test_a_live_session_hands_over_what_comes(session: Path, tmp_path: Path) -> None:
    with kg.live(session.parent / "graph.yaml", folder=tmp_path / "s") as live:
        pieces = list(live)
    assert live.outcome and live.outcome.exit_code == 0
    assert {piece.edge for piece in pieces} == {"smooth"}
    taken = np.concatenate([piece.series.data for piece in pieces])
    with kg.Recording.open(tmp_path / "s") as recording:
        whole = recording.read("smooth")[1]
    dropped = sum(piece.dropped for piece in pieces)
    assert (len(taken) == len(whole)) == (not dropped) and taken[-1].tobytes() == whole[-1].tobytes()


def test_a_live_session_in_a_notebooks_loop(session: Path) -> None:
    async def watch() -> int:
        seen = 0
        graph = kg.load(session.parent / "graph.yaml", {"board.realtime": True})
        with kg.live(graph, ["smooth"], duration_s=60) as live:
            async for piece in live:
                seen += len(piece.series)
                if seen > 200:
                    break
        assert live.outcome and live.outcome.exit_code == 0
        return seen

    assert asyncio.run(watch()) > 200


def test_a_slow_program_costs_pieces_not_samples(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kinegraph.stream.api.live.WAITING", 3)
    with kg.live(session.parent / "graph.yaml", folder=tmp_path / "s") as live:
        live._thread.join()
        pieces = list(live)
    with kg.Recording.open(tmp_path / "s") as recording:
        whole = recording.read("smooth")[1]
    assert len(whole) == 20_000 and len(pieces) == 3 and pieces[0].dropped > 0
    assert pieces[-1].series.data[-1].tobytes() == whole[-1].tobytes()


def test_a_session_that_failed_says_so_but_not_in_place_of_the_programs_own_error(
    session: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(self: object) -> None:
        raise KinegraphError("the board fell down")

    monkeypatch.setattr("kinegraph.stream.api.live.Session.run", fail)
    with pytest.raises(KinegraphError, match="fell down"), kg.live(session.parent / "graph.yaml"):
        pass
    with pytest.raises(ZeroDivisionError), kg.live(session.parent / "graph.yaml"):
        raise ZeroDivisionError


def test_a_live_session_of_nothing(session: Path) -> None:
    with pytest.raises(KinegraphError, match="smoot"):
        kg.live(session.parent / "graph.yaml", ["smoot"])
    with pytest.raises(KinegraphError, match=r"taken|exists|already|there"):
        kg.live(session.parent / "graph.yaml", folder=session)
