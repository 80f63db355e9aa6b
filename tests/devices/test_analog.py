"""NI-DAQ and LabJack through their makers' Python packages, on stand-ins for the drivers' C functions; and a plate's forces by hand."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from kinegraph.devices.analog.inputs import AnalogInput
from kinegraph.devices.analog.labjack import LabJack
from kinegraph.devices.analog.nidaq import NiDaq
from kinegraph.operators.contacts.force_plate import ForcePlate
from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.errors import DeviceError, ParameterError
from tests.devices.ni_driver import LjmLibrary, NiDriver
from tests.support.device_feed import check, reading, wait_for
from tests.support.one_stream import run

INPUTS = (AnalogInput("ai0", "fz", scale=200.0, unit="N"), AnalogInput("ai1", offset=-1.0, range_v=5.0))


@pytest.fixture
def ni(monkeypatch: pytest.MonkeyPatch) -> Iterator[NiDriver]:
    library = pytest.importorskip("nidaqmx._lib")
    driver = NiDriver()
    for name in ("_windll", "_cdll"):
        monkeypatch.setattr(library.lib_importer, name, library.DaqFunctionImporter(driver))
    monkeypatch.setattr(library.lib_importer, "_encoding", "utf-8")
    yield driver


def test_ni_inputs_are_read_scaled_and_counted(ni: NiDriver) -> None:
    source = NiDaq(INPUTS, device="cDAQ1Mod1", rate_hz=2000.0)
    with reading(source) as feed:
        wait_for(lambda: feed.error is not None or feed.count("out") > 1500)
    assert feed.error is None, feed.error
    check(source, feed)
    assert ni.channels == [("cDAQ1Mod1/ai0", -10.0, 10.0), ("cDAQ1Mod1/ai1", -5.0, 5.0)] and ni.rate == 2000
    n = feed.count("out")
    wanted = np.stack([200 * (np.arange(n) % 1000 / 1000), np.arange(n) % 1000 / 1000], axis=1)
    assert np.allclose(feed.data("out"), wanted) and source.specs()["out"].channels == ("fz", "ai1")
    assert np.median(np.diff(feed.time("out"))) == pytest.approx(5e5, rel=1e-3)
    assert ni.calls[-2:] == ["DAQmxStopTask", "DAQmxClearTask"] or ni.calls[-1] == "DAQmxClearTask"


def test_a_buffer_that_has_run_over_ends_the_reading(ni: NiDriver) -> None:
    ni.overflow = 5
    with reading(NiDaq(INPUTS)) as feed:
        wait_for(lambda: feed.error is not None)
    assert isinstance(feed.error, DeviceError) and "-200279" in str(feed.error)
    assert "DAQmxClearTask" in ni.calls


def test_without_nis_driver_that_is_told() -> None:
    pytest.importorskip("nidaqmx")
    with reading(NiDaq(INPUTS)) as feed:
        wait_for(lambda: feed.error is not None)
    assert "install NI-DAQmx" in str(feed.error)


@pytest.fixture
def ljm(monkeypatch: pytest.MonkeyPatch) -> LjmLibrary:
    module = pytest.importorskip("labjack.ljm.ljm")
    library = LjmLibrary()
    monkeypatch.setattr(module, "_staticLib", library)
    return library


def test_labjack_scans_lost_keep_their_places(ljm: LjmLibrary) -> None:
    ljm.lose = 37
    source = LabJack((AnalogInput("AIN0", "a"), AnalogInput("AIN1", scale=2.0)), rate_hz=1000.0)
    with reading(source) as feed:
        wait_for(lambda: feed.error is not None or feed.count("out") > 800)
    assert feed.error is None, feed.error
    check(source, feed)
    index = np.arange(feed.count("out"))
    kept, data = index % 37 != 0, feed.data("out")
    assert np.isnan(data[~kept]).all() and np.allclose(data[kept, 0], index[kept] % 1000 / 1000)
    assert np.allclose(data[kept, 1], 2 * (1 + index[kept] % 1000 / 1000))
    assert feed.problems["lost scan"] == (~kept).sum() and ljm.stopped


def test_a_rate_that_the_labjack_cannot_keep_is_refused(ljm: LjmLibrary) -> None:
    ljm.true_rate = 980.0
    with reading(LabJack((AnalogInput("AIN0"),))) as feed:
        wait_for(lambda: feed.error is not None)
    assert "write rate_hz: 980" in str(feed.error)


def test_without_ljm_that_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    module = pytest.importorskip("labjack.ljm.ljm")
    monkeypatch.setattr(module, "_staticLib", None)
    with pytest.raises(DeviceError, match="LJM library is not there"):
        LabJack((AnalogInput("AIN0"),)).prepare()


@pytest.mark.parametrize("inputs", [(), (AnalogInput("ai0"), AnalogInput("ai1", "ai0"))])
def test_inputs_need_names_of_their_own(inputs: tuple[AnalogInput, ...]) -> None:
    with pytest.raises(ParameterError, match="at least one input"):
        NiDaq(inputs).specs()


NAMES = tuple(f"v{i}" for i in range(6))


def test_a_weight_on_a_known_place_is_found_there() -> None:
    """A force at a point of the surface, turned into the volts of a plate with its origin 40 mm below and beside its middle."""
    rng = np.random.default_rng(8)
    origin = np.array([0.01, -0.02, -0.04])
    matrix = np.diag([150.0, 160, 300, 60, 65, 30]) + rng.normal(0, 2, (6, 6))
    force = np.column_stack([rng.uniform(-100, 100, (50, 2)), rng.uniform(300, 900, 50)])
    point = np.column_stack([rng.uniform(-0.2, 0.2, (50, 2)), np.zeros(50)])
    wrench = np.hstack([force, np.cross(point - origin, force)])
    volts = np.linalg.solve(matrix, wrench.T).T + 0.25
    plate = ForcePlate(NAMES, tuple(map(tuple, matrix.tolist())), zero_v=(0.25,) * 6, origin_m=tuple(origin.tolist()))
    spec = StreamSpec((6,), rate_hz=1000.0, channels=NAMES, units=("V",))
    made, _, out, _ = run(plate, volts, spec=spec)
    assert made.units == ("N", "N", "N", "Nm", "Nm", "Nm", "m", "m")
    assert np.allclose(out[:, :3], force) and np.allclose(out[:, 3:6], np.cross(point, force))
    assert np.allclose(out[:, 6:], point[:, :2])


def test_two_belts_are_two_plates_of_one_signal() -> None:
    both = (*(f"l{i}" for i in range(6)), *(f"r{i}" for i in range(6)))
    spec = StreamSpec((12,), rate_hz=1000.0, channels=both, units=("V",))
    eye = tuple(map(tuple, np.diag([1.0, 1, 100, 1, 1, 1]).tolist()))
    volts = np.zeros((4, 12))
    volts[:2, 2], volts[2:, 8] = 7.0, 7.0
    left = run(ForcePlate(both[:6], eye), volts, spec=spec)[2]
    right = run(ForcePlate(both[6:], eye), volts, spec=spec)[2]
    assert left[:, 2].tolist() == [700, 700, 0, 0] and right[:, 2].tolist() == [0, 0, 700, 700]
    assert np.isnan(left[2:, 6]).all() and left[0, 6] == 0, "the plate is empty"


@pytest.mark.parametrize("more", [{"matrix": ((1.0,) * 6,) * 5}, {"zero_v": (1.0,)}, {"origin_m": (1.0,)}])
def test_a_calibration_that_cannot_be_is_refused(more: dict[str, object]) -> None:
    matrix = tuple(map(tuple, np.eye(6).tolist()))
    plate = ForcePlate(NAMES, **{"matrix": matrix, **more})  # type: ignore[arg-type]
    with pytest.raises(ParameterError):
        plate.open({"in": StreamSpec((6,), rate_hz=1000.0, channels=NAMES)})
