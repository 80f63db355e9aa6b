"""Sessions compared and a stored reference of them: what is like what, what is refused, and the tables in both readings."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from scipy.cluster.hierarchy import linkage
from typer.testing import CliRunner

from kinegraph.operators.cycles.limb_cycles import LIMB_CLOSED
from kinegraph.operators.emg.commands.compare import compare
from kinegraph.operators.emg.commands.comparison import _band, compare_sessions, scatter, standardised
from kinegraph.operators.emg.commands.comparison_page import stretches
from kinegraph.operators.emg.commands.session_cycles import _leave_out, check_alike, joined, read_sessions
from kinegraph.operators.emg.commands.train_model import emg_model
from kinegraph.operators.emg.mixtures.emg_model import read_references
from kinegraph.operators.emg.mixtures.operator import PeakMixtures
from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.errors import InputError, KinegraphError
from kinegraph.stream.recording.series import Series, write_recording
from tests.gait.test_emg_drift import two_legs
from tests.gait.test_emg_mixtures_live import bursts

BAND = "its 95 % band at 40 %, low", "difference at 40 %", "its 95 % band at 40 %, high"


def session(path, inputs, **meta):
    """A recording of these cycles, as a session leaves it."""
    series = []
    for port, (spec, time, data) in inputs.items():
        series.append(Series(f"cycles.{port}", spec.derive(meta={**spec.meta, **meta}), time, data))
    write_recording(path, series, {"session": {"subject": path.stem}})
    return path


@pytest.fixture
def three(tmp_path):
    """Two of one kind, and one with its second burst 8 % later."""
    made = [bursts(20, seed=1), bursts(20, seed=2), bursts(20, centres=(10.0, 48.0, 99.0), seed=3)]
    return [session(tmp_path / f"{name}.mcap", inputs) for name, inputs in zip("abc", made, strict=True)]


def run(command, *arguments):
    import typer

    app = typer.Typer()
    app.command()(command)
    return CliRunner().invoke(app, [str(a) for a in arguments])


def test_like_is_near_and_unlike_is_far(three):
    found = compare_sessions([read_sessions(path)[0] for path in three], PeakMixtures(cycles=500))
    far = found.distances["TA"]
    assert far[0, 1] < far[0, 2] and far[0, 1] < far[1, 2] and np.allclose(np.diag(far), 0.0, atol=1e-12)
    assert found.features.shape == (3, 22) and found.cycles == [20, 20, 20]
    np.testing.assert_array_equal(found.linkage, linkage(standardised(found.features), "single"))


def test_mean_curves_that_differ_do_so_where_they_do(three):
    read = [read_sessions(path)[0] for path in three]
    same = compare_sessions(read[:2], PeakMixtures(cycles=500)).bands[0]
    other = compare_sessions([read[0], read[2]], PeakMixtures(cycles=500)).bands[0]
    assert len(same.places) < 10 and {36, 52} <= set(other.places) and 75 not in other.places


def test_a_muscle_of_which_one_session_knows_nothing_is_unknown_there_alone(tmp_path):
    made = [bursts(20, seed=seed) for seed in (1, 2)]
    spec, time, curves = made[1]["cycles"]
    made[1]["cycles"] = spec, time, np.where(np.arange(2) == 1, np.nan, curves)
    sessions = [session(tmp_path / f"{name}.mcap", inputs) for name, inputs in zip("ab", made, strict=True)]
    found = compare_sessions([read_sessions(path)[0] for path in sessions], PeakMixtures())
    for curves in (found.means, found.sds):
        assert np.isfinite(curves["TA"]).all()
        assert np.isfinite(curves["SO"][0]).all() and np.isnan(curves["SO"][1]).all()


def test_scatter_is_told_in_both_readings():
    curves = np.array([[3.0] * 100, [1.0] * 100, [2.0] * 100])
    assert scatter(curves, curves.mean(axis=0)) == pytest.approx((20 / 3, 40 / 9, np.sqrt(200.0), 20 / 3))


def test_what_was_not_made_alike_is_refused(tmp_path):
    a = read_sessions(session(tmp_path / "a.mcap", bursts(8), normalisation="mvc"))
    b = read_sessions(session(tmp_path / "b.mcap", bursts(8), normalisation="none"))
    with pytest.raises(KinegraphError, match="a and b cannot be compared: normalisation 'mvc' against 'none'"):
        check_alike(a + b)
    c = read_sessions(session(tmp_path / "c.mcap", bursts(8, names=("TA", "GM")), normalisation="mvc"))
    with pytest.raises(KinegraphError, match="TA, SO"):
        joined(a + c)


def test_the_command_writes_a_page_and_a_table(three, tmp_path):
    done = run(compare, *three, "-o", tmp_path / "out")
    assert done.exit_code == 0, done.output
    page = (tmp_path / "out" / "comparison.html").read_text()
    assert "20 cycles" in page and "Normalisation: none" in page and "data:image/png" in page
    with (tmp_path / "out" / "comparison.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {"divergence", "deviation, own mean", "eq_6_9, group mean"} <= {row["what"] for row in rows}
    value = {(row["what"], row["muscle"], row["session"]): float(row["value"]) for row in rows}
    read = [read_sessions(path)[0] for path in three]
    for one in read:
        column = one.curves[:, 40, one.muscles.index("TA")]
        assert value["mean at 40 %", "TA", one.label] == pytest.approx(column.mean())
        assert value["sd at 40 %", "TA", one.label] == pytest.approx(column.std(ddof=1))
    low, at, high = (value[what, "TA", "a"] for what in BAND)
    assert low < at < high and at == pytest.approx(value["mean at 40 %", "TA", "b"] - value["mean at 40 %", "TA", "a"])
    assert page.count("<svg") == len(read[0].muscles) and all(
        f">{name}</text>" in page for name in (*read[0].muscles, *"abc")
    )
    assert run(compare, *three, "-o", tmp_path / "out").exit_code, "files that exist are not replaced"
    assert run(compare, three[0], "-o", tmp_path / "alone").exit_code, "one alone has nothing to be compared with"
    assert run(compare, three[0], "--node", "left", "-o", tmp_path / "x").exit_code


def test_a_session_beside_itself_differs_nowhere(three, tmp_path):
    done = run(compare, three[0], three[0], "-o", tmp_path / "out")
    assert done.exit_code == 0 and "TA: divergence 0.000, means differ nowhere" in done.output


def test_a_stored_reference_is_for_its_muscles_and_its_normalisation(three, tmp_path):
    done = run(emg_model, *three[:2], "-o", tmp_path / "m.npz")
    assert done.exit_code == 0, done.output
    from kinegraph.operators.emg.mixtures.operator import PeakMixtures as Mixer

    def mixture(names=("TA", "SO"), **meta):
        inputs = bursts(2, names=names)
        spec = inputs["cycles"][0]
        specs = {
            **{port: given[0] for port, given in inputs.items()},
            "cycles": spec.derive(meta={**spec.meta, **meta}),
        }
        return Mixer().open(specs)["mixture"]

    found = read_references(tmp_path / "m.npz", mixture(("SO", "TA")), ["SO", "TA"])
    assert (found.modes == 3).all() and (found.limit > 0).all() and (found.cycles == 40).all()
    with pytest.raises(InputError, match="muscle 'GM'"):
        read_references(tmp_path / "m.npz", mixture(("TA", "GM")), ["TA", "GM"])
    with pytest.raises(InputError, match="normalisation"):
        read_references(tmp_path / "m.npz", mixture(normalisation="mvc"), ["TA", "SO"])
    with pytest.raises(InputError, match="envelope"):
        read_references(tmp_path / "m.npz", mixture(envelope={"cutoff_hz": 6}), ["TA", "SO"])


def test_places_are_told_as_stretches():
    assert stretches([3, 4, 5, 41]) == "3-5, 41" and stretches([]) == "nowhere"


def both_legs(path):
    """A recorded session of two legs, as operators.cycles.limb_cycles leaves it."""
    left, right, both = two_legs(20)
    _, stamps, rows = both["closed"]
    named = np.zeros(len(rows), LIMB_CLOSED)
    for name in rows.dtype.names:
        named[name] = rows[name]
    named["limb"] = np.where(rows["number"] % 2 == 1, "left", "right")
    both["closed"] = (StreamSpec((), LIMB_CLOSED, units=("",)), stamps, named)
    return left, right, session(path, both)


def test_two_legs_of_one_session_stand_beside_each_other_muscle_by_muscle(tmp_path):
    left, right, path = both_legs(tmp_path / "both.mcap")
    legs = read_sessions(path)
    assert [one.label for one in legs] == ["both left", "both right"]
    assert legs[0].muscles == ("TA", "SO") and legs[1].muscles == ("SO", "TA") and legs[1].channels == ("R_SO", "R_TA")
    for leg, alone in zip(legs, (left, right), strict=True):
        np.testing.assert_array_equal(leg.curves, alone["cycles"][2])
        assert len(leg.maxima) == len(alone["maxima"][2])
    assert [one.limb for one in read_sessions(path, "right")] == ["right"]
    done = run(compare, path, "-o", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert "TA: divergence" in done.output and "both left (20 cycles), both right (20 cycles)" in done.output
    assert run(emg_model, path, "-o", tmp_path / "both.npz").exit_code == 0
    with_file = PeakMixtures(cycles=500).open({port: one[0] for port, one in two_legs(4)[2].items()})["mixture"]
    made = read_references(tmp_path / "both.npz", with_file, ["L_TA", "L_SO", "R_SO", "R_TA"])
    assert (made.modes > 0).all() and made.cycles.tolist() == [20, 20, 20, 20], "each leg's own cycles"


def staged(path, scale):
    """A recorded session of two legs in two stages, of which the second is faster; `scale` holds each leg's size."""
    *_, both = two_legs(20)
    spec, stamps, curves = both["cycles"]
    for i, name in enumerate(spec.channels):
        curves[:, :, i] *= scale[name[0]]
    both["cycles"] = (spec, stamps, curves)
    _, when, rows = both["closed"]
    named = np.zeros(len(rows), [*LIMB_CLOSED.descr, ("stage", "<U32"), ("speed_m_s", "<f8")])
    for name in rows.dtype.names:
        named[name] = rows[name]
    named["limb"] = np.where(rows["number"] % 2 == 1, "left", "right")
    named["stage"] = np.where(np.arange(len(rows)) < 20, "slow", "fast")
    named["duration_s"] = np.where(named["stage"] == "fast", 0.9, 1.4)
    both["closed"] = (StreamSpec((), named.dtype, units=("",)), when, named)
    return session(path, both)


