"""Steps of one inertial sensor: found in place, described alike live and at once, and classified by a forest with scikit-learn's bits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from kinegraph.operators.steps.classifier import SOME, StepClassifier, settles_after, some_model, wilson
from kinegraph.operators.steps.commands.enrolment import enrolment
from kinegraph.operators.steps.commands.recordings import grouped
from kinegraph.operators.steps.commands.train import steps as train_steps
from kinegraph.operators.steps.commands.validation import (
    Labelled,
    Trust,
    _thinned,
    forest,
    leave_out,
    trust,
    uncertain_below,
    weights,
)
from kinegraph.operators.steps.forest import Forest, StepModel
from kinegraph.operators.steps.step_kernel import chosen, describe, feature_names
from kinegraph.operators.steps.steps import Steps, some_walk
from kinegraph.stream.chunk import NS, Chunk
from kinegraph.stream.data.model_file import ModelError
from kinegraph.stream.errors import InputError, KinegraphError, ParameterError
from kinegraph.stream.recording.series import Series, write_recording
from tests.support.emg_run import drive

sklearn = pytest.importorskip("sklearn", reason="scikit-learn is not installed")


def found(given, operator=None, size=None):
    return drive(operator or Steps(), {"in": given}, size)["steps"]


def people(count=8, walks=2, per_walk=8, seed=1, visible=True):
    """Steps of made-up people of two kinds; `visible`: the kind shows in a feature, beside what is each person's own."""
    rng = np.random.default_rng(seed)
    rows, labels, persons, where = [], [], [], []
    for k in range(count):
        kind, own = ("a", "b")[k % 2], rng.normal(0, 1, 50)
        for walk in range(walks):
            x = own + rng.normal(0, 0.3, (per_walk, 50))
            x[:, 26:45] += 6.0 * (kind == "b") * visible
            rows.append(x)
            labels += [kind] * per_walk
            persons += [f"p{k}"] * per_walk
            where += [f"p{k} {walk}"] * per_walk
    return Labelled(np.concatenate(rows), np.array(labels), np.array(persons), np.array(where))


def test_steps_are_found_where_they_are_and_rest_and_turns_are_told_apart():
    spec, time, data = some_walk(20.0, 100.0, 6)
    _, stamps, rows = found((spec, time, data))
    walked = rows[rows["kind"] == "walk"]
    assert np.median(walked["duration_s"]) == pytest.approx(1 / 1.8, abs=0.02)
    assert 24 <= len(rows) <= 34 and (rows["kind"] == "turn").sum() >= 2
    assert rows["kind"][0] == "first" and (np.diff(rows["end"]) > 0).all()
    resting = (rows["end"] > 9.9 * NS + time[0]) & (rows["end"] < 11.3 * NS + time[0])
    assert not resting.any(), "a step while standing"
    assert (stamps >= rows["end"]).all() and np.median(stamps - rows["end"]) < 0.2 * NS


def test_features_are_what_they_say():
    rng = np.random.default_rng(2)
    window = rng.normal(0, 1, (55, 6)) + np.array([9.8, 0, 0, 0, 0, 0])
    out = np.empty(50)
    describe(window, 100.0, False, np.empty((6, 55)), out)
    made = dict(zip(feature_names("sensor"), out, strict=True))
    assert len(made) == 50 and len(chosen("acceleration")) == len(chosen("angular_velocity")) == 26
    for c, name in enumerate(("ax", "ay", "az", "gx", "gy", "gz")):
        x = window[:, c]
        spectrum = 2 * np.abs(np.fft.rfft(x - x.mean())) / 55
        counts = np.histogram(x, 16)[0] / 55
        slow = np.fft.rfftfreq(55, 0.01) <= 20.0
        expected = {
            "mean": x.mean(), "sd": x.std(), "least": x.min(), "most": x.max(), "rms": np.sqrt((x**2).mean()),
            "entropy": -(counts[counts > 0] * np.log(counts[counts > 0])).sum(), "energy": (x**2).sum() / 100,
            "amplitude": spectrum[slow].max(),
        }  # fmt: skip
        for what, value in expected.items():
            assert made[f"{name} {what}"] == pytest.approx(value, rel=1e-9), (name, what)


