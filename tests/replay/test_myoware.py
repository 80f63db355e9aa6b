"""configs/myoware.yaml: two cheap muscle sensors on an Arduino, their envelopes, and when the shin's muscle is active.

Recording: tibialis anterior and soleus of a treadmill walk (Santuz; MIT), every second sample and made as loud as the sensor's output (mV).
Truth: scipy's envelope; the bursts are read off that curve by numpy, with the graph's own two levels.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.stream.chunk import NS
from tests.replay.replaying import at, emg_envelope, signal
from tests.support.real import real_arrays

WALK = real_arrays("emg/emg_santuz_tw12.npz")
MILLIVOLT = 2.0 * WALK["emg_uV"][::2, [WALK["names"].tolist().index(name) for name in ("TA", "SO")]].astype(float)
SECONDS = WALK["t_s"][::2]
LEVEL, RELEASE, SHORTEST_S = 120.0, 60.0, 0.05


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    emg = signal(MILLIVOLT, 500.0, ["tibialis", "soleus"], ["mV"], time_s=SECONDS)
    return kg.load("myoware").run({"arduino": emg})


def bursts(seconds: np.ndarray, curve: np.ndarray) -> list[tuple[float, float]]:
    """From where a curve rises above the level to where it falls below the release, where that is long enough."""
    found, begin = [], None
    for moment, value in zip(seconds, curve, strict=True):
        if begin is None and value > LEVEL:
            begin = moment
        elif begin is not None and value < RELEASE:
            found += [(begin, moment)] if moment - begin >= SHORTEST_S else []
            begin = None
    return found


def test_the_envelopes_are_scipys(replayed: kg.Results) -> None:
    live = replayed["envelope"]
    offline = at(live, SECONDS, emg_envelope(MILLIVOLT, 500.0))
    np.testing.assert_allclose(live.data[30:-30], offline[30:-30], atol=0.01 * offline.max())


def test_bursts_are_where_scipys_envelope_crosses_the_levels(replayed: kg.Results) -> None:
    fine = np.arange(SECONDS[0], SECONDS[-1], 1 / 120)
    expected = bursts(fine, np.interp(fine, SECONDS, emg_envelope(MILLIVOLT, 500.0)[:, 0]))
    found = replayed["active.interval"].data
    assert len(expected) >= 6
    assert abs(len(found) - len(expected)) <= 1  # one that has not ended when the recording does
    n = min(len(found), len(expected))
    np.testing.assert_allclose(found["onset"][:n] / NS, [a for a, _ in expected[:n]], atol=0.02)
    np.testing.assert_allclose(found["end"][:n] / NS, [b for _, b in expected[:n]], atol=0.02)


def test_a_burst_is_announced_at_its_onset(replayed: kg.Results) -> None:
    found = replayed["active.interval"].data
    assert set(found["onset"]) <= set(replayed["active.onset"].data["onset"])
