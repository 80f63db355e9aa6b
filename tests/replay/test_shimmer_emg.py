"""configs/shimmer_emg.yaml: two muscles' envelopes and the steps of one leg, from a sensor on the shank.

Recordings: gastrocnemius and tibialis anterior of a treadmill walk (Santuz; MIT), at the sensor's 512 Hz; of a shank's motion with contacts
there is no recording that may be kept, so that it is simulated, at another cadence than the muscles.
Truth: scipy's envelope; the simulated walk's touch-downs and lift-offs.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.devices.people.walking_limb import Limb
from kinegraph.stream.chunk import NS
from tests.replay.replaying import at, emg_envelope, evenly, signal
from tests.support.real import real_arrays

RATE = 512.0
WALK = real_arrays("emg/emg_santuz_tw12.npz")
SECONDS, EMG = evenly(WALK["t_s"], WALK["emg_uV"][:, [WALK["names"].tolist().index(m) for m in ("GM", "TA")]], RATE)
SHANK = Limb("shank", RATE)
SAMPLES = round(20 * RATE)


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    motion = SHANK.measure(np.arange(SAMPLES))
    axes, units = ("wx", "wy", "wz", "gx", "gy", "gz"), ("m/s2",) * 3 + ("rad/s",) * 3
    return kg.load("shimmer_emg").run(
        {
            "shimmer.exg": signal(EMG, RATE, ("emg1", "emg2"), ("uV",), start_s=SECONDS[0]),
            "shimmer.motion": signal(
                np.hstack([motion["acceleration"], motion["angular_velocity"]]), RATE, axes, units
            ),
        }
    )


def test_the_envelopes_are_scipys(replayed: kg.Results) -> None:
    live = replayed["leg.chain.envelope"]
    offline = at(live, SECONDS, emg_envelope(EMG, RATE))
    np.testing.assert_allclose(live.data[30:-30], offline[30:-30], atol=0.01 * offline.max())


@pytest.mark.parametrize("edge", ["touchdown", "liftoff"])
def test_contacts_are_those_of_the_simulated_walk(replayed: kg.Results, edge: str) -> None:
    truth = getattr(SHANK.gait, f"{edge}s")(round(3 * RATE), round(19 * RATE)) / RATE
    found = replayed[f"steps.{edge}"].data["onset"] / NS
    assert np.abs(found[:, None] - truth).min(axis=0).max() < 0.06
    assert len(found[(found > 2.94) & (found < 19.06)]) == len(truth)
