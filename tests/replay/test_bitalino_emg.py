"""configs/bitalino_emg.yaml: two muscles, the heart and a footswitch with a BITalino: the muscles' cycles.

Recording: tibialis anterior and soleus of a treadmill walk (Santuz; MIT) at the device's 1000 Hz; in the heart's place a pulse a second.
Truth: scipy's zero-phase envelope of the two muscles.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.stream.chunk import NS
from tests.replay.replaying import at, cycles_last_as_long_as_the_files, emg_envelope, footswitch, signal
from tests.support.real import real_arrays

WALK = real_arrays("emg/emg_santuz_tw12.npz")
TA, SO = (WALK["emg_uV"][:, WALK["names"].tolist().index(name)].astype(float) for name in ("TA", "SO"))
HEART = 800.0 * (np.arange(len(TA)) % 1000 < 40)


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    analog = signal(np.stack([TA, HEART, SO], axis=1), 1000.0, ["TA", "heart", "SO"], ["uV"], time_s=WALK["t_s"])
    pressed = footswitch(WALK["touchdown_s"], WALK["liftoff_s"], 1000.0, WALK["t_s"][-1], WALK["t_s"][0])
    digital = signal(pressed * [1, 0, 0, 0], 1000.0, ["I1", "I2", "O1", "O2"], start_s=WALK["t_s"][0])
    return kg.load("bitalino_emg").run({"bitalino.analog": analog, "bitalino.digital": digital})


def test_cycles_are_those_of_the_file(replayed: kg.Results) -> None:
    cycles_last_as_long_as_the_files(replayed["leg.cycles.closed"], WALK["touchdown_s"], 0.002)


def test_only_the_muscles_have_envelopes_and_the_heart_does_not_leak_in(replayed: kg.Results) -> None:
    live = replayed["leg.chain.envelope"]
    assert live.spec.channels == ("TA", "SO") and live.spec.units[0] == "uV"
    offline = at(live, WALK["t_s"], emg_envelope(np.stack([TA, SO], axis=1), 1000.0))
    np.testing.assert_allclose(live.data[24:-24], offline[24:-24], atol=0.005 * offline.max())


def test_the_calf_pushes_off_before_the_shin_lifts_the_foot(replayed: kg.Results) -> None:
    """Within each of the file's strides soleus is loudest in late stance; tibialis anterior at touch-down or in swing."""
    live = replayed["leg.chain.envelope"]
    seconds, down, up = live.time / NS, WALK["touchdown_s"], WALK["liftoff_s"]
    for begin, off, end in zip(down[:-1], up, down[1:], strict=False):
        stride = (seconds >= begin) & (seconds < end)
        ta, so = (seconds[stride][live.data[stride, column].argmax()] for column in (0, 1))
        assert begin + 0.3 * (off - begin) < so < off
        assert not begin + 0.3 * (off - begin) < ta < off - 0.05