def test_a_known_distance_scales_the_length_and_leaves_the_feature():
    spec, time, data = some_walk(12.0, 100.0, 6)
    made = []
    for finder in (Steps(), Steps(length_factor=0.74)):
        finder.open({"in": spec})
        rows = finder.process("in", Chunk(time, data, int(time[-1]))).data
        made.append(rows[rows["kind"] == "walk"])
    usual, twice = made
    assert len(usual) > 5 and np.allclose(twice["length_m"], 2 * usual["length_m"], rtol=1e-12)
    assert np.allclose(usual["length_m"], 0.37 / 0.46 * usual["features"][:, 0], rtol=1e-12)
    assert (usual["features"] == twice["features"])[:, :26].all()


def test_features_by_gravity_do_not_depend_on_how_the_sensor_is_turned():
    spec, time, data = some_walk(12.0, 100.0, 6)
    turn = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    turned = np.concatenate([data[:, :3] @ turn, data[:, 3:] @ turn], 1)
    a, b = found((spec, time, data))[2], found((spec, time, turned))[2]
    np.testing.assert_allclose(a["features"], b["features"], rtol=1e-6, atol=1e-6)


def test_a_gap_begins_again_and_nan_is_left_out():
    spec, time, data = some_walk(20.0, 100.0, 6)
    keep = np.ones(len(time), bool)
    keep[1500:1560] = False
    rows = drive(Steps(), {"in": (spec, time[keep], data[keep], {1500: 60})})["steps"][2]
    assert (rows["kind"] == "first").sum() == 2, "the start, and after the gap"
    assert not ((rows["onset"] < time[1500]) & (rows["end"] > time[1560])).any()
    holes = data.copy()
    holes[300, 0] = np.nan
    holes[320, 4] = np.nan
    bad = found((spec, time, holes))[2]
    assert len(bad) == len(found((spec, time, data))[2]), "a sample less costs no step"
    assert np.isnan(bad["features"][bad["kind"] == "walk"]).any(axis=1).sum() == 1, "not known, and not made up"


def test_without_angular_velocity_its_features_are_not_known():
    rows = found(some_walk(14.0, 100.0, 3))[2]
    walked = rows[rows["kind"] == "walk"]
    assert (
        len(walked) > 5 and np.isfinite(walked["features"][:, :26]).all() and np.isnan(walked["features"][:, 26:]).all()
    )


@pytest.mark.parametrize("change", [{"rate_hz": None}, {"rate_hz": 25.0}, {"units": ("m",)}])
def test_what_is_no_inertial_sensor_is_refused(change):
    spec, time, data = some_walk(4.0, 100.0, 6)
    with pytest.raises(InputError):
        found((replace(spec, **change), time, data))


def test_a_shortest_step_is_shorter_than_the_longest_and_leaves_out_what_comes_sooner():
    given = some_walk(20.0, 100.0, 6)
    with pytest.raises(ParameterError, match="shortest_s"):
        found(given, Steps(shortest_s=0.8, longest_s=0.8))
    with pytest.raises(ParameterError, match="longest_s"):
        Steps(longest_s=3.1)
    assert Steps(longest_s=3.0).longest_s == 3.0
    rows = found(given, Steps(shortest_s=0.7))[2]
    assert np.nanmin(rows["duration_s"]) > 0.7, "at 1.8 steps a second every other one is left out"


def test_the_forest_has_scikit_learns_bits():
    given = people()
    trained = forest(20).fit(given.features, given.labels)
    flat = Forest.of(trained)
    ours = np.array([flat.probabilities(np.ascontiguousarray(row)) for row in given.features])
    assert ours.tobytes() == trained.predict_proba(given.features).tobytes()
    edge = np.ascontiguousarray(given.features[:1])
    edge[0, flat.feature[0]] = np.nextafter(flat.threshold[0], np.inf)
    assert flat.probabilities(edge[0]).tobytes() == trained.predict_proba(edge)[0].tobytes()


