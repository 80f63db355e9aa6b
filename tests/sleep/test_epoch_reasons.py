"""Why an epoch is awake: the reason that each scored epoch carries, from the scorer to the night's table, the page and the command."""

from __future__ import annotations

import csv
import json
from itertools import chain
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.reports.night import archive
from kinegraph.devices.reports.night.page import draw
from kinegraph.operators.sleep.scorer import EPOCH, REASONED, SleepScorer
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.engine.replay import Digest
from kinegraph.stream.errors import KinegraphError
from tests.sleep.sleep_data import epochs_of, final, run
from tests.support.command_line import Command, kinegraph
from tests.support.night_made import BED, EVENING, SEEN, SPECS, STEP, Night, event, feed, opened

__all__ = ["kinegraph"]

MOTION = StreamSpec((1,), rate_hz=1 / 30, units=("mm",))
REASON_SPECS = {**SPECS, "epochs": StreamSpec((), REASONED, meta=SPECS["epochs"].meta)}


def scored(activity: np.ndarray, **more: object) -> np.ndarray:
    n = len(activity)
    chunk = Chunk(np.arange(n) * 30 * NS, np.asarray(activity, float)[:, None], (n - 1) * 30 * NS)
    return final(run(SleepScorer(**more), MOTION, chunk)[1])  # type: ignore[arg-type]


def test_an_epoch_names_the_movement_that_adds_most_its_weight_and_what_it_adds() -> None:
    activity = np.zeros(60)
    activity[[30, 31, 32]] = 0.2
    epochs = scored(activity)
    bell = np.exp(-0.5 * (np.arange(-10, 4) / 2.0) ** 2)
    bell /= bell.sum()
    assert epochs["state"][31] == "wake" and epochs["cause"][31] == "movement"
    assert epochs["mover"][31] == 31 * 30 * NS and epochs["weight"][31] == pytest.approx(bell[10])
    assert epochs["adds"][31] == pytest.approx(bell[10], abs=1e-12)
    assert (epochs["cause"][35], epochs["mover"][35]) == ("still", 32 * 30 * NS), "asleep, though 32 moved"
    assert (epochs["cause"][50], epochs["mover"][50], epochs["rule"][50]) == ("still", 0, "")


def test_unknown_epochs_say_whether_they_or_their_neighbours_were_not_seen() -> None:
    activity = np.zeros(60)
    activity[20:33] = np.nan
    activity[28] = 0.0
    epochs = scored(activity, min_seen=0.6)
    assert epochs["cause"][25] == "unseen" and epochs["cause"][28] == "gaps" and epochs["cause"][40] == "still"
    assert (epochs["state"][epochs["cause"] == "gaps"] == "unknown").all()


def test_a_rescored_epoch_names_the_rule_and_its_score_stays() -> None:
    activity = np.zeros(120)
    activity[20:60] = 0.5
    epochs, plain = scored(activity, rescore=True), scored(activity)
    changed = epochs["rescored"]
    assert changed.any() and (epochs["cause"][changed] == "rescored").all()
    assert set(epochs["rule"][changed]) == {"after 4 min", "after 10 min", "after 15 min"}
    assert (epochs["score"] == plain["score"]).all() and (epochs["rule"][~changed] == "").all()


@pytest.mark.parametrize("method", ["oakley", "cole_kripke_actilife", "scripps", "sadeh"])
def test_what_a_movement_adds_is_what_the_score_would_lose_without_it(method: str) -> None:
    rng = np.random.default_rng(4)
    epoch_s = 30.0 if method in ("oakley", "scripps") else 60.0
    device = {"cole_kripke_actilife": "actigraph", "sadeh": "ami"}.get(method, "actiwatch")
    counts = np.where(rng.random(80) < 0.3, rng.integers(1, 400, 80), 0).astype(float)
    spec, chunk = epochs_of(counts, "2026-01-01T00:00:00", epoch_s, device)
    epochs = final(run(SleepScorer(method), spec, chunk)[1])  # type: ignore[arg-type]
    for k in range(20, 60, 7):
        mover = round((int(epochs["mover"][k]) - int(chunk.time[0])) / (epoch_s * NS))
        still = counts.copy()
        still[mover] = 0.0
        without = final(run(SleepScorer(method), *epochs_of(still, "2026-01-01T00:00:00", epoch_s, device))[1])  # type: ignore[arg-type]
        assert epochs["score"][k] - without["score"][k] == pytest.approx(epochs["adds"][k], rel=1e-9)
        assert (epochs["adds"][k] < 0) == (method == "sadeh")


def test_recordings_made_before_epochs_had_reasons_still_verify() -> None:
    rows = np.zeros(9, REASONED)
    rows["score"] = np.arange(9)
    old = np.zeros(9, EPOCH)
    old["score"] = np.arange(9)
    time = np.arange(9)
    now, before = Digest(fields=EPOCH.names or ()), Digest()
    now.add(Chunk(time, rows, 8))
    before.add(Chunk(time, old, 8))
    assert now.hexdigest() == before.hexdigest()


