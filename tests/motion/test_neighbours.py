"""The index against plain loops, after every frame: bit for bit in float32, and against float64 up to the stated rounding."""

from __future__ import annotations

from itertools import pairwise
from types import ModuleType

import numpy as np
import pytest

from kinegraph.operators.neighbours import Index, Neighbours, bare, layout
from kinegraph.operators.neighbours.candidates import radius_squared
from kinegraph.operators.neighbours.index import NeighbourError
from kinegraph.operators.neighbours.layout import SEAL_FROM
from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.compiler import fingerprint as fingerprint_module
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import grid
from tests.motion.naive_neighbours import Window

SEED = 20


@pytest.fixture(params=["scanned", "boxes"])
def path(request, monkeypatch):
    """Small windows are looked through from end to end; here also from their boxes down."""
    monkeypatch.setattr(layout, "SCAN_UP_TO", 10**9 if request.param == "scanned" else 0)


def motion(n, width, seed=SEED):
    """A few cyclic actions in turn, with jitter: like motion, they come back near to where they were."""
    rng = np.random.default_rng(seed)
    actions = [(rng.normal(size=(2, width)), rng.normal(size=width), rng.uniform(0.1, 0.3)) for _ in range(3)]
    x = np.empty((n, width))
    at = 0
    while at < n:
        size = min(n - at, int(rng.integers(100, 400)))
        curve, centre, step = actions[rng.integers(3)]
        phase = np.cumsum(step * rng.uniform(0.8, 1.2, size))
        x[at : at + size] = centre + np.stack([np.sin(phase), np.cos(2 * phase)], 1) @ curve
        at += size
    return x + 0.02 * rng.normal(size=x.shape)


def uniform(n, width, seed=SEED):
    return np.random.default_rng(seed).random((n, width))


def check_nearest(index, plain, k, q, at, band, found):
    """Bit for bit in float32; and as near as float64 finds them, up to (width + 2) roundings."""
    frames, distances = found
    wanted, apart = plain.nearest(k, q, at, band)
    assert np.array_equal(frames, wanted), f"frame {at}"
    assert distances.tobytes() == apart.tobytes(), f"frame {at}"
    exact = plain.distances64(q)
    sure = exact[plain.allowed(at, band, exact)]
    rest = np.sort(sure)[:k]
    slack = (index.width + 4) * 2.0**-24
    np.testing.assert_allclose(distances, rest, rtol=slack, atol=1e-30)


@pytest.mark.parametrize("vector", [True, False], ids=["vectors", "loops"])
@pytest.mark.parametrize(
    ("stream", "width", "window", "n"),
    [
        (motion, 3, 300, 900),
        (uniform, 17, 300, 900),
        (motion, 200, 300, 700),
        *(
            pytest.param(*given, marks=pytest.mark.nightly)
            for given in (
                (motion, 24, 1000, 2200),
                (motion, 75, 600, 1300),
                (uniform, 3, 700, 1500),
                (uniform, 60, 1000, 1500),
            )
        ),
    ],
)
@pytest.mark.usefixtures("path")
def test_every_frame_against_plain_loops(stream, width, window, n, vector):
    index, plain = Index(width, window, 20, vector=vector), Window(width, window)
    for number, x in enumerate(stream(n, width)):
        assert index.insert(x) == number
        plain.insert(x)
        assert (index.first, len(index)) == (plain.first, len(plain.rows))
        check_nearest(index, plain, 20, x, number, 8, index.nearest(20, band=8))


@pytest.mark.parametrize("stream", [motion, uniform])
def test_sealed_blocks_against_plain_loops(stream):
    """Every frame around the sealing of blocks and the window's first turns; every 23rd else."""
    width, window = 5, SEAL_FROM
    x = stream(window + 3300, width)
    x[700:760] = x[700]
    x[1200:1300, 2] = np.nan
    x[3000:4100] = np.nan
    index, plain = Index(width, window, 32), Window(width, window)
    plain.rows = np.empty((0, width), np.float32)
    index.follow(x[: window - 1200], 32)
    rows = np.where(np.isfinite(x).all(1)[:, None], x, np.nan).astype(np.float32)
    seals = set()
    for number in range(window - 1200, len(x)):
        index.insert(x[number])
        seals.add(int(index.state.head["sealing"]))
        plain.first = max(0, number - window + 1)
        plain.rows = rows[plain.first : number + 1]
        if (number % 1024 > 900 or number % 1024 < 60 or number % 23 == 0) and np.isfinite(x[number]).all():
            check_nearest(index, plain, 32, x[number], number, 20, index.nearest(32, band=20))
    assert len(seals) > 4, "blocks were sealed, and between two there is a rest"


