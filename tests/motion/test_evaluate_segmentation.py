"""The scorer against the figures known of the CMU-86 recordings, against segmentations made up for it, and as a command."""

import csv
import os
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from kinegraph.operators.segmentation.evaluation.as_in_thesis import thesis_scores, variances
from kinegraph.operators.segmentation.evaluation.found import ACTIVITY, Found, _events, merged, read_found, second_steps
from kinegraph.operators.segmentation.evaluation.picture import NEAREST, _matrix, distances
from kinegraph.operators.segmentation.evaluation.scores import boundary_f1, covering, intervals, score
from kinegraph.operators.segmentation.evaluation.truth import Truth, read_truth
from kinegraph.stream.chunk import NS, StreamSpec
from kinegraph.stream.cli import main as cli
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.operator import grid
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.series import Series, write_recording
from tests.support.command_line import succeeding
from tests.support.real import needs_data

DATA = Path(os.environ.get("KINEGRAPH_DATA", "/nowhere"))
NOTHING = np.empty(0)


def found(edges, primitives=None, transition=None, repetition=None, cluster=None):
    activities = np.stack([edges[:-1], edges[1:]], 1).astype(float)
    cuts = np.array(edges if primitives is None else primitives, float)
    spans = np.stack([cuts[:-1], cuts[1:]], 1)
    return Found(
        activities,
        np.array(transition or [False] * len(activities)),
        spans,
        np.array(cluster or [0] * len(spans)),
        np.array(repetition or range(1, len(spans) + 1)),
    )


def truth(rows, keys=()):
    start, end, label, count = zip(*rows, strict=True)
    return Truth(
        np.array(start, float), np.array(end, float), list(label), np.array(count, float), np.array(keys, float)
    )


@needs_data
def test_a_blind_cut_every_second_and_none_at_all_score_what_is_known():
    often, never = [], []
    for trial in ("01", "03", "07", "09", "11"):
        known = read_truth(DATA / "segmentation" / "cmu86_4ch" / f"86_{trial}.npz")
        with np.load(DATA / "segmentation" / "cmu86_4ch" / f"86_{trial}.npz") as archive:
            length, cuts = len(archive["label"]) / 120.0, archive["gt_120hz"][:-1, 1] / 120.0
        np.testing.assert_allclose(known.boundaries(), cuts, atol=1e-9)
        often.append(score(found(np.append(np.arange(0.0, length, 1.0), length)), known))
        never.append(score(found([0.0, length]), known))
    for scores, f1, strict, tolerant, covered in ((often, 0.23, 0.935, 0.961, 0.15), (never, 0.0, 0.375, 0.487, 0.14)):
        means = intervals(scores)
        assert means["f1"][0] == pytest.approx(f1, abs=0.005) and means["covering"][0] == pytest.approx(
            covered, abs=0.005
        )
        assert means["strict"][0] == pytest.approx(strict, abs=0.001)
        assert means["tolerant"][0] == pytest.approx(tolerant, abs=0.001)
        assert means["covering"][1] < means["covering"][0] < means["covering"][2]


def test_boundaries_are_matched_one_to_one():
    empty, one = np.empty(0), np.array([1.0])
    assert boundary_f1(empty, one) == boundary_f1(one, empty) == (0.0, 0.0, 0.0) and boundary_f1(empty, empty) == (
        1.0,
        1.0,
        1.0,
    )
    assert boundary_f1(np.array([10.0, 10.2, 30.0]), np.array([10.1, 20.0])) == pytest.approx((0.4, 1 / 3, 0.5))
    assert (
        boundary_f1(np.array([9.0]), np.array([10.0]))[0] == 1.0
        and boundary_f1(np.array([8.9]), np.array([10.0]))[0] == 0.0
    )
    assert boundary_f1(NOTHING, NOTHING)[0] == 1.0 and boundary_f1(NOTHING, np.array([1.0]))[0] == 0.0
    assert covering(np.array([5.0]), np.array([5.0]), 10.0) == 1.0 and covering(NOTHING, np.array([5.0]), 10.0) == 0.5


