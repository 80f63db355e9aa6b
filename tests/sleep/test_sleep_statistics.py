"""The numbers of a night: ActiLife's ten periods, Actiware's fourteen intervals, and what unknown epochs leave open."""

from __future__ import annotations

import csv
from datetime import datetime

import numpy as np
import pytest

import kinegraph.stream.domain.night
from kinegraph.operators.sleep.epochs import Epochs
from kinegraph.operators.sleep.periods import SleepPeriods
from kinegraph.operators.sleep.scorer import EPOCH, SleepScorer
from kinegraph.operators.sleep.statistics import SleepStatistics
from kinegraph.stream.chunk import FOREVER, NS, Array, Chunk, StreamSpec
from kinegraph.stream.domain.night import SLEEP, UNKNOWN, WAKE, night
from kinegraph.stream.errors import InputError, ParameterError
from tests.sleep.sleep_data import epochs_of, play, run, sleep_file, stamped
from tests.support.real import needs_data

pytestmark = pytest.mark.quick

MINUTE = 60 * NS
SETTINGS = {
    "Tudor-Locke Default": SleepPeriods(),
    "Tudor-Locke Custom1": SleepPeriods(5, 5, 20, 1440, 5),
    "Tudor-Locke Custom2": SleepPeriods(10, 12, 60, 1440, 20),
}


def scores(
    states: list[str] | Array, epoch_s: float = 60.0, start: int = 0, activity: Array | None = None
) -> tuple[StreamSpec, Array, Array]:
    """Final scores as a scorer gives them."""
    n = len(states)
    rows = np.zeros(n, EPOCH)
    rows["onset"] = start + (np.arange(n) * epoch_s * NS).astype(np.int64)
    rows["end"] = rows["onset"] + round(epoch_s * NS)
    rows["state"], rows["final"] = states, True
    rows["activity"] = np.where(rows["state"] == "wake", 90.0, 0.0) if activity is None else activity
    rows["activity"][rows["state"] == "unknown"] = np.nan
    units = ("ns", "ns", "", "", "counts", "", "")
    return StreamSpec((), EPOCH, units=units, meta={"epoch_s": epoch_s}), rows["onset"].copy(), rows


def test_what_ends_before_anything_was_scored_takes_no_promise_back() -> None:
    """A session that is stopped within its first half minute."""
    spec, _, rows = scores(["sleep"])
    made = SleepStatistics()
    made.open({"epochs": spec})
    promised = [
        made.process("epochs", Chunk(rows["onset"][:0], rows[:0], t)).until for t in (MINUTE, 2 * MINUTE, FOREVER)
    ]
    assert promised == [MINUTE, 2 * MINUTE, 2 * MINUTE]


def test_just_as_much_sleep_as_begins_a_period_begins_one() -> None:
    for asleep, begins in ((5, 0), (4, 5)):
        spec, _, rows = scores(["sleep"] * asleep + ["wake"] + ["sleep"] * 200 + ["wake"] * 10)
        made = SleepPeriods()
        made.open({"in": spec})
        made_night = made.process("in", Chunk(rows["onset"].copy(), rows, int(rows["end"][-1])))
        assert made_night.data["onset"].tolist() == [begins * MINUTE]


@needs_data
@pytest.mark.parametrize("name", SETTINGS)
def test_actilifes_sleep_periods_and_all_their_numbers(name: str) -> None:
    data = np.load(sleep_file("gt3x_day_actilife.npz"))
    spec, chunk = epochs_of(data["axis1"], str(data["t0"]), 60.0, "actigraph")
    out, stamps, events = stamped(SleepScorer("sadeh_actilife"), spec, chunk)
    spec, decided, periods = stamped(SETTINGS[name], out, Chunk(stamps, events, int(stamps[-1])))
    found = play(
        SleepStatistics("ActiLife"),
        epochs=(out, stamps, events),
        periods=(spec, decided, periods),
    )
    with sleep_file("gt3x_day_actilife_periods.csv").open() as file:
        wanted = [row for row in csv.DictReader(file) if row["period_algorithm"] == name]
    assert len(found) == len(wanted) > 0
    for row, truth in zip(found, wanted, strict=True):
        for field, column in (("onset", "in_bed_time"), ("end", "out_bed_time"), ("sleep_onset", "onset")):
            assert row[field] == np.datetime64(truth[column].rstrip("Z"), "ns").astype(np.int64)
        for field, column in (
            ("se", "efficiency"), ("sol", "latency"), ("tib", "duration"), ("tst", "total_sleep_time"), ("waso", "wake_after_onset"),
            ("awakenings", "nb_awakenings"), ("mean_awakening", "ave_awakening"), ("counts", "total_counts"),
            ("movement", "movement_index"), ("fragmentation", "fragmentation_index"), ("total_fragmentation", "sleep_fragmentation_index"),
        ):  # fmt: skip
            assert row[field] == pytest.approx(
                float(truth[column]), abs=10.0 ** -len(truth[column].partition(".")[2]) * 0.51
            ), field
        assert row["bed"] == "detected" and row["estimated"] and row["convention"] == "ActiLife"


