"""`python -m bench.avatar`: from a camera's stamp to the VMC datagram, and from motion to what the datagram says of it.

Runs the shipped config `avatar_markers` as a session of its own on the simulated performer, and receives its datagrams over UDP. The
first figure is the time from the stamp of a sample to the last datagram of its pose; the second the lag of the sent hands and feet behind
the performer's true ones, by cross-correlation, with all filters and the prediction of the config.
"""

from __future__ import annotations

import argparse
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from kinegraph.devices.osc.protocol import read_osc
from kinegraph.stream.chunk import NS, Samples
from kinegraph.stream.domain.humanoid import BONES, usual_body
from kinegraph.stream.domain.skeleton import joints_of
from kinegraph.stream.recording import Recording

SEEN = tuple(BONES.index(f"{side}{bone}") for side in ("Left", "Right") for bone in ("Hand", "Foot"))
WIDEST_S = 0.2


def received(
    seconds: float, folder: Path, settings: list[str], config: str = "avatar_markers"
) -> list[tuple[float, int]]:
    """Run `config`: for every datagram with the last bone of a pose: the pose's time as sent (s), and when it came (ns UTC)."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind(("127.0.0.1", 0))
        port.settimeout(0.2)
        chosen = [word for setting in (f"vmc.port={port.getsockname()[1]}", *settings) for word in ("--set", setting)]
        command = [
            sys.executable,
            "-m",
            "kinegraph",
            "run",
            config,
            "--for",
            str(seconds),
            "-o",
            str(folder / "run"),
            "--view",
            "lines",
        ]
        session = subprocess.Popen([*command, *chosen], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        came: list[tuple[float, int]] = []
        sent_s = 0.0
        while session.poll() is None:
            try:
                data = port.recv(65536)
            except TimeoutError:
                continue
            now = time.time_ns()
            for address, arguments in read_osc(data):
                if address == "/VMC/Ext/T":
                    sent_s = float(arguments[0])  # type: ignore[arg-type]
                elif address == "/VMC/Ext/Bone/Pos" and arguments[0] == BONES[-1]:
                    came.append((sent_s, now))
    return came


def lag_of(true: Samples, made: Samples, rate_hz: float) -> float:
    """By how many seconds `made` (n, d) lags behind `true` (n, d): the shift at which their changes agree best, between samples too."""
    a, b = np.diff(true, axis=0), np.diff(made, axis=0)
    most = round(WIDEST_S * rate_hz)
    scores = np.array([float((a[most:-most] * b[most + k : len(b) - most + k]).sum()) for k in range(-most, most + 1)])
    best = int(scores[1:-1].argmax()) + 1
    left, middle, right = scores[best - 1 : best + 2]
    return (best - most + 0.5 * (left - right) / (left - 2 * middle + right)) / rate_hz


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.avatar", description=__doc__)
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument(
        "--set", action="append", default=[], metavar="NODE.PARAMETER=VALUE", help="as for kinegraph run"
    )
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        came = received(given.seconds, Path(name), given.set)
        with Recording.open(Path(name) / "run") as recording:
            stamps, poses = recording.read("body.pose")
            true_stamps, true = recording.read("performer.pose")
    late = np.array([now - (int(stamps[0]) + sent * NS) for sent, now in came[30:]]) / 1e6
    print(
        f"stamp to datagram: p50 {np.percentile(late, 50):.1f} ms, p99 {np.percentile(late, 99):.1f} ms, of {len(late)} poses"
    )
    n = min(len(poses), len(true))
    assert (stamps[:n] == true_stamps[:n]).all()
    tree = usual_body()
    places = [joints_of(tree, rows[:n])[1][45:, SEEN].reshape(n - 45, -1) for rows in (true, poses)]
    lag_ms = 1e3 * lag_of(places[0], places[1], 30.0)
    shift = round(max(0.0, lag_ms) * 30.0 / 1e3)
    apart = 100.0 * np.linalg.norm(
        (places[1][shift:] - places[0][: len(places[0]) - shift]).reshape(-1, len(SEEN), 3), axis=-1
    )
    print(
        f"lag of hands and feet: {lag_ms:.1f} ms; apart {apart.mean():.1f} cm in the mean, p95 {np.percentile(apart, 95):.1f} cm"
    )
    print(
        f"motion to datagram: p50 {lag_ms + np.percentile(late, 50):.1f} ms, p99 {lag_ms + np.percentile(late, 99):.1f} ms"
    )


if __name__ == "__main__":
    main()