def test_transitions_count_in_their_middle_on_both_sides():
    known = truth([(0, 10, "walk", 8), (12, 20, "run", 9), (25, 30, "run", np.nan)])
    assert known.boundaries().tolist() == [11.0, 20.0, 25.0]
    made = found([0, 1, 10, 12, 20, 30], transition=[True, False, True, False, False])
    assert made.boundaries().tolist() == [11.0, 20.0]


@pytest.mark.parametrize(("rest_s", "expected"), [(3.0, [11.5]), (6.0, [10.0, 16.0])])
def test_a_rest_between_activities_counts_as_annotated_ones_do(rest_s, expected):
    made = found([0, 10, 20])
    made.activities[1] = 10.0 + rest_s, 20.0 + rest_s
    known = truth([(0, 10, "walk", 8), (10 + rest_s, 20 + rest_s, "run", 9)])
    assert made.boundaries().tolist() == known.boundaries().tolist() == expected


def test_repetitions_overlap_and_key_points():
    known = truth([(0, 8, "walk", 4), (10, 16, "hop", 5)], keys=[1.1, 2.9, 5.1, 6.9])
    made = found(
        [0, 8, 10, 16],
        [0, 2, 4, 6, 8, 10, 12, 14, 16],
        repetition=[1, 2, 3, 4, 0, 1, 2, 3],
        transition=[False, True, False],
    )
    scores = score(made, known)
    assert scores.repetitions == 1.0 and scores.within_1 == 0.5 and scores.count_error == pytest.approx(0.2)
    assert scores.distance_s == pytest.approx((2.0 + 0.0 + 0.0 + 2.0) / 4) and scores.overlap == pytest.approx(
        (2 / 8 + 2 / 6) / 2
    )
    assert scores.key_place == pytest.approx(0.5) and scores.key_sd == pytest.approx(0.05, abs=0.002)
    assert scores.strict == pytest.approx(1.0) and scores.f1 == 1.0


def test_clusters_take_the_number_they_were_merged_into():
    assert merged(np.array([5, 7, -1, 3]), [(7, 5), (5, 3)]).tolist() == [3, 3, -1, 3]


def test_distances_are_numpys():
    x = np.random.default_rng(0).normal(size=(30, 4)).astype(np.float32)
    np.testing.assert_allclose(distances(x), np.linalg.norm(x[:, None] - x[None], axis=2), atol=2e-3)


@pytest.mark.parametrize("radius", [0.9, 0.0])
def test_the_pictures_matrix_is_dark_where_frames_are_near(radius):
    """Every pixel is read off the two frames' distance; where no radius is known it is the one that NEAREST of all pairs lie within."""
    x = np.random.default_rng(2).normal(size=(25, 3))
    made = found([0, 24])
    made.features, made.time, axes = x, np.arange(25.0), Figure().subplots()
    _matrix(axes, made, radius, 24.0)
    pairs = [float(np.linalg.norm(a - b)) for i, a in enumerate(x) for b in x[i + 1 :]]
    near = radius or float(np.quantile(pairs, NEAREST))
    image = np.ma.filled(axes.images[0].get_array(), np.nan)
    for i, j in product(range(25), range(25)):
        shade = float(np.linalg.norm(x[i] - x[j])) / near
        expected = 1.0 - 0.85 * shade if shade <= 1.0 else np.nan
        assert image[i, j] == pytest.approx(expected, abs=3e-3, nan_ok=True)
    assert axes.images[0].get_extent() == [0.0, 24.0, 24.0, 0.0]


