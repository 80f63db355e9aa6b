"""Everything that a case is tried on without chance."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from stream.conformance.bad import bad_samples, gaps
from stream.conformance.laws import Conformance
from stream.conformance.promises import delay, settling, time
from stream.conformance.ties import ties


def checks(trial: Conformance) -> dict[str, Callable[[], None]]:
    """The checks by name; each raises `Broken`."""
    return {
        "replay": trial.replay,
        "memory": trial.memory,
        **{check.__name__: partial(check, trial) for check in (ties, delay, time, settling, bad_samples, gaps)},
    }
