"""Order statistics of kernels, beside numpy's."""

from __future__ import annotations

import numpy as np

from kinegraph.stream.data.ordering import median, select


def test_medians_and_ordered_values_are_numpys_to_the_bit() -> None:
    random = np.random.default_rng(1)
    for count in (1, 2, 3, 8, 51, 400):
        for values in (
            random.standard_normal(count),
            random.integers(0, 4, count).astype(float),
            np.arange(count, 0.0, -1),
        ):
            room = np.append(values, -1e9)
            assert median(room.copy(), count) == np.median(values)
            place = int(random.integers(count))
            assert select(room, count, place) == np.sort(values)[place]
            assert np.array_equal(np.sort(room[:count]), np.sort(values)) and room[-1] == -1e9