def test_what_shows_the_kind_is_better_than_guessing_and_what_shows_the_person_is_not():
    """With a random split both look good: that measures who walks."""
    kind, person = (trust(people(12, visible=t), "both", 10) for t in (True, False))
    assert kind.random > 0.9 and kind.subjects > 0.9 and kind.verdict == "better than guessing" and kind.voted == 12
    assert person.random > 0.9 and person.subjects < 0.75 and person.verdict == "not better than guessing"
    assert kind.low < 1.0 <= kind.high + 1e-9 and {c.name for c in kind.per_class} == {"a", "b"}


def test_nobody_of_the_training_is_in_the_test():
    given = people(count=4)
    seen = leave_out(given, [3], 5)
    assert seen.shape == (len(given.labels), 2) and (np.abs(seen.sum(axis=1) - 1) < 1e-9).all()


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda g: {"labels": np.full(len(g.labels), "a")}, "one class"),
        (lambda g: {"persons": np.where(g.persons == "p0", "p0", "p1")}, "people"),
        (
            lambda g: {"features": np.concatenate([g.features[:16], g.features[:16], g.features[32:]])},
            "one recording under two names",
        ),
        (lambda g: {"features": np.where(np.arange(50) == 30, np.nan, g.features)}, "angular velocity"),
    ],
    ids=["one class", "two people", "a duplicated subject", "a missing feature"],
)
def test_what_would_flatter_or_cannot_be_learned_is_refused(change, what):
    given = people()
    with pytest.raises(KinegraphError, match=what):
        replace(given, **change(given))


def test_every_class_counts_as_much_and_in_it_every_person():
    persons = np.repeat(["p", "q", "r"], [10, 30, 20])
    labels = np.where(persons == "r", "b", "a")
    made = weights(persons, labels)
    assert made.mean() == pytest.approx(1.0)
    shares = [made[persons == who].sum() for who in "pqr"]
    assert shares == pytest.approx([15.0, 15.0, 30.0])
    given = people(12)
    few = np.concatenate([np.flatnonzero(given.labels == "a"), np.flatnonzero(given.labels == "b")[::8]])
    uneven = Labelled(given.features[few], given.labels[few], given.persons[few], given.walks[few])
    rare = [leave_out(replace(uneven, alike=alike), [3], 20)[:, 1].mean() for alike in (False, True)]
    assert rare[1] > rare[0], "the rare class is not forgotten"


def test_the_threshold_is_the_least_that_left_out_people_bear():
    probability = np.array([[0.9, 0.1]] * 10 + [[0.6, 0.4]] * 10)
    assert uncertain_below(probability, np.array([True] * 10 + [False] * 10), 0.8) == pytest.approx(0.62)
    assert uncertain_below(probability, np.zeros(20, bool), 0.8) > 1.0


def test_enrolled_people_are_known_and_strangers_are_not():
    found = enrolment(people(count=6, walks=3), "both", 20)
    assert found.known > 0.9 and found.false_accept <= 0.3 and found.walks == found.strangers == 18
    with pytest.raises(KinegraphError, match="two recordings"):
        enrolment(people(count=4, walks=1), "both", 5)


def test_numbers_become_three_classes_of_as_many_people():
    labels = {f"r{k}": (f"p{k}", str(160 + k)) for k in range(12)}
    classes = [label for _, label in grouped(labels, "height").values()]
    assert sorted(classes.count(c) for c in set(classes)) == [4, 4, 4]
    assert grouped({"r": ("p", "f"), "s": ("q", "m")}, "gender")["r"] == ("p", "f")


def test_a_height_that_is_not_known_is_refused():
    """It would make all limits between classes NaN, and one class of almost everybody."""
    labels = {f"r{k}": (f"p{k}", "nan" if k == 3 else str(160 + k)) for k in range(12)}
    with pytest.raises(KinegraphError, match="height of p3 is nan"):
        grouped(labels, "height")


