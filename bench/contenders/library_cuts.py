"""Other libraries' cuts of a recording: `python library_cuts.py FOLDER`, in an environment that has ruptures, claspy and stumpy.

FOLDER holds recordings, each NAME.npz with `x` (n, c) and `cuts`, how many there are. Prints JSON: by method and setting, by recording,
the frames at which it cuts, or null where it fails. A method that takes no number has `settings` instead. Those that stream are
fed frame by frame; ClaSS takes one channel only, and gets the recording's first principal component.
"""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Callable
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

warnings.simplefilter("ignore")
PENALTIES = (2.0, 5.0, 12.0)
"""Times the logarithm of the number of frames."""
LENGTHS = (30, 45)
"""Frames of a subsequence."""
WINDOW = 600
"""Frames that those remember which stream: 20 s."""
LATE = (3, 6, 9)
"""Subsequences after which FLOSS's curve is read."""
THIN = 3
"""Every so many frames are looked at, where a method's work grows with the square of them."""


def kernel(x: Any, cuts: int, penalty: float) -> list[int]:
    import ruptures

    made = ruptures.KernelCPD(kernel="rbf", min_size=5).fit(x[::THIN])
    found = made.predict(n_bkps=cuts) if penalty == 0.0 else made.predict(pen=penalty * np.log(len(x)) / 10.0)
    return [THIN * int(at) for at in found[:-1]]


def pelt(x: Any, cuts: int, penalty: float) -> list[int]:
    import ruptures

    scaled = (x - x.mean(0)) / np.maximum(x.std(0), 1e-9)
    found = ruptures.Pelt(model="l2", min_size=5, jump=1).fit(scaled[::THIN]).predict(pen=penalty * np.log(len(x)))
    return [THIN * int(at) for at in found[:-1]]


def clasp(x: Any, cuts: int, known: float) -> list[int]:
    from claspy.segmentation import BinaryClaSPSegmentation

    made = BinaryClaSPSegmentation(
        n_segments=cuts + 1 if known else "learn", validation=None if known else "significance_test"
    )
    return [int(at) for at in made.fit_predict(np.ascontiguousarray(x))]


def streaming_clasp(x: Any, cuts: int, length: float, exponent: float) -> list[int]:
    """ClaSS with subsequences of `length`; a cut's p-value is at most 10 to the `exponent`."""
    from claspy.streaming.segmentation import StreamingClaSPSegmentation

    m = int(length)
    made = StreamingClaSPSegmentation(
        n_timepoints=WINDOW, n_warmup=10 * m, window_size=m, threshold=10.0**exponent, log_cps=True, jump=1
    )
    centred = x - x.mean(axis=0)
    for value in centred @ np.linalg.svd(centred, full_matrices=False)[2][0]:
        made.update(float(value))
    return sorted({int(at) for at in made.change_points})


def streaming_floss(x: Any, cuts: int, length: float, threshold: float, late: float) -> list[int]:
    """FLOSS on every channel: the mean of their corrected arc curves, each frame's as the window has moved on by `late` subsequences, where
    it is lowest and below `threshold`."""
    m = int(length)
    key = x.tobytes(), m
    if key not in CURVES:
        CURVES[key] = np.mean([arcs(channel, m) for channel in x.T], axis=0)
    curve, found = CURVES[key][LATE.index(late)].copy(), []
    while curve.min() < threshold:
        at = int(curve.argmin())
        found.append(at)
        curve[max(0, at - 3 * m) : at + 3 * m] = np.inf
    return sorted(found)


CURVES: dict[tuple[bytes, int], Any] = {}


def arcs(channel: Any, m: int) -> Any:
    """FLOSS's corrected arc curves of a channel (n,): of each frame the value that it had LATE subsequences later, by that (late, n)."""
    import numba
    import stumpy

    threads = numba.get_num_threads()
    numba.set_num_threads(1)  # those that wait for a busy core cost more than they bring, a frame at a time
    channel = np.ascontiguousarray(channel, np.float64)
    first, curves = channel[:WINDOW], np.ones((len(LATE), len(channel)))
    stream = stumpy.floss(stumpy.stump(first, m), first.copy(), m=m, L=m)
    for i, value in enumerate(channel[WINDOW:], 1):
        stream.update(float(value))
        for curve, late in zip(curves, LATE, strict=True):
            seen = len(stream.cac_1d_) - late * m
            curve[i if i == 1 else i + seen - 1 : i + seen] = stream.cac_1d_[0 if i == 1 else seen - 1 : seen]
    numba.set_num_threads(threads)
    return curves


def flossed(x: Any, cuts: int, length: float) -> list[int]:
    """The mean of the channels' corrected arc curves, for a known number of cuts."""
    import stumpy

    m, curves = int(length), []
    for channel in x.T:
        profile = stumpy.stump(np.ascontiguousarray(channel, np.float64), m)
        curves.append(stumpy.fluss(profile[:, 1], L=m, n_regimes=2, excl_factor=1)[0])
    curve, found = np.mean(curves, 0), []
    for _ in range(cuts):
        at = int(curve.argmin())
        found.append(at)
        curve[max(0, at - 3 * m) : at + 3 * m] = np.inf
    return sorted(found)


METHODS: dict[str, tuple[Callable[..., list[int]], list[tuple[float, ...]]]] = {
    "KernelCPD, known number": (kernel, [(0.0,)]),
    "KernelCPD, penalty": (kernel, [(p,) for p in PENALTIES]),
    "PELT, penalty": (pelt, [(p,) for p in PENALTIES]),
    "ClaSP, known number": (clasp, [(1.0,)]),
    "ClaSP, learns it": (clasp, [(0.0,)]),
    "FLUSS, known number": (flossed, [(m,) for m in LENGTHS]),
    "ClaSS (streaming ClaSP): length, exponent": (
        streaming_clasp,
        list(product((10, 15, 22, 30), (-25.0, -15.0, -8.0, -4.0, -2.0))),
    ),
    "FLOSS (streaming): length, threshold, lateness": (
        streaming_floss,
        list(product(LENGTHS, (0.3, 0.45, 0.6, 0.75), LATE)),
    ),
}
"""By name: what cuts, and the settings that it is tried with."""


def main() -> None:
    recordings = {path.stem: np.load(path) for path in sorted(Path(sys.argv[1]).glob("*.npz"))}
    made: dict[str, Any] = {}
    for name, (cut, settings) in METHODS.items():
        for setting in settings:
            answers = made.setdefault(name, {}).setdefault(", ".join(f"{value:g}" for value in setting), {})
            for which, archive in recordings.items():
                try:
                    answers[which] = cut(archive["x"], int(archive["cuts"]), *setting)
                except Exception as error:  # noqa: BLE001
                    print(f"{name}, {which}: {error}", file=sys.stderr)
                    answers[which] = None
    made["versions"] = {name: version(name) for name in ("ruptures", "claspy", "stumpy")}
    print(json.dumps(made))


if __name__ == "__main__":
    main()
