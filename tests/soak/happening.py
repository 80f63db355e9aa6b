"""Faults as they begin and end, each at the session, device or broker that it is of."""

from __future__ import annotations

import signal
import time
from collections import Counter
from collections.abc import Sequence
from heapq import heapify, heappop, heappush
from pathlib import Path

from tests.soak.faults import Fault
from tests.soak.watched import Watched

LOOK_S = 1.0
START_S = 120.0
"""The most that the first start may take, with every kernel to be compiled."""
STEP_S = 3600
ASLEEP_S = 60
"""So long is the machine asleep, by its clocks, while a process that takes it for true is stopped for a moment."""
STOPPED = {"suspend", "machine asleep"}


def soak(sessions: Sequence[Watched], faults: Sequence[Fault], seconds: float) -> Counter[str]:
    """Let the faults happen to running sessions, and end them. Returns how many of each kind happened."""
    by_use = {watched.use.name: watched for watched in sessions}
    due: list[tuple[float, int, bool, Fault]] = [(fault.at_s, i, True, fault) for i, fault in enumerate(faults)]
    heapify(due)
    done: Counter[str] = Counter()
    if not _wait_until_going(sessions):
        return done
    began = time.monotonic()
    looked = -LOOK_S
    while (now := time.monotonic() - began) < seconds:
        if now - looked >= LOOK_S:
            looked = now
            for watched in sessions:
                watched.look()
        if not due or due[0][0] > now:
            time.sleep(min(0.05, max(0.0, (due[0][0] if due else seconds) - now)))
            continue
        _, i, begins, fault = heappop(due)
        watched = by_use[fault.use]
        if not begins:
            _end(watched, fault)
        elif _begin(watched, fault):
            done[fault.kind] += 1
            heappush(due, (now + fault.for_s, i, False, fault))
    for _, _, begins, fault in due:
        if not begins:
            _end(by_use[fault.use], fault)
    for watched in sessions:
        watched.end()
    return done


def _wait_until_going(sessions: Sequence[Watched]) -> bool:
    """Until each records. Nothing more happens where one has ended before, which is found by who judges: returns whether all go on."""
    deadline = time.monotonic() + START_S
    while not all(watched.going or not watched.alive for watched in sessions) and time.monotonic() < deadline:
        time.sleep(0.1)
    return all(watched.going or watched.alive for watched in sessions)


def _begin(watched: Watched, fault: Fault) -> bool:
    """Whether it could happen: a process that is not there cannot be stopped, nor its page be looked at."""
    kind = fault.kind
    if kind in watched.wrong:  # the one before began late, on a busy machine
        return False
    if kind in ("kill", "suspend", "machine asleep") and not watched.alive:
        return False
    if kind == "kill" and (watched.wrong & STOPPED or not watched.going):
        return False
    if kind in STOPPED and watched.wrong & STOPPED:
        return False
    if kind in ("stuck broker", "broker down") and watched.wrong & {"stuck broker", "broker down"}:
        return False
    if kind == "slow clients" and not watched.look_slowly():
        return False
    match kind:
        case "unplug":
            watched.device.unplug()
        case "suspend":
            watched.send(signal.SIGSTOP)
        case "kill":
            watched.kill()
        case "full disk":
            (watched.switches / "full").touch()
        case "broker down":
            watched.broker.stop()
        case "stuck broker":
            watched.broker.send(signal.SIGSTOP)
        case "machine asleep":
            watched.send(signal.SIGSTOP)
            slept = watched.switches / "asleep"
            _write(slept, ASLEEP_S + (int(slept.read_text()) if slept.exists() else 0))
        case "clock step":
            ahead = STEP_S if round(fault.at_s * 10) % 2 else -STEP_S
            _write(watched.switches / "clock", ahead)
    watched.happens(kind)
    return True


def _write(switch: Path, seconds: int) -> None:
    """Whole at once: the session reads it at any moment."""
    draft = switch.with_suffix(".draft")
    draft.write_text(str(seconds))
    draft.replace(switch)


def _end(watched: Watched, fault: Fault) -> None:
    watched.is_over(fault.kind)
    match fault.kind:
        case "unplug":
            watched.device.plug()
        case "suspend" | "machine asleep":
            watched.send(signal.SIGCONT)
        case "kill":
            watched.start()
        case "full disk":
            (watched.switches / "full").unlink(missing_ok=True)
        case "broker down":
            watched.broker.start()
        case "stuck broker":
            watched.broker.send(signal.SIGCONT)
        case "clock step":
            (watched.switches / "clock").unlink(missing_ok=True)
        case "slow clients":
            watched.look_away()
