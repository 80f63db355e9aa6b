"""Everything that a case is tried on without chance."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from kinegraph.stream.laws.bad_samples import bad_samples, gaps
from kinegraph.stream.laws.laws import Conformance
from kinegraph.stream.laws.promises import delay, settling, time
from kinegraph.stream.laws.ties import ties


def checks(trial: Conformance) -> dict[str, Callable[[], None]]:
    """The checks by name; each raises `Broken`."""
    return {
        "replay": trial.replay,
        "memory": trial.memory,
        **{check.__name__: partial(check, trial) for check in (ties, delay, time, settling, bad_samples, gaps)},
    }
