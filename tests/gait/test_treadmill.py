"""The simulated treadmill session: the same in any chunks, true to what it says of itself, and spoilt where its settings say so."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pytest

from kinegraph.devices.people.treadmill import Treadmill, truth
from kinegraph.devices.people.treadmill.faults import Fault
from kinegraph.devices.people.treadmill.signal import BURSTS, Signal, Walker
from kinegraph.devices.people.treadmill.source import BeltSpeed
from kinegraph.stream.chunk import NS, Chunk
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.params import build

START = 1_767_225_600 * NS  # 2026-01-01T00:00:00Z
WALK = Treadmill(realtime=False, start="2026-01-01T00:00:00Z", duration_s=12.0, seed=3)


@dataclass
class Recorder:
    """A feed that keeps everything, with a clock that runs only while its source waits."""

    clock: int = START
    chunks: dict[str, list[Chunk]] = field(default_factory=lambda: {name: [] for name in Treadmill.outputs})
    waited: list[float] = field(default_factory=list)
    problems: Counter[str] = field(default_factory=Counter)
    arrivals: list[int] = field(default_factory=list)
    stop_at: int = 0
    is_ready: bool = False

    def emit(self, chunk: Chunk, output: str = "out") -> None:
        self.chunks[output].append(chunk)
        if output == "emg" and len(chunk):
            self.arrivals.append(self.clock)

    def now(self) -> int:
        return self.clock

    def wait(self, seconds: float) -> bool:
        self.waited.append(seconds)
        self.clock += round(seconds * NS)
        return self.stopped

    @property
    def stopped(self) -> bool:
        return bool(self.stop_at) and self.clock >= self.stop_at

    def ready(self) -> None:
        self.is_ready = True

    def listen(self, timeout_s: float) -> str | None:
        return None

    def identify(self, device: str, **facts: str | float) -> None: ...

    def problem(self, kind: str, count: int = 1) -> None:
        self.problems[kind] += count

    again = False

    def tell(self, kind: str, **facts: str | float) -> None: ...

    def device_clock(self, **facts: float) -> None: ...

    def all(self, output: str) -> tuple[np.ndarray, np.ndarray]:
        chunks = self.chunks[output]
        return np.concatenate([c.time for c in chunks]), np.concatenate([c.data for c in chunks])


def walked(treadmill: Treadmill, **given: int) -> Recorder:
    treadmill.specs()
    feed = Recorder(**given)
    treadmill.read(feed)
    return feed


def test_samples_do_not_depend_on_chunks() -> None:
    faults = tuple(Fault(kind, "TA", 1.0, 3.0, 50.0, 0.3) for kind in ("hum", "noise", "artefacts", "clipping"))
    whole = walked(replace(WALK, chunk_ms=1000.0, faults=faults))
    for chunk_ms in (1.0, 7.3, 10.0, 213.0):
        cut = walked(replace(WALK, chunk_ms=chunk_ms, faults=faults))
        for output in Treadmill.outputs:
            for a, b in zip(whole.all(output), cut.all(output), strict=True):
                assert a.tobytes() == b.tobytes()


def test_any_part_can_be_made_alone() -> None:
    signal = Signal(Walker(seed=5))
    whole, force = signal.read(0, 5000)
    for start, stop in ((4321, 4322), (199, 201), (0, 1), (3000, 3700)):
        emg, push = Signal(Walker(seed=5)).read(start, stop)
        assert np.array_equal(emg, whole[start:stop])
        assert np.array_equal(push, force[start:stop])


def test_stamps_come_from_index_and_start() -> None:
    time, data = walked(replace(WALK, rate_hz=1111.0)).all("emg")
    assert len(time) == len(data) == 12 * 1111
    assert np.array_equal(time, START + np.round(np.arange(len(time)) * (NS / 1111.0)).astype(np.int64))


def test_without_a_start_the_first_stamp_is_the_session_time() -> None:
    assert walked(replace(WALK, start=""), clock=START + 12345).all("emg")[0][0] == START + 12345


def test_streams_keep_their_promises() -> None:
    specs = WALK.specs()
    feed = walked(WALK)
    for output, chunks in feed.chunks.items():
        until = 0
        for chunk in chunks:
            assert chunk.data.dtype == specs[output].dtype and chunk.data.shape[1:] == specs[output].shape
            assert chunk.until >= until and (
                not len(chunk) or (until < chunk.time[0] and chunk.time[-1] <= chunk.until)
            )
            until = chunk.until
        assert until == START + 11_999 * NS // 1000


def test_contacts_are_the_truth() -> None:
    feed = walked(WALK)
    stamps = feed.all("emg")[0]
    cycles, _ = truth(WALK, 12_000)
    stamp, event = feed.all("touchdown")
    assert np.array_equal(stamp, event["onset"])
    assert np.array_equal(stamp[:-1], stamps[cycles[:, 0]]) and stamp[-1] == stamps[cycles[-1, 2]]
    lift = feed.all("liftoff")[0]
    assert np.array_equal(lift[lift > stamp[0]][: len(cycles)], stamps[cycles[:, 1]])


def test_cycles_are_plausible() -> None:
    cycles = Signal(Walker(seed=1)).gait.cycles(0, 1_200_000)
    length = (cycles[:, 2] - cycles[:, 0]) / 1000
    stance = (cycles[:, 1] - cycles[:, 0]) / (cycles[:, 2] - cycles[:, 0])
    assert np.array_equal(cycles[1:, 0], cycles[:-1, 2])
    assert abs(length.mean() - 60 / 57) < 0.002 and 0.01 < length.std() < 0.03
    assert abs(stance.mean() - 0.63) < 0.002 and stance.std() < 0.01


def test_cadence_and_stance_follow_the_belt() -> None:
    speeds = (BeltSpeed(0.0, 0.8), BeltSpeed(60.0, 1.5))
    gait = Treadmill(muscles=("TA",), speeds=speeds).signal().gait
    cycles = gait.cycles(0, 120_000)
    stance = []
    for begin, speed in ((0, 0.8), (60_000, 1.5)):
        mine = cycles[(cycles[:, 0] >= begin) & (cycles[:, 2] < begin + 60_000)]
        strides = mine[:, 2] - mine[:, 0]
        assert abs(strides.mean() / (60_000 / 57 / np.sqrt(speed / 1.2)) - 1) < 0.01 and len(mine) > 40
        stance.append(float(np.mean((mine[:, 1] - mine[:, 0]) / strides)))
    assert abs(stance[0] - stance[1] - 0.035) < 0.005
    with pytest.raises(ParameterError, match="in order of from_s"):
        Treadmill(speeds=speeds[::-1]).specs()


def test_force_crosses_twenty_newtons_at_the_contacts() -> None:
    feed = walked(WALK)
    push = feed.all("force")[1][:, 0] > 20
    down = np.flatnonzero(push[1:] & ~push[:-1]) + 1
    up = np.flatnonzero(~push[1:] & push[:-1]) + 1
    gait = WALK.signal().gait
    assert np.abs(down - gait.touchdowns(0, 12_000)).max() <= 5
    assert np.abs(up - gait.liftoffs(0, 12_000)).max() <= 5


def test_emg_is_as_loud_as_its_envelope_says() -> None:
    still = replace(WALK, noise_uv=0.0, duration_s=40.0)
    emg = walked(still).all("emg")[1]
    _, envelope = truth(still, len(emg))
    ratio = emg / envelope
    assert np.abs(ratio.std(0) - 1).max() < 0.05
    power = np.abs(np.fft.rfft(ratio[:, 0])) ** 2
    hz = np.fft.rfftfreq(len(emg), 1e-3)
    assert power[hz < 10].sum() < 0.02 * power.sum() and power[(hz > 30) & (hz < 250)].sum() > 0.8 * power.sum()


def test_muscles_work_when_textbooks_say() -> None:
    signal = Signal(Walker(jitter_percent=0.0))
    cycles = signal.gait.cycles(0, 60_000)
    curves = np.mean([signal.envelope(np.linspace(a, b, 100, endpoint=False).astype(int)) for a, _, b in cycles], 0)
    peaks = dict(zip(signal.walker.muscles, curves.argmax(0), strict=True))
    for muscle, low, high in (
        ("VL", 0, 15),
        ("SO", 35, 55),
        ("GM", 30, 50),
        ("BF", 85, 100),
        ("TA", 0, 10),
        ("ME", 0, 20),
    ):
        assert low <= peaks[muscle] < high, muscle


def test_faults_hit_their_channel_and_their_time_only() -> None:
    clean = walked(WALK).all("emg")[1]
    for fault in (
        Fault("flat", "SO", 2.0, 3.0),
        Fault("hum", "SO", 2.0, 3.0, 100.0),
        Fault("clipping", "SO", 2.0, 3.0, 30.0),
        Fault("artefacts", "SO", 2.0, 3.0, 500.0),
        Fault("noise", "SO", 2.0, 3.0, 20.0),
    ):
        emg = walked(replace(WALK, faults=(fault,))).all("emg")[1]
        changed = emg != clean
        assert not changed[:, :-1].any() and not changed[:2000].any() and not changed[5000:].any()
        hit = emg[2000:5000, -1]
        seen = {
            "flat": hit.std() == 0,
            "hum": np.abs(np.fft.rfft(hit))[150] > 0.4 * 100 * len(hit),
            "clipping": np.abs(hit).max() == 30,
            "artefacts": np.abs(hit - clean[2000:5000, -1]).max() > 200,
            "noise": abs((hit - clean[2000:5000, -1]).std() - 20) < 2,
        }
        assert seen[fault.kind], fault.kind


def test_lost_packets_are_gaps_that_are_counted() -> None:
    feed = walked(replace(WALK, chunk_ms=13.0, faults=(Fault("lost", from_s=1.0, for_s=8.0, share=0.3),)))
    time = feed.all("emg")[0]
    at = (time - START) // 1_000_000
    lost = {int(c.time[0] - START) // 1_000_000: c.lost for c in feed.chunks["emg"] if c.lost}
    gaps = {int(b): int(b - a - 1) for a, b in pairwise(at) if b != a + 1}
    assert lost == gaps and sum(gaps.values()) == feed.problems["lost sample"] == 12_000 - len(time)
    assert 0.2 * 8000 < sum(gaps.values()) < 0.4 * 8000 and all(gap % 10 == 0 for gap in gaps.values())
    assert np.array_equal(feed.all("emg")[1], walked(WALK).all("emg")[1][at])
    assert len(feed.all("force")[0]) == 12_000


def test_in_real_time_a_sample_comes_when_it_is_due() -> None:
    feed = walked(replace(WALK, realtime=True, start="", duration_s=2.0))
    last = [c.time[-1] for c in feed.chunks["emg"]]
    assert feed.is_ready and len(last) == 200
    assert all(0 <= arrival - stamp <= 2_000_000 for arrival, stamp in zip(feed.arrivals, last, strict=True))


def test_a_stall_delays_samples_and_loses_none() -> None:
    feed = walked(
        replace(WALK, realtime=True, start="", duration_s=3.0, faults=(Fault("stall", from_s=1.0, for_s=1.5),))
    )
    assert len(feed.all("emg")[0]) == 3000
    arrivals = (np.array(feed.arrivals) - START) / NS
    assert not ((arrivals > 1.0) & (arrivals < 2.499)).any() and ((arrivals > 2.49) & (arrivals < 2.51)).sum() > 140


@pytest.mark.parametrize("faults", [(), (Fault("stall", from_s=0.5),)])
def test_an_endless_walk_stops_when_told(faults: tuple[Fault, ...]) -> None:
    feed = walked(replace(WALK, realtime=True, start="", duration_s=0.0, faults=faults), stop_at=START + 2 * NS)
    assert 2.0 <= (feed.clock - START) / NS < 3.1


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"muscles": ["SO", "GN"]}, "valid are 'BF', 'FL'"),
        ({"muscles": ["SO", "SO"]}, "each named once"),
        ({"start": "yesterday"}, "2026-01-31T09:00:00Z"),
        ({"muscles": ["SO"], "faults": [{"kind": "flat", "muscle": "TA"}]}, "one of this node's muscles: SO"),
        ({"cadence_per_min": 5}, "at least 20"),
        ({"faults": [{"kind": "ham"}]}, "hum"),
        ({"faults": [{"kind": "hum", "size": 3}]}, "faults"),
    ],
)
def test_what_cannot_be_is_refused(given: dict[str, object], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        build(Treadmill, given).specs()


def test_every_known_muscle_is_simulated_by_default() -> None:
    assert WALK.specs()["emg"].channels == tuple(BURSTS) and len(BURSTS) == 13


def test_a_walk_in_real_time_is_live_and_another_waits_for_the_graph() -> None:
    assert Treadmill().live and not WALK.live and Treadmill(chunk_ms=20.0).chunk_s == 0.02
