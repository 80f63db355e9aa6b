"""The bench of cables that come out counts what was offered while the plug was in, and from when it was in again."""

from __future__ import annotations

import numpy as np
import pytest

from bench.comeback import RATE_HZ, kept, returned
from kinegraph.devices.simulation.fault_injection import FaultInjection


def test_what_was_offered_and_how_late_it_came_back() -> None:
    wrong = FaultInjection(unplug_every_s=4.0, unplug_s=1.0)
    sent = np.arange(round(11 * RATE_HZ))
    at = sent / RATE_HZ
    outage = (at >= 4) & (at % 4 < 1)
    assert kept(sent[~outage], wrong) == 1.0
    late = sent[~outage & ~((at >= 5) & (at < 5.2))]
    assert returned(late, wrong) == pytest.approx([0.2, 0.0])
    assert kept(late, wrong) == pytest.approx(1 - 0.2 / 9)
