"""Other libraries' cuts of a recording: `python offline_cuts.py FOLDER`, in an environment that has ruptures, claspy and stumpy.

FOLDER holds recordings, each NAME.npz with `x` (n, c) and `cuts`, how many there are. Prints JSON: by method and setting, by recording, the
frames at which it cuts, or null where it fails. A method that cannot be told a number has `settings` instead.
"""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

warnings.simplefilter("ignore")
PENALTIES = (2.0, 5.0, 12.0)
"""Times the logarithm of the number of frames."""
LENGTHS = (30, 45)
"""Frames of a subsequence."""
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


def clasp(x: Any, cuts: int, told: float) -> list[int]:
    from claspy.segmentation import BinaryClaSPSegmentation

    made = BinaryClaSPSegmentation(
        n_segments=cuts + 1 if told else "learn", validation=None if told else "significance_test"
    )
    return [int(at) for at in made.fit_predict(np.ascontiguousarray(x))]


def flossed(x: Any, cuts: int, length: float) -> list[int]:
    """The mean of the channels' corrected arc curves; told how many cuts there are."""
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


METHODS: dict[str, tuple[Callable[[Any, int, float], list[int]], tuple[float, ...]]] = {
    "KernelCPD, told the number": (kernel, (0.0,)),
    "KernelCPD, penalty": (kernel, PENALTIES),
    "PELT, penalty": (pelt, PENALTIES),
    "ClaSP, told the number": (clasp, (1.0,)),
    "ClaSP, learns it": (clasp, (0.0,)),
    "FLUSS, told the number": (flossed, tuple(map(float, LENGTHS))),
}


def main() -> None:
    recordings = {path.stem: np.load(path) for path in sorted(Path(sys.argv[1]).glob("*.npz"))}
    made: dict[str, Any] = {}
    for name, (cut, settings) in METHODS.items():
        for setting in settings:
            answers = made.setdefault(name, {}).setdefault(f"{setting:g}", {})
            for which, archive in recordings.items():
                try:
                    answers[which] = cut(archive["x"], int(archive["cuts"]), setting)
                except Exception as error:  # noqa: BLE001
                    print(f"{name}, {which}: {error}", file=sys.stderr)
                    answers[which] = None
    made["versions"] = {name: version(name) for name in ("ruptures", "claspy", "stumpy")}
    print(json.dumps(made))


if __name__ == "__main__":
    main()
