"""`python -m bench`, or `make bench`: all figures in one run, interleaved; they go into the docs where asked for."""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable

from bench import depth, devices, lsl, mti, paced, recorder, replay, sleep, start, throughput
from bench.engines import Field
from bench.report import Section, publish, whole

BUSY = 0.5
"""Beyond this load average at the start, the report says that the machine was busy."""
ENGINES = ("overhead", "chain", "sizes", "paced")
"""Measures beside other engines."""
DEVICES = ("serial", "mti", "lsl", "depth")
MEASURES = (*ENGINES, "recorder", *DEVICES, "sleep", "start", "replay")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument(
        "--only", nargs="+", choices=MEASURES, default=MEASURES, metavar="MEASURE", help=", ".join(MEASURES)
    )
    parser.add_argument("--devices", action="store_true", help=f"only {', '.join(DEVICES)}")
    parser.add_argument("--no-peers", action="store_true", help="kinegraph and the bare loops alone")
    parser.add_argument("--quick", action="store_true", help="tiny sizes: to see that it works, not for figures")
    parser.add_argument("--hours", type=float, default=10.0, help="of the replayed recording")
    parser.add_argument("--write", action="store_true", help="write goals and tables into docs/lab/performance.md")
    given = parser.parse_args()
    only = DEVICES if given.devices else given.only
    began, load = time.monotonic(), os.getloadavg()[0]
    sections = []
    with Field.gather(with_peers=not given.no_peers and bool({*only} & {*ENGINES})) as field:
        for name, measure in measures(field, quick=given.quick, hours=given.hours).items():
            if name in only:
                print(f"{name} ...", file=sys.stderr, flush=True)
                sections += measure()
        result = about(field, load, time.monotonic() - began)
    print(whole(sections, result))
    if given.write:
        publish(sections, result, "lab/performance.md")


def measures(field: Field, *, quick: bool, hours: float) -> dict[str, Callable[[], list[Section]]]:
    """Every measure, ready to be taken."""
    single: dict[str, Callable[[], Section]] = _single(field, quick=quick, hours=hours)
    made = {name: (lambda measure=measure: [measure()]) for name, measure in single.items()}
    made["serial"] = lambda: devices.serial_devices(quick=quick)
    made["mti"] = lambda: [mti.bytes_to_samples(0.5, 1)] if quick else mti.sections(10.0, 5)
    made["sleep"] = lambda: sleep.sections(2 if quick else 200)
    return {name: made[name] for name in MEASURES}


def _single(field: Field, *, quick: bool, hours: float) -> dict[str, Callable[[], Section]]:
    """Those that give one table."""
    if quick:
        return {
            "overhead": lambda: throughput.overhead(field, 1, 0.01),
            "chain": lambda: throughput.chain(field, 1, 0.01),
            "sizes": lambda: throughput.every_chunk_size(field, [1, 7, 97], 1000),
            "paced": lambda: paced.paced(field, 1, 0.3),
            "recorder": lambda: recorder.recorder(500),
            "depth": lambda: depth.depth(2),
            "lsl": lambda: lsl.latency(1, 0.3),
            "start": lambda: start.start(1),
            "replay": lambda: replay.replay(0.02, 36.0),
        }
    return {
        "overhead": lambda: throughput.overhead(field, 9, 0.1),
        "chain": lambda: throughput.chain(field, 7, 0.1),
        "sizes": lambda: throughput.every_chunk_size(field, list(range(1, 1001)), 6000),
        "paced": lambda: paced.paced(field, 8, 2.5),
        "recorder": lambda: recorder.recorder(20_000),
        "depth": lambda: depth.depth(100),
        "lsl": lambda: lsl.latency(5, 4.0),
        "start": lambda: start.start(5),
        "replay": lambda: replay.replay(hours),
    }


def about(field: Field, load: float, took_s: float) -> str:
    """What was measured, where, and what has to be known about it."""
    versions = {name: v for engine in field.engines.values() for name, v in engine.versions.items()}
    lines = [
        f"Measured by `make bench` on {_processor()} ({os.cpu_count()} cores), {platform.system()}, Python {platform.python_version()}, "
        f"in {took_s / 60:.0f} minutes; rounds of all contenders interleaved, medians unless stated otherwise. "
        + ", ".join(f"{name} {v}" for name, v in versions.items())
        + "."
    ]
    if field.absent:
        lines.append("Left out: " + "; ".join(field.absent) + ".")
    if load > BUSY:
        lines.append(f"**The machine was busy with other work (load average {load:.1f} at the start).**")
    return "\n\n".join(lines)


def _processor() -> str:
    try:
        text = subprocess.run(["lscpu"], capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return platform.processor() or "an unknown processor"
    names = [line.partition(":")[2].strip() for line in text.splitlines() if line.startswith("Model name")]
    return names[0] if names else platform.machine()


if __name__ == "__main__":
    main()