def recording(path):
    """A recording with segments of ten seconds at 30 Hz, as a graph leaves them."""
    times = grid(30.0, 300, start_ns=7 * NS)
    x = np.stack([np.sin(np.arange(300) * 0.4), np.cos(np.arange(300) * 0.4)], 1)
    rows = [
        (times[0], times[149], 0, True, False),
        (times[150], times[164], 1, False, True),
        (times[165], times[299], 2, True, False),
    ]
    activity = np.array(
        rows, [("onset", "<i8"), ("end", "<i8"), ("activity", "<i8"), ("repeats", "?"), ("transition", "?")]
    )
    cuts = [0, 50, 100, 150, 165, 232, 300]
    fields = [("onset", "<i8"), ("end", "<i8"), ("activity", "<i8"), ("repetition", "<i4"), ("cluster", "<i8")]
    parts = [
        (times[a], times[b - 1], 0, k, c)
        for (a, b), k, c in zip(pairwise(cuts), (1, 2, 3, 0, 1, 2), (0, 0, 0, -1, 4, 5), strict=True)
    ]
    primitive = np.array(parts, fields)
    merge = np.array([(5, 4)], [("cluster", "<i8"), ("into", "<i8")])
    radius = np.array([(0.2,)], [("radius", "<f8")])
    write_recording(
        path,
        [Series("stack", StreamSpec((2,), rate_hz=30.0), times, x)]
        + [
            Series(f"segment.{name}", StreamSpec((), data.dtype), np.full(len(data), times[-1]), data)
            for name, data in (("activity", activity), ("primitive", primitive), ("merge", merge), ("radius", radius))
        ],
        {},
    )
    return path


def test_two_steps_are_one_repetition():
    fields = [("activity", "<i8"), ("repetition", "<i4"), ("side", "<i4")]
    events = np.array([(0, 1, 1), (0, 1, 2), (0, 2, 0), (0, 3, 2), (0, 3, 1), (0, 0, 0), (1, 1, 1), (2, 1, 2)], fields)
    made = found([0, 80], primitives=np.arange(0, 90, 10), repetition=events["repetition"].tolist())
    assert len(made.repetitions()) == 7
    made.second = second_steps(events)
    assert made.second.tolist() == [False, True, False, False, True, False, False, False]
    assert made.repetitions().tolist() == [[0, 20], [20, 30], [30, 50], [60, 70], [70, 80]]
    assert second_steps(events[["activity", "repetition"]]) is None
    scores = score(made, truth([(0, 80, "walk", 5)], keys=(10.0, 40.0)))
    assert scores.repetitions == 0 and scores.key_place == pytest.approx(0.5)


def test_a_recording_is_read_in_seconds_from_its_start(tmp_path):
    made = read_found(recording(tmp_path / "walk.mcap"), features="stack")
    np.testing.assert_allclose(made.activities, [[0, 5], [5, 5.5], [5.5, 299 / 30]], atol=1e-8)
    assert made.boundaries() == pytest.approx([5.25]) and made.cluster.tolist() == [0, 0, 0, -1, 4, 4]
    assert made.features.shape == (300, 2) and made.radius == pytest.approx(0.2 * np.sqrt(2))
    with pytest.raises(KinegraphError, match="did you mean 'segment'"):
        read_found(tmp_path / "walk.mcap", node="segmnt")


@pytest.mark.parametrize("second", ["other.activity", "other"])
def test_of_two_segmentations_the_one_that_is_named_is_read(tmp_path, second):
    """A stream is a node's under its name and output, or under the node's name alone."""
    one, two = (np.zeros(1, [(f, "<i8") for f in ("onset", "end", "activity", "repeats")]) for _ in range(2))
    one["end"], two["end"] = 5 * NS, 7 * NS
    spec = StreamSpec((), one.dtype)
    path = tmp_path / "two"
    write_recording(
        path,
        [Series("segment.activity", spec, np.array([8 * NS]), one), Series(second, spec, np.array([8 * NS]), two)],
        {},
    )
    with Recording.open(path) as opened:
        assert (
            _events(opened, ACTIVITY, "segment")["end"] == 5 * NS
            and _events(opened, ACTIVITY, "other")["end"] == 7 * NS
        )
        with pytest.raises(KinegraphError, match="choose one with --node"):
            _events(opened, ACTIVITY, "")