def night_with_reasons(root: Path) -> None:
    """Twenty minutes in bed; movement at epochs 20 to 22, after which 23 is awake by its neighbours."""
    log = opened(root, tuple(p for p in SPECS if p not in ("map", "lights", "view")), report=False)
    log.runtime.specs = {**log.runtime.specs, "epochs": REASON_SPECS["epochs"]}
    log.begin()
    for k in range(40):
        t = EVENING + k * STEP
        if k == 0:
            feed(log, iter([("bed", event(BED, t, t, "", "in"))]))
        moved = 6.0 if 20 <= k <= 22 else 0.0
        cause, why = ("unseen", "dark") if k == 30 else ("movement" if 20 <= k <= 23 else "still", "")
        state = {"unseen": "unknown", "movement": "wake"}.get(cause, "sleep")
        near = 20 <= k <= 26
        reason = (
            cause,
            EVENING + min(k, 22) * STEP if near else 0,
            0.1764 if near else np.nan,
            0.1764 if near else 0.0,
            "",
        )
        lines = [
            ("seen", event(SEEN, t, t, t + STEP, "", moved, 0.95, "in", np.nan, why)),
            ("epochs", event(REASONED, t, t, t + STEP, state, 0.4, moved / 30, True, False, *reason)),
        ]
        feed(log, iter(lines))
    log.close()


def test_the_table_of_a_night_holds_the_reason_and_the_command_explains_it(tmp_path: Path, kinegraph: Command) -> None:
    night_with_reasons(tmp_path / "nights")
    (folder,) = (tmp_path / "nights").glob("2025*")
    with (folder / "epochs.csv").open(newline="") as file:
        row = list(csv.DictReader(file))[23]
    assert (row["cause"], row["mover"], row["weight"], row["rule"]) == (
        "movement",
        "2025-12-31T22:11:00Z",
        "0.1764",
        "",
    )
    code, output, _ = kinegraph("sleep", "explain", "last", "23:11:40")
    assert code == 0 and "awake" in output and "23:11:00" in output and "6 s of 30 s" in output and "0.176" in output, (
        output
    )
    code, output, _ = kinegraph("sleep", "explain", folder.name, "23:11:40", "--json")
    facts = json.loads(output)
    assert (code, facts["state"], facts["cause"]) == (0, "wake", "movement")
    movement = {"onset": "2025-12-31T22:11:00Z", "activity": 0.2, "moved_s": 6.0, "bed": "in"}
    assert facts["movement"] == {**movement, "weight": 0.1764, "adds": 0.1764}
    assert facts["threshold"] == 0.3 and facts["score"] == 0.4 and facts["sentence"]
    _, output, _ = kinegraph("sleep", "explain", "last", "2025-12-31T22:15:10Z")
    assert "unknown" in output and "too dark" in output
    code, _, output = kinegraph("sleep", "explain", "last", "04:00")
    assert code == 2 and "23:00" in output and "23:20" in output, "it names what the night holds"
    code, _, output = kinegraph("sleep", "explain", "last", "quarter to nine")
    assert code == 2 and "23:15" in output


def test_the_report_gives_the_reason_of_every_time_awake(tmp_path: Path) -> None:
    night_with_reasons(tmp_path)
    (folder,) = tmp_path.glob("2025*")
    page = draw(folder).read_text()
    assert "Why awake" in page and "movement at 23:10:00 (6 s of 30 s) in this epoch" in page


def test_a_night_of_an_older_version_is_read_goes_on_and_is_explained_as_far_as_it_goes(
    tmp_path: Path, kinegraph: Command
) -> None:
    night, log = Night(), opened(tmp_path / "nights", report=False)
    log.begin()
    feed(log, night.chunks(0, 120))
    log.close()
    (folder,) = (tmp_path / "nights").glob("2025*")
    table = folder / archive.EPOCHS
    columns = table.read_text().partition("\n")[0].split(",")
    older = [i for i, name in enumerate(columns) if name not in ("cause", "mover", "weight", "adds", "rule")]
    lines = [line.split(",") for line in table.read_text().splitlines()]
    table.write_text("".join(",".join(cells[i] for i in older) + "\n" for cells in lines))
    again = opened(tmp_path / "nights", report=False)
    again.begin()
    feed(again, chain(night.chunks(120), night.end()))
    again.close()
    assert {line.count(",") for line in table.read_text().splitlines()} == {len(older) - 1}, (
        "the rest has the same columns"
    )
    assert len(archive.read_epochs(folder)) == night.n - night.inn
    code, output, _ = kinegraph("sleep", "explain", "last", "23:30")
    assert code == 0 and "before reasons were kept" in output


def test_a_night_that_is_not_there(tmp_path: Path, kinegraph: Command) -> None:
    (tmp_path / "nights").mkdir()
    code, _, output = kinegraph("sleep", "explain", "last", "23:30")
    assert code == 2 and "there is no night" in output
    with pytest.raises(KinegraphError):
        archive.find(tmp_path / "nights", "last")
