"""Mixtures of activation peaks: EM equals scikit-learn's and a plain wrapped EM's, distances equal integration on a grid."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import find_peaks as find_tops
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from kinegraph.operators.emg.mixtures.distance import cauchy_schwarz, kullback_leibler, merge_close_modes
from kinegraph.operators.emg.mixtures.kernel import begin_mixture, cluster_places, fit, full
from kinegraph.operators.emg.mixtures.peaks_kernel import find_peaks
from kinegraph.stream.chunk import Samples
from tests.gait.naive_emg import cycles, local_maxima, zero_phase_envelope
from tests.support.real import needs_data

mixture = pytest.importorskip("sklearn.mixture", reason="scikit-learn is not installed")
LEAST = np.array([1e-3, 1e-6])
Mixture = tuple[Samples, Samples, Samples]


def some_points(seed: int, centres: list[float], n: int = 60) -> Samples:
    """Peaks about these places (%), each with a height and a width of its own."""
    rng = np.random.default_rng(seed)
    made = [
        np.stack([rng.normal(c, 2.0 + i, n) % 100.0, rng.normal(1.0 + i, 0.2 + 0.1 * i, n)], 1)
        for i, c in enumerate(centres)
    ]
    return np.ascontiguousarray(np.concatenate(made))


def started(points: Samples, centres: list[float], circular: bool) -> Mixture:
    k = len(centres)
    chosen, places = np.zeros(len(points)), np.array(centres)
    cluster_places(np.ascontiguousarray(points[:, 0]), places, circular, 100, chosen)
    weights, means, covariances = np.zeros(k), np.zeros((k, 2)), np.zeros((k, 3))
    made = begin_mixture(points, chosen, places, circular, LEAST, weights, means, covariances)
    return weights[:made].copy(), means[:made].copy(), covariances[:made].copy()


def fitted(
    points: Samples, start: Mixture, turns: int, tolerance: float = 1e-6, most: int = 200
) -> tuple[Mixture, int]:
    made = tuple(part.copy() for part in start)
    scratch = np.zeros((len(start[0]), 11 + 2 * turns))
    steps, _, _ = fit(points, *made, turns, LEAST, tolerance, most, -np.inf, scratch)
    return made, steps  # type: ignore[return-value]


def plain_wrapped_em(points: Samples, start: Mixture, turns: int, steps: int) -> Mixture:
    """The definition, in numpy: each point stands in every turn of the cycle, with a hidden turn beside its hidden mode."""
    weights, means, covariances = start[0].copy(), start[1].copy(), full(start[2])
    turned = np.stack([points + np.array([100.0 * t, 0.0]) for t in range(-turns, turns + 1)])
    for _ in range(steps):
        logs = np.stack(
            [
                np.log(w) + multivariate_normal(m, c).logpdf(turned.reshape(-1, 2)).reshape(turned.shape[:2])
                for w, m, c in zip(weights, means, covariances, strict=True)
            ]
        )
        shares = np.exp(logs - logsumexp(logs, axis=(0, 1)))
        for j, share in enumerate(shares):
            mass = share.sum()
            mean = (share[..., None] * turned).sum((0, 1)) / mass
            off = turned - mean
            weights[j] = mass / len(points)
            covariances[j] = np.einsum("ti,tia,tib->ab", share, off, off) / mass + np.diag(LEAST)
            means[j] = mean[0] % 100.0, mean[1]
    return weights, means, np.ascontiguousarray(covariances.reshape(-1, 4)[:, [0, 1, 3]])


def as_scikit_learn(points: Samples, start: Mixture, scale: Samples) -> tuple[Mixture, int]:
    """scikit-learn has one floor for all directions, so both sides get the floor of points that are scaled alike."""
    peer = mixture.GaussianMixture(
        len(start[0]), tol=1e-6, max_iter=200, reg_covar=1e-6,
        weights_init=start[0], means_init=start[1] / scale, precisions_init=np.linalg.inv(full(start[2]) / np.outer(scale, scale)),
    )  # fmt: skip
    peer.fit(points / scale)
    covariances = (peer.covariances_ * np.outer(scale, scale)).reshape(-1, 4)[:, [0, 1, 3]]
    return (peer.weights_, peer.means_ * scale, covariances), peer.n_iter_


def recorded_peaks() -> list[tuple[str, Samples, Samples]]:
    """All local maxima and the mean curve of each muscle of the real walks: on the treadmill, and all trials overground."""
    folder = Path(os.environ["KINEGRAPH_DATA"]) / "emg"
    walk = np.load(folder / "emg_santuz_tw12.npz")
    made = peaks_of("treadmill", walk["names"], walk["emg_uV"], walk["t_s"][0], walk["touchdown_s"][:-1])
    for file in sorted(folder.glob("emg_epfl_*.npz")):
        with np.load(file) as walks:
            for trial in (
                name.removesuffix("_emg") for name in walks.files if name.endswith("_emg") and name != "fs_emg"
            ):
                if trial == "emg" or f"{trial}_kin" not in walks:
                    continue
                seconds = touched_down(walks[f"{trial}_kin"], list(walks["kin_names"]))
                made += peaks_of(f"{file.stem} {trial}", walks["emg_names"], walks[f"{trial}_emg"], 0.0, seconds)
    return made


def peaks_of(
    walk: str, names: Samples, emg: Samples, begin_s: float, touch_s: Samples
) -> list[tuple[str, Samples, Samples]]:
    envelope = zero_phase_envelope(emg, 1000.0)
    curves = cycles(np.arange(len(envelope)) / 120.0 + begin_s, envelope, touch_s)
    made = []
    for c, name in enumerate(names):
        peaks = [(p, curve[p]) for curve in curves[:, :, c] for p in local_maxima(curve)]
        made.append((f"{walk}: {name}", np.array(peaks, float), np.ascontiguousarray(curves[:, :, c].mean(0))))
    return made


def touched_down(markers: Samples, names: list[str]) -> Samples:
    """Seconds at which the right ankle lies farthest ahead of the hip (Zeni et al. 2008), markers (n, 8, 3) at 100 Hz."""
    hip, ankle = markers[:, names.index("RHIP"), 1], markers[:, names.index("RANK"), 1]
    ahead = (ankle - hip) * np.sign(hip[-1] - hip[0])
    farthest = find_tops(ahead, distance=70, prominence=100.0)[0] / 100.0
    return farthest[(farthest > 0.3) & (farthest < len(markers) / 100.0 - 0.3)]


@pytest.mark.parametrize("seed", range(6))
def test_without_turns_it_is_scikit_learns(seed: int) -> None:
    points = some_points(seed, [20.0, 50.0, 75.0])
    start = started(points, [15.0, 55.0, 80.0], circular=False)
    scale = np.sqrt(LEAST / 1e-6)
    (weights, means, covariances), steps = fitted(points, start, 0)
    peer, peer_steps = as_scikit_learn(points, start, scale)
    assert steps == peer_steps
    for ours, theirs in zip((weights, means, covariances), peer, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("seed", range(6))
def test_along_the_circle_it_is_the_plain_definition(seed: int) -> None:
    points = some_points(seed, [1.0, 45.0, 97.0])
    start = started(points, [3.0, 50.0, 90.0], circular=True)
    ours, steps = fitted(points, start, 1)
    for a, b in zip(ours, plain_wrapped_em(points, start, 1, steps), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-8)


def test_a_burst_at_touch_down_is_one_mode() -> None:
    rng = np.random.default_rng(3)
    points = np.ascontiguousarray(np.stack([rng.normal(0.0, 3.0, 300) % 100.0, rng.normal(1.0, 0.1, 300)], 1))
    (weights, means, covariances), _ = fitted(points, started(points, [98.0], circular=True), 1)
    apart = (means[0, 0] + 50.0) % 100.0 - 50.0
    assert abs(apart) < 0.6 and weights[0] == pytest.approx(1.0)
    assert 2.5 < np.sqrt(covariances[0, 0]) < 3.5


@pytest.mark.parametrize(
    "points", [np.full((5, 2), 3.0), np.array([[99.0, 1.0], [1.0, 1.0], [99.0, 1.0]])], ids=["one place", "one height"]
)
def test_degenerate_points_give_a_mixture_with_the_floor(points: Samples) -> None:
    (weights, means, covariances), _ = fitted(points, started(points, [0.0, 50.0], circular=True), 1)
    assert len(weights) == 1, "a cluster without points is no mode"
    assert np.isfinite(means).all() and (covariances[:, [0, 2]] >= LEAST * 0.999).all()


def on_grid(mixture_: Mixture, x: Samples, y: Samples, turns: int) -> Samples:
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), -1)
    return sum(
        w * multivariate_normal(m, c).pdf(grid + np.array([100.0 * t, 0.0]))
        for w, m, c in zip(mixture_[0], mixture_[1], full(mixture_[2]), strict=True)
        for t in range(-turns, turns + 1)
    )


@pytest.mark.parametrize("turns", [0, 3])
def test_the_distance_is_the_integral(turns: int) -> None:
    """Also of mixtures with different numbers of modes. A sum over an even grid is exact for functions that are this smooth."""
    one = (np.array([0.7, 0.3]), np.array([[2.0, 1.0], [60.0, 2.0]]), np.array([[9.0, 0.5, 0.2], [25.0, -0.4, 0.1]]))
    two = (
        np.array([0.2, 0.5, 0.3]),
        np.array([[98.0, 1.2], [55.0, 1.5], [30.0, 0.5]]),
        np.array([[16.0, 0.0, 0.3], [9.0, 0.2, 0.2], [4.0, 0.0, 0.1]]),
    )
    x = np.arange(0.0, 100.0, 0.25) if turns else np.arange(-100.0, 200.0, 0.25)
    y = np.arange(-5.0, 9.0, 0.02)
    p, q = on_grid(one, x, y, turns), on_grid(two, x, y, turns)
    expected = -np.log((p * q).sum() / np.sqrt((p * p).sum() * (q * q).sum()))
    assert cauchy_schwarz(*one, *two, turns) == pytest.approx(expected, abs=1e-10)
    assert cauchy_schwarz(*one, *two, turns) == cauchy_schwarz(*two, *one, turns)
    assert cauchy_schwarz(*one, *one, turns) == pytest.approx(0.0, abs=1e-12)


def test_two_names_for_one_mode_are_merged() -> None:
    """A mode that was split into two at the same place becomes what it was; one far away stays."""
    weights = np.array([0.3, 0.3, 0.4])
    means = np.array([[99.0, 1.0], [1.0, 1.0], [50.0, 2.0]])
    covariances = np.array([[16.0, 0.0, 0.04], [16.0, 0.0, 0.04], [9.0, 0.0, 0.04]])
    assert kullback_leibler(means, covariances, 0, 1, True) == pytest.approx(0.125)
    assert merge_close_modes(weights, means, covariances, 3, 0.5, True) == 2
    np.testing.assert_allclose(weights[:2], [0.6, 0.4])
    assert means[0, 0] in (0.0, pytest.approx(100.0)) or means[0, 0] < 1e-9
    np.testing.assert_allclose(covariances[0], [17.0, 0.0, 0.04])
    np.testing.assert_allclose(means[1], [50.0, 2.0])


def test_two_modes_that_are_one_are_merged_and_one_stays() -> None:
    weights, means = np.array([0.5, 0.5]), np.array([[40.0, 1.0], [41.0, 1.0]])
    covariances = np.array([[16.0, 0.0, 0.04], [16.0, 0.0, 0.04]])
    assert merge_close_modes(weights, means, covariances, 2, 0.5, True) == 1
    np.testing.assert_allclose(means[0], [40.5, 1.0])
    assert merge_close_modes(weights, means, covariances, 1, 0.5, True) == 1


def test_peaks_of_a_curve_are_found_also_across_touch_down() -> None:
    p = np.arange(100.0)
    curve = sum(
        h * np.exp(-0.5 * ((p - c + 50.0) % 100.0 - 50.0) ** 2 / 9.0) for c, h in ((0.0, 1.0), (30.0, 0.6), (70.0, 0.8))
    )
    places, scratch = np.zeros(16), np.zeros((2, 100))
    found = find_peaks(curve, 3, 3, 0.1, True, places, scratch)
    assert [round(place) for place in places[:found]] == [0, 30, 70]


@needs_data
@pytest.mark.nightly
def test_on_the_real_walks_it_equals_scikit_learn_and_the_plain_definition() -> None:
    walks = recorded_peaks()
    assert len(walks) > 13 + 4 * 6, "each of the seven recordings"
    for name, points, mean in walks:
        places, scratch = np.zeros(16), np.zeros((2, 100))
        k = find_peaks(mean, 3, 3, 0.1, True, places, scratch)
        assert 1 <= k <= (12 if "treadmill" in name else 16), name  # overground some electrodes are bad
        points = points / [1.0, mean.max()]
        flat, scale = started(points, list(places[:k]), circular=False), np.sqrt(LEAST / 1e-6)
        for ours, theirs in zip(fitted(points, flat, 0)[0], as_scikit_learn(points, flat, scale)[0], strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-8, err_msg=name)
        start = started(points, list(places[:k]), circular=True)
        ours, steps = fitted(points, start, 1)
        for a, b in zip(ours, plain_wrapped_em(points, start, 1, steps), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-8, err_msg=name)