@pytest.mark.parametrize("width", [6, 60])
def test_ten_thousand_frames_against_float64(width):
    """A full window of 10 000: all of its nearest are as near as float64 finds them, up to roundings of float32."""
    n, window, k, band = 13_000, 10_000, 32, 30
    x = motion(n, width, seed=width)
    rows = x.astype(np.float32).astype(np.float64)
    index = Index(width, window, k)
    index.follow(x[: window - 500], k, band=band)
    slack = (width + 4) * 2.0**-24
    for at in range(window - 500, n):
        index.insert(x[at])
        if at % 13 and at % 1024 > 6:
            continue
        frames, distances = index.nearest(k, band=band)
        first = max(0, at - window + 1)
        exact = np.sqrt(((rows[first : at - band] - rows[at]) ** 2).sum(axis=1))
        wanted = np.sort(np.partition(exact, k)[:k])
        np.testing.assert_allclose(distances, wanted, rtol=slack, err_msg=f"frame {at}")
        assert exact[frames - first].max() <= wanted[-1] * (1.0 + slack), f"frame {at}"


@pytest.mark.parametrize("window", [400, 4000, SEAL_FROM], ids=["scanned", "boxes", "sealed"])
def test_both_paths_give_the_same_bits(window):
    """Vectors and loops, with weights."""
    x = motion(window + 2100, 7)
    x[window - 3 : window + 7, 3] = np.inf
    one, two = Index(7, window, 16), Index(7, window, 16, vector=False)
    for part in np.array_split(x, 5):
        weights = np.random.default_rng(len(part)).uniform(0, 2, 7).round(1)
        one.weigh(weights)
        two.weigh(weights)
        f, d = one.follow(part, 16, band=5)
        g, e = two.follow(part, 16, band=5)
        assert np.array_equal(f, g)
        assert d.tobytes() == e.tobytes()


@pytest.mark.parametrize("vector", [True, False], ids=["vectors", "loops"])
@pytest.mark.usefixtures("path")
def test_more_nearest_than_are_counted(vector):
    """Many are sorted, not put in order by counting; and where fewer frames are left than were asked for, all of them come."""
    k = 3 * layout.COUNTED
    index, plain = Index(4, 2 * k, k, vector=vector), Window(4, 2 * k)
    for number, row in enumerate(motion(4 * k, 4)):
        index.insert(row)
        plain.insert(row)
        if number % 7 == 0:
            check_nearest(index, plain, k, row, number, 3, index.nearest(k, band=3))


@pytest.mark.usefixtures("path")
def test_ties_and_duplicates():
    """Whole numbers make many equal distances: the older come first, and are those kept."""
    x = np.random.default_rng(SEED).integers(0, 3, (900, 3)).astype(float)
    index, plain = Index(3, 400, 12), Window(3, 400)
    for number, row in enumerate(x):
        index.insert(row)
        plain.insert(row)
        check_nearest(index, plain, 12, row, number, 0, index.nearest(12))
    index, plain = Index(3, 400, 12), Window(3, 400)
    for number in range(600):
        index.insert(np.zeros(3))
        if number:
            frames, distances = index.nearest(12)
            assert np.array_equal(frames, np.arange(index.first, min(index.first + 12, number)))
            assert (distances == 0).all()


@pytest.mark.usefixtures("path")
def test_bad_frames_are_nobodys_neighbours():
    x = motion(1500, 6)
    rng = np.random.default_rng(SEED)
    for value in (np.nan, np.inf, -np.inf, 1e30):
        x[rng.integers(0, 1500, 60), rng.integers(0, 6, 60)] = value
    x[600:900, 1] = np.nan
    index, plain = Index(6, 500, 10), Window(6, 500)
    for number, row in enumerate(x):
        index.insert(row)
        plain.insert(row)
        found = index.nearest(10, band=3)
        if np.isnan(plain.rows[-1]).any():
            assert len(found[0]) == 0
            assert np.isnan(index.frame(number)).all()
        else:
            check_nearest(index, plain, 10, row, number, 3, found)


@pytest.mark.usefixtures("path")
def test_weights_change_at_any_time():
    x = motion(1200, 8)
    rng = np.random.default_rng(SEED)
    index, plain = Index(8, 500, 10), Window(8, 500)
    for number, row in enumerate(x):
        if number % 100 == 50:
            weights = rng.uniform(0, 3, 8) * (rng.random(8) > 0.3)
            index.weigh(weights)
            plain.weights = weights.astype(np.float32)
        index.insert(row)
        plain.insert(row)
        check_nearest(index, plain, 10, row, number, 5, index.nearest(10, band=5))


