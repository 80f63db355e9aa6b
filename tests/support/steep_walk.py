"""A walk of two legs with muscles that begin and end within 30 ms, as real ones do, and contacts that may be swapped or late."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.signal import butter, sosfilt

from kinegraph.operators.contacts.limb_contacts import LIMB_CONTACT
from kinegraph.operators.cycles.limb_cycles import LimbCycles
from kinegraph.operators.emg.envelope import Envelope
from kinegraph.stream.chunk import NS, StreamSpec
from tests.support.emg_run import drive, stamps

WORKS = {
    "TA": ((0.60, 0.74, 90.0), (0.95, 1.08, 130.0)),
    "SO": ((0.18, 0.52, 130.0),),
    "GM": ((0.20, 0.48, 120.0),),
    "BF": ((0.86, 1.06, 110.0),),
}
"""Per muscle, its bursts: from where to where in the cycle, and how large (uV rms)."""
SIDES = {"left": "L_*", "right": "R_*"}
RATE_HZ, RISE_S = 1000, 0.03


def steep_walk(
    cycles: int, *, noise_uv: float = 1.0, seed: int = 0, muscles: tuple[str, ...] = tuple(WORKS)
) -> dict[str, Any]:
    """Raw EMG of both legs (`emg`), and their contacts with the field `limb`."""
    rng = np.random.default_rng(seed)
    duration = 1.1 + 0.02 * rng.standard_normal(cycles + 1)
    right = 1.0 + np.concatenate([[0.0], np.cumsum(duration)])
    left = (right[:-1] + right[1:]) / 2
    touch = {"left": left, "right": right[:-1]}
    n = int((right[-1] + 0.5) * RATE_HZ)
    t = np.arange(n) / RATE_HZ
    emg, names = [], []
    for side, downs in touch.items():
        for muscle in muscles:
            rms = np.zeros(n)
            for down, length in zip([2 * downs[0] - downs[1], *downs], [duration[0], *duration], strict=False):
                for on, off, size in WORKS[muscle]:
                    height = size * np.exp(0.15 * rng.standard_normal())
                    a, b = (down + (edge + 0.01 * rng.standard_normal()) * length for edge in (on, off))
                    here = slice(*np.searchsorted(t, [a, b]).tolist())
                    ramp = np.minimum(np.clip((t[here] - a) / RISE_S, 0, 1), np.clip((b - t[here]) / RISE_S, 0, 1))
                    rms[here] = np.maximum(rms[here], height * ramp)
            emg.append(rng.standard_normal(n) * np.hypot(rms, noise_uv))
            names.append(f"{side[0].upper()}_{muscle}")
    band = butter(2, [20, 400], "bandpass", fs=RATE_HZ, output="sos")
    spec = StreamSpec((len(names),), rate_hz=float(RATE_HZ), channels=tuple(names), units=("uV",))
    return {
        "emg": (spec, stamps(n), sosfilt(band, np.stack(emg, axis=1), axis=0)),
        "touchdown": limb_contacts(touch),
        "liftoff": limb_contacts({side: downs[:-1] + 0.62 * np.diff(downs) for side, downs in touch.items()}),
    }


def limb_contacts(seconds: dict[str, np.ndarray]) -> tuple[StreamSpec, np.ndarray, np.ndarray]:
    """Contacts of each limb at these seconds, reported 20 ms later."""
    rows = np.zeros(sum(map(len, seconds.values())), LIMB_CONTACT)
    rows["onset"] = np.concatenate([np.round(at * NS) for at in seconds.values()])
    rows["limb"] = np.repeat(list(seconds), [len(at) for at in seconds.values()])
    rows = rows[np.argsort(rows["onset"], kind="stable")]
    spec = StreamSpec((), LIMB_CONTACT, units=("ns", ""), meta={"limb_names": list(seconds)})
    return spec, rows["onset"] + NS // 50, rows


def swapped(contacts: tuple[StreamSpec, np.ndarray, np.ndarray], from_s: float, to_s: float) -> Any:
    """The same contacts, between these times each the other limb's."""
    spec, time, rows = contacts
    made = rows.copy()
    here = (made["onset"] >= from_s * NS) & (made["onset"] < to_s * NS)
    made["limb"][here] = np.where(made["limb"][here] == "left", "right", "left")
    return spec, time, made


def late(contacts: tuple[StreamSpec, np.ndarray, np.ndarray], from_s: float, to_s: float, by_s: float) -> Any:
    """The same contacts, between these times reported `by_s` late."""
    spec, time, rows = contacts
    made = rows.copy()
    here = (made["onset"] >= from_s * NS) & (made["onset"] < to_s * NS)
    made["onset"][here] += round(by_s * NS)
    return spec, time + np.where(here, round(by_s * NS), 0), made


def cut(walk: dict[str, Any]) -> dict[str, Any]:
    """The walk's cycles: `closed`, `cycles`, `maxima`."""
    envelope = drive(Envelope(), {"in": walk["emg"]}, 500)["out"]
    given = {"signal": envelope, "touchdown": walk["touchdown"], "liftoff": walk["liftoff"]}
    return drive(LimbCycles(SIDES), given, 200)
