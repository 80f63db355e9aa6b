"""configs/cyton_emg.yaml: eight muscles with an OpenBCI Cyton at 250 Hz, and the steps of an inertial sensor on the foot.

Recording: eight muscles of a treadmill walk (Santuz; MIT), thinned to the board's 250 Hz by scipy. An electrode's offset of 20 mV is added:
the board measures it, and the graph has to remove it.
The foot's motion is simulated at another cadence: no recording holds both.
Truth: the simulated walk's touch-downs; the zero-phase envelope of the same samples by MNE, which has filters of its own.
"""

from __future__ import annotations

import mne
import numpy as np
import pytest
from scipy.signal import decimate

import kinegraph as kg
from kinegraph.devices.people.walking_limb import Limb
from tests.replay.replaying import at, cycles_last_as_long_as_the_files, signal
from tests.support.real import real_arrays

WALK = real_arrays("emg/emg_santuz_tw12.npz")
CHANNELS = ("ME", "MA", "FL", "RF", "VM", "VL", "ST", "BF")
COLUMNS = [WALK["names"].tolist().index(name) for name in CHANNELS]
MUSCLES = decimate(WALK["emg_uV"][:, COLUMNS].astype(float), 4, axis=0)
RATE = 250.0
FOOT = Limb("foot", 100.0)


def filtered(x: np.ndarray, low_hz: float | None, high_hz: float | None, order: int, phase: str = "zero") -> np.ndarray:
    """MNE's Butterworth filter of the columns of `x`."""
    iir = {"order": order, "ftype": "butter"}
    made = mne.filter.filter_data(
        x.T, RATE, low_hz, high_hz, method="iir", iir_params=iir, phase=phase, verbose="error"
    )
    return np.asarray(made.T)


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    motion = FOOT.measure(np.arange(int(100 * len(MUSCLES) / RATE)))
    axes, units = ("ax", "ay", "az", "gx", "gy", "gz"), ("m/s2",) * 3 + ("rad/s",) * 3
    imu = signal(np.hstack([motion["acceleration"], motion["angular_velocity"]]), 100.0, axes, units)
    return kg.load("cyton_emg").run({"board.emg": signal(MUSCLES + 20_000.0, RATE, CHANNELS, ["uV"]), "foot.imu": imu})


def test_cycles_are_those_of_the_simulated_foot(replayed: kg.Results) -> None:
    touchdowns = FOOT.gait.touchdowns(0, int(100 * len(MUSCLES) / RATE)) / 100.0
    cycles_last_as_long_as_the_files(replayed["leg.cycles.closed"], touchdowns, 0.03)


def test_the_envelopes_are_mnes(replayed: kg.Results) -> None:
    offline = filtered(np.abs(filtered(MUSCLES, 20.0, None, 2)), None, 20.0, 4)
    live = replayed["leg.chain.envelope"]
    assert live.spec.channels == CHANNELS
    offline = at(live, np.arange(len(MUSCLES)) / RATE, offline)
    np.testing.assert_allclose(live.data[60:-60], offline[60:-60], atol=0.03 * offline.max())


def test_a_muscles_loudest_moment_comes_once_a_stride(replayed: kg.Results) -> None:
    """The file's touch-downs say how long a stride takes; the lag at which an envelope is most like itself says so, too."""
    live = replayed["leg.chain.envelope"]
    stride_s = np.diff(WALK["touchdown_s"]).mean()
    for muscle in (live.data - live.data.mean(axis=0)).T:
        likeness = np.correlate(muscle, muscle, "full")[len(muscle) :]
        lag = 60 + likeness[60:200].argmax()
        assert (lag + 1) / 120.0 == pytest.approx(stride_s, rel=0.05)