@pytest.mark.parametrize("both", [False, True], ids=["one way", "both ways"])
@pytest.mark.parametrize("stream", [motion, uniform])
@pytest.mark.usefixtures("path")
def test_radius_both_ways(stream, both):
    x = stream(1300, 6)
    radii = np.random.default_rng(SEED).uniform(0.05, 0.6, 1300)
    radii[::50] = np.nan
    index, plain = Index(6, 450, 4), Window(6, 450)
    found = 0
    for number, row in enumerate(x):
        index.insert(row, radius=radii[number])
        plain.insert(row, radius=radii[number])
        frames, distances, ways = index.within_ways(radii[number], band=4, both=both)
        wanted, apart, both_ways = plain.within(radii[number], row, number, 4, both)
        assert np.array_equal(frames, wanted)
        assert distances.tobytes() == apart.tobytes()
        assert np.array_equal(ways, both_ways)
        found += len(frames)
    assert found > 1000


@pytest.mark.usefixtures("path")
def test_the_boundary_of_a_radius_is_the_reported_distance():
    """Whoever is reported at distance d is within d, and not within the next smaller float32."""
    x = motion(400, 5)
    index = Index(5, 400, 30)
    index.follow(x, 30)
    frames, distances = index.nearest(30, band=10)
    for frame, d in zip(frames, distances, strict=True):
        assert frame in index.within(float(d), band=10)[0]
        assert frame not in index.within(float(np.nextafter(d, np.float32(0))), band=10)[0]
    for radius in (0.0, 1e-30, 0.1, 1.0, 3.3333, 1e10, 3e19, np.inf):
        squared = np.float32(radius_squared(radius))
        assert np.sqrt(squared) <= np.float32(radius)
    assert radius_squared(np.nan) < 0


@pytest.mark.usefixtures("path")
def test_any_vector_and_any_band():
    """Queries that are not the newest frame, one after another, among insertions."""
    rng = np.random.default_rng(SEED)
    x = motion(700, 4)
    index, plain = Index(4, 350, 50), Window(4, 350)
    for number, row in enumerate(x):
        index.insert(row)
        plain.insert(row)
        q = x[rng.integers(700)] + rng.normal(size=4) * rng.choice([0.0, 0.1, 10.0])
        at, band, k = int(rng.integers(0, number + 1)), int(rng.integers(-1, 60)), int(rng.integers(0, 51))
        check_nearest(index, plain, k, q, at, band, index.nearest(k, q, at=at, band=band))


def test_snapshot_anywhere():
    """At random places, also while a block is being sealed, into another index."""
    x = motion(SEAL_FROM + 2500, 4)
    whole = Index(4, SEAL_FROM, 8)
    frames, distances = whole.follow(x, 8, band=5)
    index = Index(4, SEAL_FROM, 8)
    places = [0, *sorted(np.random.default_rng(SEED).integers(0, len(x), 8)), len(x)]
    memory = index.memory_bytes
    for a, b in pairwise(places):
        kept = index.snapshot()
        index = Index(4, SEAL_FROM, 8)
        index.restore(kept)
        f, d = index.follow(x[a:b], 8, band=5)
        assert np.array_equal(f, frames[a:b])
        assert d.tobytes() == distances[a:b].tobytes()
    assert index.memory_bytes == memory


def test_frames_can_be_read_back_and_forgotten():
    x = motion(800, 3).astype(np.float32)
    index = Index(3, 300, 5)
    index.follow(x, 5)
    for number in range(500, 800):
        assert np.array_equal(index.frame(number), x[number])
    with pytest.raises(NeighbourError, match="holds 500 to 799"):
        index.frame(499)
    index.clear()
    assert (len(index), index.first, index.newest) == (0, 800, 799)
    assert len(index.nearest(5, x[0])[0]) == 0
    index.follow(x[:40], 5)
    assert index.nearest(1, x[7])[0] == [807]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda i: i.insert([1.0, 2.0]), r"must be \(3,\)"),
        (lambda i: i.nearest(9), "must be from 0 to 8"),
        (lambda i: i.weigh([1, -1, 1]), "not negative"),
        (lambda i: i.follow(np.zeros((2, 4)), 1), r"must be \(n, 3\)"),
        (lambda i: Index(0, 300), "width is 0"),
    ],
)
def test_what_cannot_be_is_refused(call, message):
    with pytest.raises(NeighbourError, match=message):
        call(Index(3, 300, 8))


