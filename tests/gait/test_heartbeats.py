"""Heartbeats in a trunk muscle's EMG: what the cut-off that the docs name takes out of them, and what it leaves of the muscle."""

from __future__ import annotations

import numpy as np

from kinegraph.operators.emg.envelope import Envelope
from kinegraph.stream.chunk import StreamSpec, grid
from tests.support.emg_run import drive

RATE, SECONDS = 1000, 40


def beat(t):
    """A QRS complex as surface electrodes on the trunk show it: three waves within 0.1 s, most of their power below 30 Hz."""
    return (
        400 * np.exp(-0.5 * (t / 0.011) ** 2)
        - 90 * np.exp(-0.5 * ((t + 0.028) / 0.012) ** 2)
        - 120 * np.exp(-0.5 * ((t - 0.03) / 0.013) ** 2)
    )


def trunk(seed=4):
    """An erector spinae that works twice a second (uV), and the heart in it, 72 times a minute."""
    rng = np.random.default_rng(seed)
    t = np.arange(RATE * SECONDS) / RATE
    muscle = rng.standard_normal(len(t)) * (4 + 26 * np.exp(-0.5 * (((t * 2) % 1 - 0.5) / 0.12) ** 2))
    beats = np.cumsum(60 / 72 * (1 + 0.04 * rng.standard_normal(int(SECONDS * 1.4))))
    heart = sum(beat(t - b) for b in beats[beats < SECONDS - 1])
    return muscle, heart


def envelope(signal, highpass_hz):
    spec = StreamSpec((1,), rate_hz=RATE, channels=("ES",), units=("uV",))
    return drive(Envelope(highpass_hz=highpass_hz), {"in": (spec, grid(RATE, len(signal)), signal[:, None])})["out"][2][
        60:-60, 0
    ]


def test_thirty_hertz_takes_most_of_the_heart_out_and_leaves_the_muscle():
    muscle, heart = trunk()
    added = {}
    for hz in (20.0, 30.0):
        clean, mixed = envelope(muscle, hz), envelope(muscle + heart, hz)
        n = min(len(clean), len(mixed))
        added[hz] = np.abs(mixed[:n] - clean[:n]).mean() / clean[:n].mean()
    plain, kept = envelope(muscle, 20.0), envelope(muscle, 30.0)
    assert added[30.0] < 0.6 * added[20.0]
    assert kept.mean() > 0.9 * plain.mean()