def test_the_command_writes_table_and_pictures(tmp_path, capsys):
    recording(tmp_path / "walk.mcap")
    (tmp_path / "walk.csv").write_text("start_s,end_s,label,repetitions\n0,5,walk,3\n5,5.5,,\n5.5,10,run,2\n6,,,\n")
    (tmp_path / "other.csv").write_text(
        "start_s,end_s,activity,cluster,repetition\n0,2.5,0,1,1\n2.5,5,0,1,2\n5,10,1,2,1\n"
    )
    (tmp_path / "all.csv").write_text("result,truth,offset_s\nwalk.mcap,walk.csv,0\nother.csv,walk.csv,\n")
    arguments = ["--table", str(tmp_path / "all.csv"), "-o", str(tmp_path / "out")]
    with succeeding():
        cli.call("motion evaluate", arguments)
    assert "boundary F1" in capsys.readouterr().out
    with (tmp_path / "out" / "scores.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["recording"] for row in rows] == ["walk", "other"]
    assert [float(row["f1"]) for row in rows] == [1.0, 1.0]
    assert [float(row["repetitions"]) for row in rows] == [0.0, 1.0]
    assert (tmp_path / "out" / "walk.png").stat().st_size > 10_000
    with pytest.raises(KinegraphError, match="--overwrite replaces it"):
        cli.call("motion evaluate", arguments)
    with succeeding():
        cli.call(
            "motion evaluate",
            [
                str(tmp_path / "walk.mcap"),
                str(tmp_path / "walk.csv"),
                "--features",
                "stack",
                "-o",
                str(tmp_path / "one"),
            ],
        )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("start_s,end_s,label\n0,1,walk\n1,x,run\n", "line 3: start_s, end_s"),
        ("start_s,end_s,label\n0,1,walk\n3,2,run\n", "line 3: an action from 3 to 2 s is impossible"),
        ("start_s,end_s,label\n0,2,walk\n1,3,run\n", "actions overlap"),
        ("begin,end_s,label\n0,2,walk\n", "line 2: start_s, end_s"),
        ("start_s,end_s,label\n", "holds no annotations"),
        ("start_s,end_s,label\n0,5,\n", "holds no annotations"),
        ("start_s,end_s,label\nnan,,\n", "line 2: start_s is nan"),
        ("start_s,end_s,label,repetitions\n0,5,walk,-3\n", "line 2: -3 repetitions are impossible"),
    ],
)
def test_broken_annotations_are_named_by_their_line(tmp_path, text, message):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(KinegraphError, match=r"a\.csv: " + message):
        read_truth(tmp_path / "a.csv")


LABEL = np.repeat([0, -1, 1], 10)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"label": LABEL, "rate": 0.0}, "`rate` is 0.0; it must be a positive number of Hz"),
        ({"label": LABEL, "rate": np.zeros(2)}, "`rate` is"),
        ({"label": LABEL * 0.5, "rate": 30.0}, "`label` must be a row of whole numbers"),
        (
            {"label": LABEL, "rate": 30.0, "label_names": np.array(["walk"])},
            "`label` goes up to 1, but `label_names` holds 1",
        ),
        ({"label": LABEL, "t_us": np.arange(9)}, "must be of one length"),
        ({"label": LABEL, "t_us": np.full(30, np.nan)}, "`t_us` must be a row of times that grow"),
        ({"label": LABEL, "t_us": np.arange(30).clip(1)}, "`t_us` must be a row of times that grow"),
        ({"tag_frame": np.array([3, -4]), "rate": 30.0}, "`tag_frame` names frames that do not exist"),
        ({"label": np.full(30, -1), "rate": 30.0}, "holds no annotations"),
        ({"x": LABEL}, "there are other arrays"),
    ],
)
def test_archives_that_cannot_be_annotations_are_refused(tmp_path, arrays, message):
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(KinegraphError, match=r"a\.npz: .*" + message):
        read_truth(tmp_path / "a.npz")