def play(operator, x, rate_hz=30.0, weights=None, cut=7):
    """All of an operator's output for frames `x`, in chunks; `weights` are (row, value) pairs, given before that row."""
    spec = StreamSpec((x.shape[1],), rate_hz=rate_hz)
    specs = {"in": spec, **({"weights": StreamSpec((x.shape[1],))} if weights else {})}
    operator.open(specs)
    time = grid(rate_hz, len(x))
    out = {"nearest": [], "within": []}
    steps = sorted({0, len(x), *range(0, len(x), cut), *(row for row, _ in weights or [])})
    for a, b in pairwise(steps):
        for row, value in weights or []:
            if row == a:
                stamp = time[a : a + 1] - 1
                operator.process("weights", Chunk(stamp, value[None], int(stamp[0])))
        for name, chunk in operator.process("in", Chunk(time[a:b], x[a:b], int(time[b - 1]))):
            out[name].append(chunk)
    return time, *(
        (np.concatenate([c.time for c in out[name]]), np.concatenate([c.data for c in out[name]]))
        for name in ("nearest", "within")
    )


@pytest.mark.parametrize("cut", [1, 50, 5000])
def test_operator_against_plain_loops(cut):
    x = motion(800, 5)
    x[300:310, 2] = np.nan
    changes = [(0, np.ones(5)), (400, np.array([1.0, 0.0, 2.0, 0.5, 1.0]))]
    operator = Neighbours(window_s=10.0, k=6, within=0.3, band_s=0.5)
    time, (stamps, nearest), (when, within) = play(operator, x, weights=changes, cut=cut)
    assert np.array_equal(stamps, time)
    plain = Window(5, 300)
    done = 0
    for number, row in enumerate(x):
        plain.insert(row)
        plain.weights = changes[number >= 400][1].astype(np.float32)
        frames, distances = plain.nearest(6, row, number, 15)
        count = len(frames)
        assert np.array_equal(nearest["frame"][number, :count], frames)
        assert nearest["distance"][number, :count].tobytes() == distances.tobytes()
        assert np.array_equal(nearest["time"][number, :count], time[frames])
        assert (nearest["frame"][number, count:] == -1).all()
        assert (nearest["time"][number, count:] == -1).all()
        frames, distances, _ = plain.within(0.3, row, number, 15)
        events = within[done : done + len(frames)]
        assert (when[done : done + len(frames)] == time[number]).all()
        assert (events["frame"] == number).all()
        assert np.array_equal(events["neighbour"], frames)
        assert np.array_equal(events["neighbour_time"], time[frames])
        assert events["distance"].tobytes() == distances.tobytes()
        assert events["near"].all()
        done += len(frames)
    assert done == len(within) > 1000


def test_weights_that_float32_cannot_hold_are_passed_over():
    x = motion(300, 3)
    bad = [(100, np.full(3, 1e39)), (150, np.array([1.0, np.nan, 1.0])), (200, np.array([1.0, -1.0, 1.0]))]
    _, (_, plain), _ = play(Neighbours(window_s=5.0, k=4), x)
    _, (_, steered), _ = play(Neighbours(window_s=5.0, k=4), x, weights=bad)
    assert steered.tobytes() == plain.tobytes()
    with pytest.raises(NeighbourError, match="finite in float32"):
        Index(3, 300).weigh(np.full(3, 1e39))


def test_operator_says_what_it_cannot_take():
    with pytest.raises(ParameterError, match=r"weights is .* at most 3\.4e"):
        Neighbours(weights=(1.0, 1e39, 1.0)).open({"in": StreamSpec((3,), rate_hz=30.0)})
    with pytest.raises(ParameterError, match="one per feature"):
        Neighbours(weights=(1.0, 2.0)).open({"in": StreamSpec((3,), rate_hz=30.0)})
    with pytest.raises(InputError, match="regular"):
        Neighbours().open({"in": StreamSpec((3,))})
    with pytest.raises(InputError, match="a signal of 3 numbers"):
        Neighbours().open({"in": StreamSpec((3,), rate_hz=30.0), "weights": StreamSpec((2,))})


@pytest.mark.parametrize("module", [bare, layout])
def test_a_kernel_is_not_used_once_the_layout_has_changed(module: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels that take an index are kept by its type's name, which changes with the files that say where its arrays are."""
    now = fingerprint_module._hash_of
    assert bare._bare.name == f"BareIndex_{fingerprint_module.fingerprint(bare._get)}"
    monkeypatch.setattr(fingerprint_module, "_hash_of", lambda path: "edited" if path == module.__file__ else now(path))
    assert bare._bare.name != f"BareIndex_{fingerprint_module.fingerprint(bare._get)}"
