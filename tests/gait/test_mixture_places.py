"""Places on the cycle against exact arithmetic."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from kinegraph.operators.emg.mixtures.kernel import nearest_on_cycle, wrapped

PLACES = [0.0, 99.99999999999999, 100.0, 100.00000000000001, 250.0, -0.5, -100.0, -250.25, -1e-12, -1e-15, -1e-20]


@pytest.mark.parametrize("place", PLACES)
def test_a_place_is_its_remainder_on_the_cycle_and_never_100(place: float) -> None:
    """Just below 0 the remainder rounds to 100, which is the same place as 0."""
    exact = float(Fraction(place) % 100)
    found = wrapped(place)
    assert 0.0 <= found < 100.0
    assert found == pytest.approx(0.0 if exact == 100.0 else exact, abs=1e-13)


@pytest.mark.parametrize("circular", [False, True])
def test_the_nearest_centre_is_the_first_of_the_nearest(circular: bool) -> None:
    rng = np.random.default_rng(4)
    places = np.concatenate([rng.uniform(0.0, 100.0, 300), [50.0, 0.0, 99.5]])
    centres = np.array([97.0, 40.0, 60.0, 40.0, 3.0])
    chosen = np.zeros(len(places))
    nearest_on_cycle(places, centres, circular, chosen)
    for place, j in zip(places, chosen, strict=True):
        ways = [[abs(place - c + turn) for turn in ((-100, 0, 100) if circular else (0,))] for c in centres]
        assert j == min(range(5), key=lambda k: min(ways[k]))


def test_a_place_just_below_the_cycles_beginning_is_within_it() -> None:
    for place in (-5e-324, -1e-300, -1e-15, -0.0, 5e-324):
        assert 0.0 <= wrapped(place) < 100.0, place
