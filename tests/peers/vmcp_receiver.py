"""A program of its own, for vmcp is under the AGPL: what it receives at a UDP port, until so many seconds of VMC time have passed.

`python vmcp_receiver.py PORT UNTIL_S` prints "ready", then an event a line: its kind, its joint or key, its numbers.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

from vmcp.events import (
    BlendShapeApplyEvent,
    BlendShapeEvent,
    BoneTransformEvent,
    RelativeTimeEvent,
    RootTransformEvent,
    StateEvent,
)
from vmcp.facades import on_receive
from vmcp.osc import OSC
from vmcp.osc.backend.osc4py3 import as_eventloop

PATIENCE_S = 30.0
AFTER_S = 0.5
"""So long is listened after the last time."""


def facts(event: Any) -> list[Any]:
    """What an event says, as JSON has it."""
    if isinstance(event, BoneTransformEvent | RootTransformEvent):
        place, turn = event.position, event.rotation
        return [
            str(getattr(event.joint, "value", event.joint)),
            [place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w],
        ]
    if isinstance(event, BlendShapeEvent):
        return [str(getattr(event.key, "value", event.key)), [event.value]]
    return ["", [event.delta] if isinstance(event, RelativeTimeEvent) else []]


def main() -> None:
    port, until_s = int(sys.argv[1]), float(sys.argv[2])
    end = [time.monotonic() + PATIENCE_S]

    def tell(event: Any) -> None:
        print(json.dumps([type(event).__name__, *facts(event)]), flush=True)
        if isinstance(event, RelativeTimeEvent) and event.delta >= until_s:
            end[0] = min(end[0], time.monotonic() + AFTER_S)

    osc = OSC(as_eventloop)
    with osc.open():
        entry = osc.create_receiver("127.0.0.1", port, "entry").open()
        for kind in (
            RootTransformEvent,
            BoneTransformEvent,
            BlendShapeEvent,
            BlendShapeApplyEvent,
            StateEvent,
            RelativeTimeEvent,
        ):
            on_receive(entry, kind, tell)
        print("ready", flush=True)
        while time.monotonic() < end[0]:
            osc.run()
            time.sleep(0.002)


main()
