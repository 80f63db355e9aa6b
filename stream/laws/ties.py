"""Equal stamps on several inputs: no answer depends on the order in which the ports are named."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice, permutations

import numpy as np

from kinegraph.stream.laws.case_samples import Tapes
from kinegraph.stream.laws.chunking import steps
from kinegraph.stream.laws.laws import Conformance
from kinegraph.stream.laws.play import differ
from kinegraph.stream.laws.violations import Broken

MAX = 7
"""Orders of the ports that are tried."""


def ties(trial: Conformance) -> None:
    """Law 1: the case, and the case with every event at the stamp of a sample, with the ports in other orders."""
    if len(trial.tapes) < 2:
        return
    for tapes, what in ((trial.tapes, "the case"), (aligned(trial.tapes), "every event at the stamp of a sample")):
        delivery = steps(tapes, max(1, trial.longest // 20))
        with trial.warm(what):
            straight = trial.play(delivery, tapes)
            for order in islice(permutations(tapes), 1, MAX):
                player = trial.player()
                player.name_ports(order)
                if difference := differ(straight, player.play(delivery)):
                    raise Broken("ties", f"with the inputs in the order {', '.join(order)}: {difference}", what)


def aligned(tapes: Tapes) -> Tapes:
    """The samples, those of irregular streams moved to the stamp before them of the one that has most samples."""
    grid = max(tapes.values(), key=len).time
    moved = {}
    for port, tape in tapes.items():
        places = np.searchsorted(grid, tape.time, "right") - 1
        free = tape.spec.rate_hz is None and len(grid) > 0
        moved[port] = replace(tape, time=np.where(places < 0, tape.time, grid[np.maximum(places, 0)])) if free else tape
    return moved
