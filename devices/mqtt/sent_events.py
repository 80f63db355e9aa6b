"""Events that are sent one by one: which, and with which fields."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.mqtt.fields import as_json, check_where, chosen, stream_of
from kinegraph.stream.chunk import Chunk, Specs, StreamSpec, utc
from kinegraph.stream.errors import InputError


@dataclass(frozen=True, slots=True)
class SentEvents:
    """Events of a stream that are sent one by one, each once and in order, as JSON with all their fields.

    of      the stream
    where   only events whose fields have these values ({final: true})
    key     an integer field that grows from event to event; by it what was sent already is known again
    log     the folder of a `devices.reports.night.NightLog`, where these are final epochs: after a crash, what stands there and was not
            sent is sent as it stands, so that the two always agree (put the log before this outlet in the graph)
    sleeper the sleeper's name in that folder, if there are several
    """

    of: str
    where: dict[str, str | float | bool] | None = None
    key: str = "onset"
    log: str = ""
    sleeper: str = ""

    def check(self, specs: Specs, parameter: str) -> None:
        """Raises ParameterError and InputError where no such events come."""
        spec = stream_of(specs, self.of, f"{parameter}.of")
        if not spec.is_event or self.key not in spec.channels or spec.dtype[self.key].kind not in "iu":
            raise InputError(self.of, spec.describe(), f"events with a whole number {self.key!r}")
        check_where(spec, self.where, f"{parameter}.where")

    def chosen(self, chunk: Chunk, spec: StreamSpec, session: str) -> Iterator[tuple[int, str]]:
        """Key and text of each event of a chunk that is to be sent."""
        for row in chunk.data[chosen(chunk.data, self.where)]:
            facts: dict[str, Any] = {"session": session, "key": int(row[self.key])}
            facts |= {field: as_json(row[field], spec.unit_of(field)) for field in spec.channels}
            yield facts["key"], json.dumps(facts)

    def logged_after(self, newest: int, session: str) -> Iterator[tuple[int, str]]:
        """Key and text of each event that a night's log has, and that was not sent, as the session was killed in between.

        newest: the last key that was sent, or -1.
        """
        from kinegraph.devices.reports.night import archive

        nights = archive.nights(Path(self.log)) if newest >= 0 else []
        nights = [night for night in nights if night[1].sleeper == self.sleeper]
        nights.sort(key=lambda night: (night[0] / archive.EPOCHS).stat().st_mtime_ns)  # the one that was written last
        for folder, _ in nights[-1:]:
            epochs = archive.read_epochs(folder)
            for k in np.flatnonzero(epochs.onset > newest).tolist():
                facts = {"session": session, "key": int(epochs.onset[k])}
                facts |= {name: utc(int(column[k])) for name, column in (("onset", epochs.onset), ("end", epochs.end))}
                facts |= {
                    "state": str(epochs.texts["state"][k]),
                    "final": True,
                    "rescored": bool(epochs.numbers["rescored"][k]),
                }
                facts |= {name: as_json(epochs.numbers[name][k], "") for name in ("score", "activity")}
                if cause := str(epochs.texts["cause"][k]):
                    mover = archive.nanoseconds(str(epochs.texts["mover"][k]) or archive.iso(0))
                    facts |= {"cause": cause, "mover": as_json(mover, "ns"), "rule": str(epochs.texts["rule"][k])}
                    facts |= {name: as_json(epochs.numbers[name][k], "") for name in ("weight", "adds")}
                yield int(epochs.onset[k]), json.dumps(facts)