def test_the_permutation_test_keeps_everybody_and_no_more_than_forty_steps_of_each():
    given = people(count=6, walks=2, per_walk=30)
    thin = _thinned(given, 40)
    of_each = [int((thin.persons == p).sum()) for p in np.unique(given.persons)]
    assert of_each == [40] * 6 and all(
        len(np.unique(thin.walks[thin.persons == p])) == 2 for p in np.unique(thin.persons)
    )
    assert len(_thinned(given, 1000).labels) == len(given.labels)


def test_the_running_vote_settles_and_says_when():
    assert settles_after(10, 10, 10) == 4 and settles_after(5, 10, 10) == -1
    assert np.isnan(wilson(0, 0)).all()
    low, high = wilson(8, 10)
    assert 0.4 < low < 0.8 < high < 1.0
    steps = found(some_walk(16.0, 100.0, 6))
    rows = drive(StepClassifier(model=SOME), {"in": steps})["judgement"][2]
    walked = steps[2][steps[2]["kind"] == "walk"]
    model = some_model()
    expected = np.array([model.forest.probabilities(row) for row in walked["features"]])
    assert rows["probabilities"].tobytes() == expected.tobytes()
    assert (rows["told"][expected.max(axis=1) < 0.6] == "uncertain").all() and rows["steps"].tolist() == list(
        range(1, len(rows) + 1)
    )


def test_a_model_is_for_its_sensor_and_a_broken_one_is_none(tmp_path):
    given = people()
    made = StepModel(
        Forest.of(forest(10).fit(given.features, given.labels)),
        ["a", "b"],
        np.arange(50),
        {**some_model().header, "features": "both"},
    )
    made.write(tmp_path / "m.npz")
    again = StepModel.read(tmp_path / "m.npz")
    assert again.forest.share.tobytes() == made.forest.share.tobytes() and again.classes == ["a", "b"]
    for operator, rate in ((Steps(site="wrist"), 100.0), (Steps(axes="sensor"), 100.0), (Steps(), 60.0)):
        with pytest.raises(InputError, match="trained on"):
            drive(StepClassifier(model=str(tmp_path / "m.npz")), {"in": found(some_walk(6.0, rate, 6), operator)})
    with pytest.raises(InputError, match="angular velocity"):
        drive(StepClassifier(model=str(tmp_path / "m.npz")), {"in": found(some_walk(6.0, 100.0, 3))})
    made.forest.left[0] = 0
    made.write(tmp_path / "loop.npz")
    with pytest.raises(ModelError, match="trees are broken"):
        StepModel.read(tmp_path / "loop.npz")


def recorded(folder, names, rate_hz=100.0):
    for k, name in enumerate(names):
        spec, time, data = some_walk(12.0 + k, rate_hz, 6, seed=k)
        data[:, 1] += (k % 2) * 2.0 * np.sin(2 * np.pi * 3.6 * (time - time[0]) / NS)
        write_recording(folder / f"{name}.mcap", [Series("imu", spec, time, data)], {})
    return [folder / f"{name}.mcap" for name in names]


def train(labels, files, *more):
    import typer

    app = typer.Typer()
    app.command()(train_steps)
    return CliRunner().invoke(app, [str(a) for a in (labels, *files, "--target", "gender", *more)])


