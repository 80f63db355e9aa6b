"""Answers of a map of motion, one line of JSON each, for the process that asked."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass

from kinegraph.stream.chunk import Chunk, Specs
from kinegraph.stream.errors import InputError
from kinegraph.stream.outlet import Outlet

FIELDS = ("query", "place", "sequence", "first", "last", "distance")


@dataclass(slots=True)
class PoseAnswersState:
    """found: rows of the answer that has not ended yet, as JSON."""

    found: list[str]


@dataclass(frozen=True, slots=True)
class PoseAnswers(Outlet[PoseAnswersState, None]):
    """Writes each whole answer of operators.maps.pose_map.retrieve.Retrieve to the standard output, one line of JSON:

    {"query": 7, "found": [[sequence, first, last, distance], ...]}
    """

    def open(self, specs: Specs) -> Specs:
        if specs["in"].dtype.names != FIELDS:
            raise InputError("in", specs["in"].describe(), f"answers: events with the fields {', '.join(FIELDS)}")
        self.set_state(PoseAnswersState([]))
        return {}

    def process(self, port: str, chunk: Chunk) -> None:
        found = self.state.found
        for query, place, sequence, first, last, distance in chunk.data.tolist():
            if place >= 0:
                found.append(json.dumps([sequence, first, last, round(distance, 6)]))
            else:
                os.write(1, f'{{"query": {query}, "found": [{", ".join(found)}]}}\n'.encode())
                found.clear()
