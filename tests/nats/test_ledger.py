"""The ledger of `bench.machines`: what beds offered is what the centre received and what was discarded by name, whatever breaks."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.machines import FAULTS, ledger
from tests.support.nats_site import folders, server

__all__ = ["folders", "server"]


@pytest.mark.usefixtures("server")
def test_the_ledger_balances_over_every_fault(tmp_path: Path) -> None:
    found = ledger(4, 60.0, tmp_path, rounds=12, faults=len(FAULTS))
    assert set(found.faults) == set(FAULTS)
    assert found.balances and found.repeated, str(found)


@pytest.mark.nightly
@pytest.mark.usefixtures("server")
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_ledger_of_20_beds_and_2_minutes_balances(tmp_path: Path, seed: int) -> None:
    found = ledger(20, 120.0, tmp_path, seed=seed)
    assert found.balances, str(found)


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.usefixtures("server")
def test_the_ledger_of_200_beds_and_a_day_balances(tmp_path: Path) -> None:
    found = ledger(200, 24 * 3600.0, tmp_path, rounds=96, faults=48, step_s=30.0)
    assert found.balances, str(found)