@needs_data
def test_actiwares_rest_and_sleep_intervals() -> None:
    """The sleep intervals are found, not given: where they begin and end, and their minutes, shares and efficiency."""
    data = np.load(sleep_file("actiware_rpx_eng_30s.npz"))
    spec, chunk = epochs_of(data["activity"], str(data["t0"]), 30.0, "actiwatch")
    out, stamps, events = stamped(SleepScorer("oakley"), spec, chunk)
    with sleep_file("actiware_rpx_eng_intervals.csv").open() as file:
        rows = list(csv.DictReader(file))
    rests, sleeps = ([r for r in rows if r["interval"] == kind] for kind in ("REST", "SLEEP"))
    begins, ends = ([moment(r, edge) for r in rests] for edge in ("start", "end"))
    switched = np.array(sorted([*begins, *ends]))
    lights = (StreamSpec((1,)), switched, np.isin(switched, ends).astype(float)[:, None])
    found = play(SleepStatistics("Actiware"), epochs=(out, stamps, events), lights=lights)
    assert len(found) == len(rests) == len(sleeps) == 7
    for row, rest, sleep in zip(found, rests, sleeps, strict=True):
        assert (row["onset"], row["end"], row["tib"]) == (
            moment(rest, "start"),
            moment(rest, "end"),
            float(rest["duration_min"]),
        )
        assert (row["sleep_onset"], row["sleep_end"]) == (moment(sleep, "start"), moment(sleep, "end"))
        assert (row["tst"], row["waso"]) == (float(sleep["sleep_min"]), float(sleep["wake_min"]))
        assert row["se"] == pytest.approx(float(sleep["efficiency_pct"]), abs=0.0051)
        assert 100 * row["tst"] / (row["tst"] + row["waso"]) == pytest.approx(float(sleep["sleep_pct"]), abs=0.0051)
        assert row["bed"] == "lights" and not row["estimated"]
        inside = events[events["final"] & (events["onset"] >= row["onset"]) & (events["onset"] < row["end"])]["state"]
        assert ((inside == "sleep").sum() / 2, (inside == "wake").sum() / 2) == (
            float(rest["sleep_min"]),
            float(rest["wake_min"]),
        )


def moment(row: dict[str, str], edge: str) -> int:
    day = datetime.strptime(f"{row[f'{edge}_date']} {row[f'{edge}_time']}", "%d/%m/%Y %H:%M:%S")
    return int(np.datetime64(day, "ns").astype(np.int64))


def as_states(text: str) -> Array:
    return np.array(["?WS".index(c) for c in text], np.int8)


def test_aasm_by_hand() -> None:
    found = night(as_states("WWSSWSSSWWSSWW"), np.zeros(14), 0.5, "AASM")
    assert (found.tib, found.tst, found.sol, found.waso) == (7.0, 3.5, 1.0, 2.5)
    assert found.se == 50.0 and found.awakenings == 2 and found.longest_bout == 1.5
    assert (found.tst_low, found.tst_high, found.waso_low, found.waso_high) == (3.5, 3.5, 2.5, 2.5)


@pytest.mark.parametrize("seed", range(25))
def test_bounds_hold_whatever_the_unknown_epochs_were(seed: int) -> None:
    """Every way of filling the unknown epochs stays within the bounds, and the extremes of TST are reached."""
    rng = np.random.default_rng(seed)
    states = rng.choice([UNKNOWN, WAKE, SLEEP], 14, p=[0.25, 0.4, 0.35]).astype(np.int8)
    states[rng.integers(14)] = SLEEP
    made_night = night(states, np.zeros(14), 1.0, "AASM")
    places = np.flatnonzero(states == UNKNOWN)
    reached: dict[str, list[float]] = {name: [] for name in ("tst", "se", "waso", "sol")}
    for code in range(2 ** len(places)):
        filled = states.copy()
        filled[places] = [SLEEP if code >> k & 1 else WAKE for k in range(len(places))]
        truth = night(filled, np.zeros(14), 1.0, "AASM")
        for name, values in reached.items():
            values.append(getattr(truth, name))
    for name, values in reached.items():
        assert getattr(made_night, f"{name}_low") <= min(values) and max(values) <= getattr(
            made_night, f"{name}_high"
        ), name
    assert (made_night.tst_low, made_night.tst_high) == (min(reached["tst"]), max(reached["tst"]))
    assert made_night.tst == (states == SLEEP).sum() and made_night.unknown == len(places)


def test_nobody_said_when_the_lights_went_off() -> None:
    spec, time, rows = scores(["wake"] * 10 + ["sleep"] * 50)
    (row,) = play(SleepStatistics(), epochs=(spec, time, rows))
    assert row["bed"] == "recording" and row["estimated"] and (row["tib"], row["sol"], row["tst"]) == (60.0, 10.0, 50.0)