def test_the_command_trains_reports_and_writes(tmp_path):
    files = recorded(tmp_path, ["r0", "r1", "r2", "r3", "r4", "r5"])
    table = tmp_path / "labels.csv"
    table.write_text("recording,person,gender\n" + "".join(f"r{k}.mcap,p{k},{'fm'[k % 2]}\n" for k in range(6)))
    done = train(table, files, "-o", tmp_path / "g.npz", "--trees", "10")
    assert done.exit_code == 0, done.output
    model = StepModel.read(tmp_path / "g.npz")
    accuracy = model.header["accuracy"]
    assert {"random_split", "subject_wise", "majority", "chance"} == set(accuracy) and model.header["subjects"] == 6
    assert "subject-wise" in done.output and "majority" in done.output and "predictive value" in done.output
    steps = found(some_walk(12.0, 100.0, 6))
    spec = drive(StepClassifier(model=str(tmp_path / "g.npz")), {"in": steps})["judgement"][0]
    assert spec.meta["accuracy"] == accuracy and spec.meta["classes"] == ["f", "m"]


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("recording,person,gender\nr0,p0,f\nr9,p9,m\n", "r9"),
        ("recording,person,gender\nr0,p0,f\n", "r1"),
        ("recording,person\nr0,p0\n", "gender"),
        ("recording,person,gender\nr0,p0,f\nr0,p0,f\n", "twice"),
    ],
    ids=["labels without a recording", "a recording without a label", "no column", "twice"],
)
def test_labels_and_recordings_must_match(tmp_path, text, what):
    files = recorded(tmp_path, ["r0", "r1"])
    (tmp_path / "labels.csv").write_text(text)
    done = train(tmp_path / "labels.csv", files, "-o", tmp_path / "g.npz")
    assert done.exit_code and what in str(done.exception)


def test_enrolling_people_says_how_often_strangers_are_accepted_and_live_they_are_nobody(tmp_path):
    files = recorded(tmp_path, [f"r{k}" for k in range(8)])
    table = tmp_path / "labels.csv"
    table.write_text("recording,person\n" + "".join(f"r{k},p{k // 2}\n" for k in range(8)))
    done = train(table, files, "-o", tmp_path / "p.npz", "--trees", "10", "--target", "person")
    assert done.exit_code == 0, done.output
    assert "strangers taken for somebody" in done.output and "taken for a stranger or another" in done.output
    model = StepModel.read(tmp_path / "p.npz")
    assert model.classes == ["p0", "p1", "p2", "p3"]
    assert {"false_accept", "false_reject"} == set(model.header["open_set"])
    steps = found(some_walk(12.0, 100.0, 6))
    for threshold, decided in ((2.0, True), (0.0, False)):
        StepModel(model.forest, model.classes, model.features, {**model.header, "uncertain_below": threshold}).write(
            tmp_path / "open.npz"
        )
        rows = drive(StepClassifier(model=str(tmp_path / "open.npz")), {"in": steps})["judgement"][2]
        assert (rows["decided"][-1] == "nobody enrolled") == decided
        assert (rows["told"] == "nobody enrolled").all() == decided


def test_a_model_that_only_guesses_says_so_and_is_uncertain_at_every_step(tmp_path):
    files = recorded(tmp_path, [f"r{k}" for k in range(6)])
    table = tmp_path / "labels.csv"
    table.write_text("recording,person,gender\n" + "".join(f"r{k},p{k},{'ffmmfm'[k]}\n" for k in range(6)))
    done = train(table, files, "-o", tmp_path / "g.npz", "--trees", "10")
    assert done.exit_code == 0, done.output
    model = StepModel.read(tmp_path / "g.npz")
    assert model.header["verdict"] == "not better than guessing"
    assert "not better than guessing" in done.output and '"uncertain" at every step' in done.output
    rows = drive(StepClassifier(model=str(tmp_path / "g.npz")), {"in": found(some_walk(12.0, 100.0, 6))})["judgement"][
        2
    ]
    assert len(rows) and (rows["told"] == "uncertain").all() and (rows["decided"] == "uncertain").all()


@pytest.mark.parametrize(
    ("subjects", "chance", "better"), [(0.6, 0.05, True), (0.5, 0.01, False), (0.4, 0.01, False), (0.6, 0.06, False)]
)
def test_as_good_as_the_largest_class_is_not_better_than_guessing(subjects: float, chance: float, better: bool) -> None:
    trusted = Trust("all", 0.9, subjects, 0.5, subjects - 0.05, 3, 5, 0.2, 0.9, chance, [], np.zeros((0, 2)))
    assert (trusted.verdict == "better than guessing") == better