def test_annotations_of_another_time_are_not_scored(tmp_path):
    made, annotated = recording(tmp_path / "walk.mcap"), tmp_path / "walk.csv"
    annotated.write_text("start_s,end_s,label\n100,105,walk\n")
    with pytest.raises(
        KinegraphError, match=r"walk\.csv: annotates 100 to 105 s, but the segments of .* end at 9\.967 s; --offset"
    ):
        cli.call("motion evaluate", [str(made), str(annotated)])
    with succeeding():
        cli.call("motion evaluate", [str(made), str(annotated), "--offset", "-100"])
    with pytest.raises(KinegraphError, match="--offset nan: must be a number of seconds"):
        cli.call("motion evaluate", [str(made), str(annotated), "--offset", "nan"])
    (tmp_path / "all.csv").write_text("result,truth,offset_s\nwalk.mcap,walk.csv,inf\n")
    with pytest.raises(KinegraphError, match=r"all\.csv: line 2: must name result and truth"):
        cli.call("motion evaluate", ["--table", str(tmp_path / "all.csv")])


@pytest.mark.parametrize("frame", [32, 36, 55, 95])
def test_a_boundary_exactly_the_tolerance_away_is_matched_whatever_rounding_makes_of_it(frame):
    early, late = np.array([frame / 30.0]), np.array([(frame + 30) / 30.0])
    assert late - early > 1.0
    assert boundary_f1(early, late)[0] == boundary_f1(late, early)[0] == 1.0
    assert boundary_f1(early, late + 0.001)[0] == 0.0


def test_the_thesiss_measures_judge_a_frame_by_its_cluster() -> None:
    """Cutting often does not help: of two clusters, one is mostly "walk"; a piece of "run" in it is wrong."""
    known = truth([(0, 10, "walk", np.nan), (12, 22, "run", np.nan)], keys=(1.0, 3.5))
    made = found(
        [0, 11, 22], primitives=[0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 22], cluster=[0, 0, 0, 0, 0, 1, 1, 1, 1, 0]
    )
    own = thesis_scores(made, known)
    assert own.strict == pytest.approx((10 + 6) / 22, abs=0.01), (
        "4 s of running lie in the walk's cluster, 2 s are a transition"
    )
    assert own.tolerant == pytest.approx((10 + 6 + 2) / 22, abs=0.01)
    assert own.matched == pytest.approx((10 + 6) / 22, abs=0.01)
    assert own.key_place == pytest.approx((0.5 + 0.75) / 2)
    blind = thesis_scores(found([0, 22], primitives=np.arange(0, 23), cluster=[0] * 22), known)
    assert blind.strict == pytest.approx(10 / 22, abs=0.01), "a cut every second in one cluster gains nothing"


def test_variance_in_clusters_is_that_of_equation_2_5() -> None:
    made = found([0, 4], cluster=[0, 0], primitives=[0, 2, 4])
    made.time, made.features = np.arange(8) / 2, np.array([[0.0], [1], [2], [3], [1], [2], [3], [4]])
    assert variances(made) == pytest.approx([naive_warped(made.features[:4], made.features[4:]) / 4])


def naive_warped(a, b):
    """Every warping path, by recursion."""

    def best(i, j):
        here = abs(float(a[i, 0] - b[j, 0]))
        if i == j == 0:
            return here
        ways = [best(k, m) for k, m in ((i - 1, j - 1), (i - 1, j), (i, j - 1)) if k >= 0 and m >= 0]
        return here + min(ways)

    return best(len(a) - 1, len(b) - 1)


def test_the_command_reports_as_in_the_thesis(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "found.csv").write_text(
        "start_s,end_s,activity,repetition,cluster\n0,2,1,1,0\n2,4,1,2,0\n4,6,2,1,1\n6,8,2,2,1\n"
    )
    (tmp_path / "true.csv").write_text("start_s,end_s,label\n0,4,walk\n4,8,run\n")
    with succeeding():
        cli.call("motion evaluate", [str(tmp_path / "found.csv"), str(tmp_path / "true.csv"), "--as-in-thesis"])
    text = capsys.readouterr().out
    assert "frames by cluster, strict" in text and "1.000" in text
