"""Running median and quartiles against numpy's, window by window."""

import numpy as np

from kinegraph.operators.features.standardise import QUARTILES, Standardise
from kinegraph.stream.chunk import FOREVER, Chunk, StreamSpec
from kinegraph.stream.operator import grid


def standardised(data, **parameters):
    operator = Standardise(**parameters)
    operator.open({"in": StreamSpec((data.shape[1],), rate_hz=30.0)})
    return operator.process("in", Chunk(grid(30.0, len(data)), data, FOREVER)).data


def by_numpy(data, w):
    made = np.empty_like(data)
    for i in range(len(data)):
        for c in range(data.shape[1]):
            seen = data[: i + 1, c][np.isfinite(data[: i + 1, c])][-w:]
            low, middle, high = np.quantile(seen, [0.25, 0.5, 0.75]) if len(seen) else (0.0, 0.0, 0.0)
            spread = (high - low) / QUARTILES
            made[i, c] = (data[i, c] - middle) / spread if spread > 0 else 0.0 * data[i, c]
    return made


def test_every_value_agrees_with_numpy_over_its_window_with_ties_and_bad_values():
    data = np.random.default_rng(2).normal(size=(200, 3)).round(1) * (1.0, 100.0, 3.0)
    data[40:50, 1] = np.nan
    data[60:70, 2] = 7.0
    np.testing.assert_allclose(standardised(data, window_s=0.5, min_share=0.0), by_numpy(data, 15), atol=1e-12)


def test_frozen_statistics_stay_and_a_silent_channel_stays_silent():
    data = np.random.default_rng(3).normal(size=(200, 2)) * (1.0, 1e-3)
    made = standardised(data, freeze_s=2.0, min_share=0.1)
    first = data[:60, 0]
    spread = np.subtract(*np.quantile(first, [0.75, 0.25])) / QUARTILES
    np.testing.assert_allclose(made[60:, 0], (data[60:, 0] - np.median(first)) / spread)
    assert np.abs(made[60:, 1]).max() < 0.1
    moved = data + np.where(np.arange(200) < 60, 0.0, 50.0)[:, None]
    np.testing.assert_allclose(standardised(moved, freeze_s=2.0)[60:, 0], made[60:, 0] + 50.0 / spread)