def test_a_schedule_in_a_time_zone_and_across_daylight_saving() -> None:
    """Berlin, the night of 2026-10-25, has an hour more: 23:00 to 07:00 are nine hours."""
    start = int(np.datetime64("2026-10-24T18:00", "ns").astype(np.int64))
    spec, time, rows = scores(["sleep"] * (60 * 40), start=start)
    found = play(SleepStatistics(schedule="23:00-07:00", timezone="Europe/Berlin"), epochs=(spec, time, rows))
    assert [row["tib"] for row in found] == [540.0, 480.0]
    assert found[0]["onset"] == int(np.datetime64("2026-10-24T21:00", "ns").astype(np.int64))
    assert not found[0]["estimated"] and found["estimated"][1] == (found[1]["end"] > rows["end"][-1])


def test_lights_that_never_come_on_again_end_with_the_recording() -> None:
    spec, time, rows = scores(["wake"] * 30 + ["sleep"] * 60)
    lights = (StreamSpec((), np.dtype([("on", "?")])), np.array([20 * MINUTE]), np.zeros(1, [("on", "?")]))
    (row,) = play(SleepStatistics(), epochs=(spec, time, rows), lights=lights)
    assert row["estimated"] and (row["tib"], row["sol"]) == (70.0, 10.0)


def test_epochs_that_never_came_are_unknown() -> None:
    spec, time, rows = scores(["sleep"] * 60)
    keep = np.r_[0:20, 30:60]
    (row,) = play(SleepStatistics(), epochs=(spec, time[keep], rows[keep]))
    assert (row["tib"], row["tst"], row["tst_high"], row["unknown"]) == (60.0, 50.0, 60.0, 10.0)
    assert (row["se"], row["se_high"], row["waso"], row["waso_high"]) == (pytest.approx(100 * 5 / 6), 100.0, 0.0, 10.0)


def test_what_cannot_be() -> None:
    spec = scores(["sleep"])[0]
    with pytest.raises(ParameterError, match="22:30-07:00"):
        SleepStatistics(schedule="22-7").open({"epochs": spec})
    with pytest.raises(ParameterError, match="time zone"):
        SleepStatistics(schedule="22:00-07:00", timezone="Berlin/Europe").open({"epochs": spec})
    with pytest.raises(ParameterError, match="both say"):
        SleepStatistics(schedule="22:00-07:00").open({"epochs": spec, "lights": StreamSpec((1,))})
    with pytest.raises(InputError, match="scored epochs"):
        SleepStatistics().open({"epochs": StreamSpec((1,), rate_hz=1.0)})


def test_epochs_lie_on_the_grid_of_sample_time_whenever_the_recording_begins() -> None:
    spec = StreamSpec((1,), rate_hz=10.0, units=("mm",))
    for late in (0.0, 7.3):
        time = round((1_767_225_600 + late) * NS) + np.arange(1200) * NS // 10
        _, rows = run(Epochs(30.0, "mean"), spec, Chunk(time, np.ones((1200, 1)), int(time[-1])))
        assert rows[1:4].ravel().tolist() == [1.0, 1.0, 1.0] and len(rows) == (4 if not late else 5)
    assert np.isnan(rows[-1]) or rows[-1] == 1.0


def test_an_epoch_of_which_too_little_was_seen_is_unknown() -> None:
    spec = StreamSpec((1,), rate_hz=10.0, units=("mm",))
    time = np.arange(900) * NS // 10
    keep = np.r_[0:300, 500:900]
    x = np.ones((900, 1))
    x[620:760] = np.nan
    _, rows = run(Epochs(30.0, "sum"), spec, Chunk(time[keep], x[keep], int(time[-1])))
    assert rows[0] == 300.0 and np.isnan(rows[1]) and rows[2] == 160.0


@pytest.mark.parametrize(("moving", "fragmentation"), [([1.0] * 8, 100.0), ([0.0] * 8, 0.0), ([1.0, 0.0] * 4, 150.0)])
def test_who_never_lies_still_has_no_short_stillness(moving: list[float], fragmentation: float) -> None:
    """In minutes: the share with movement, and that of stillnesses of a minute at most among all of them."""
    states = np.full(8, SLEEP, np.int8)
    given = kinegraph.stream.domain.night._indices(states, np.array(moving), 1.0, "AASM", 0, 8)
    assert given == (100 * sum(moving) / 8, fragmentation, fragmentation)


def test_no_more_nights_wait_for_their_scores_than_there_is_room_for() -> None:
    """The rows of the first sixteen come; the rest is passed over, and nothing ends."""
    spec, stamps, rows = scores(["sleep"] * 200)
    switched = np.arange(1, 41) * 4 * MINUTE
    lights = StreamSpec((1,))
    statistics = SleepStatistics("AASM")
    statistics.open({"epochs": spec, "lights": lights})
    off = (np.arange(40) % 2 == 1).astype(float)[:, None]
    first = statistics.process("lights", Chunk(switched, off, int(switched[-1])))
    found = statistics.process("epochs", Chunk(stamps, rows, int(rows["end"][-1])))
    assert len(first) == 0 and found.data["onset"].tolist() == switched[:32:2].tolist()