def test_each_leg_and_stage_is_compared_with_the_same_leg_and_stage_of_the_other_session(tmp_path):
    before = staged(tmp_path / "before.mcap", {"L": 1.0, "R": 2.0})
    after = staged(tmp_path / "after.mcap", {"L": 1.0, "R": 3.0})
    done = run(compare, before, after, "-o", tmp_path / "out")
    assert done.exit_code == 0, done.output
    output = done.output.replace("\n", " ")
    for name in ("TA left, slow", "TA left, fast", "SO left, slow"):
        assert f"{name}: divergence 0.000, means differ nowhere" in output, output
    assert "TA right, slow: divergence" in output and "TA right, slow: divergence 0.000" not in output
    with (tmp_path / "out" / "comparison.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["what"] == "difference at 30 %"]
    pairs = {(row["session"], row["other"]) for row in rows}
    assert pairs == {
        (f"before {leg} {stage}", f"after {leg} {stage}") for leg in ("left", "right") for stage in ("slow", "fast")
    }
    assert "may be the speed" not in output and "different speeds" not in output


def test_the_legs_of_one_recording_are_compared_stage_by_stage(tmp_path):
    path = staged(tmp_path / "one.mcap", {"L": 1.0, "R": 2.0})
    done = run(compare, path, "-o", tmp_path / "out")
    assert "TA slow: divergence" in done.output and "TA fast: divergence" in done.output, done.output


def test_what_cannot_be_paired_and_speeds_that_are_pooled_are_reported(tmp_path, three):
    legs = staged(tmp_path / "legs.mcap", {"L": 1.0, "R": 1.0})
    output = run(compare, three[0], legs, "-o", tmp_path / "out").output.replace("\n", " ")
    assert "no two have the same leg and stage" in output
    mixed = bursts(20, seed=4)
    mixed["closed"][2]["duration_s"][:10] = 2.3
    output = run(
        compare, three[0], session(tmp_path / "mixed.mcap", mixed), "-o", tmp_path / "out", "--overwrite"
    ).output
    assert "different speeds are in one mean" in output.replace("\n", " ")


def test_a_difference_is_shown_only_where_it_exceeds_its_interval_and_what_is_relevant():
    rng = np.random.default_rng(1)
    shape = 20 * np.exp(-(((np.arange(100) - 40) / 5) ** 2))
    before, after = (shape * size + 0.3 + off + 0.005 * rng.random((30, 100)) for size, off in ((1, 0), (1.5, 0.02)))
    silent = np.r_[0:15, 65:100]
    assert set(silent) <= set(_band("SO", before, after, 0.0).places), "they do differ, by 0.02 % MVC"
    places = set(_band("SO", before, after, 5.0).places)
    assert 40 in places and not places & set(silent.tolist())
    assert _band("SO", before, after, 50.0).places == []


def test_the_last_verdict_on_a_cycle_counts():
    judged = np.array(
        [(3, "SO", False), (3, "SO", True), (4, "TA", True), (4, "TA", False)],
        [("number", "i8"), ("name", "U8"), ("used", "?")],
    )
    curves = np.ones((2, 5, 2))
    _leave_out(judged, np.array([3, 4]), curves, StreamSpec((2,), channels=("TA", "SO")))
    assert np.isnan(curves).any(axis=1).tolist() == [[False, False], [True, False]]


def test_what_a_review_left_out_is_nan_in_its_cycle_and_muscle_alone():
    judged = np.array(
        [(3, "SO", False), (4, "SO", True), (3, "TA", False), (3, "XX", False), (9, "TA", False)],
        [("number", "i8"), ("name", "U8"), ("used", "?")],
    )
    curves = np.ones((3, 5, 2))
    _leave_out(judged, np.array([2, 3, 4]), curves, StreamSpec((2,), channels=("TA", "SO")))
    left = np.isnan(curves).all(axis=1)
    assert np.array_equal(left, [[False, False], [True, True], [False, False]])
    assert np.array_equal(np.isnan(curves).any(axis=1), left)
    _leave_out(judged[:1], np.array([2, 3, 4]), np.ones((3, 5, 1)), StreamSpec((1,), channels=("TA",)))
