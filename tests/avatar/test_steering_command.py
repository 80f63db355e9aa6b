"""Training of a mesh by command: reports, parts, mistakes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.people.quadruped import marked, topology
from kinegraph.operators.steering.commands import report
from kinegraph.operators.steering.model.adapt import _ahead, _change
from kinegraph.operators.steering.model.choose import Method, choose
from kinegraph.operators.steering.model.fit import fit_steering
from kinegraph.operators.steering.model.marker_frame import _largest
from kinegraph.operators.steering.model.soft import faded
from kinegraph.operators.steering.model.stored import KIND, to_arrays
from kinegraph.operators.steering.operator import SteerMesh
from kinegraph.operators.steering.swapped_markers import ExchangedNames
from kinegraph.stream.chunk import Chunk, Samples, StreamSpec
from kinegraph.stream.cli import main as cli
from kinegraph.stream.data.model_file import read_model, write_model
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.operator import grid
from kinegraph.stream.recording.series import Series, write_recording
from tests.avatar.adapt_runs import AT, FACES, NAMES, REFERENCE, STRIDE, pacing, steered
from tests.quadruped_model import LIMBS
from tests.support.command_line import call_command, succeeding


def kinegraph(*arguments: object) -> None:
    with succeeding():
        call_command(*arguments)


def test_a_report_shows_parts_errors_and_modes(tmp_path: Path) -> None:
    write_recording(tmp_path / "mesh.mcap", [Series("mesh", topology().spec(24.0), grid(24.0, 24), STRIDE)], {})
    text = "markers: {" + ", ".join(f"{n}: {v}" for n, v in marked().items()) + "}\nreference: [withers, croup]\n"
    (tmp_path / "m.yaml").write_text(f"{text}limbs: [{', '.join(LIMBS)}]\n")
    files = (tmp_path / "mesh.mcap", "-o", tmp_path / "m.npz", "--markers", tmp_path / "m.yaml")
    kinegraph("motion", "train", "steering", *files, "--report", tmp_path / "m.html")
    page = (tmp_path / "m.html").read_text()
    assert page.count("<img") == 3 and "hoof_fl" in page
    reported = float(page.split("vertices are off by ")[1].split(" %")[0])
    rest = [f for f in range(24) if f % 4]
    made = fit_steering(STRIDE[rest], FACES, marked(), REFERENCE, LIMBS)(STRIDE[::4, AT], 432)
    off = 100 * np.linalg.norm(made - STRIDE[::4], axis=-1).mean() / np.linalg.norm(np.ptp(STRIDE[0], axis=0))
    assert reported == pytest.approx(off, abs=0.002)
    kept = (tmp_path / "m.html").stat().st_mtime_ns
    with pytest.raises(KinegraphError, match=r"m\.html: exists"):
        cli.call(
            "motion train steering",
            [*map(str, files), "-o", str(tmp_path / "n.npz"), "--report", str(tmp_path / "m.html")],
        )
    assert (tmp_path / "m.html").stat().st_mtime_ns == kept


def test_more_parts_than_colours_begin_with_the_first_colour_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = fit_steering(STRIDE, FACES, marked(), REFERENCE, LIMBS)
    one, mine = model.parts[0], np.arange(len(model.parts[0].vertices))
    parts = tuple(replace(one, weights=np.where(mine == k, 2.0, 0.5)) for k in range(22))
    shown: list[Samples] = []
    monkeypatch.setattr(report, "picture", lambda points, faces, colours: shown.append(colours) or "")
    report.write_report(
        tmp_path / "m.html", "m", replace(model, parts=parts), "parts", {}, STRIDE[:3], FACES, lambda _: model
    )
    colours = shown[0][one.vertices]
    assert np.array_equal(colours[20:22], colours[:2]) and len(np.unique(colours[:20], axis=0)) == 20


@pytest.mark.parametrize("changes, missing", [(_ahead, -1), (_change, 0)])
def test_the_change_that_no_frame_tells_is_that_beside_it(changes: Callable[[Samples], Samples], missing: int) -> None:
    assert changes(np.array([1.0])).tolist() == [0.0]
    for angles in ([1.0, 3.0], [1.0, 3.0, 4.0], [0.0, 1.0, 3.0, 6.0]):
        rows = list(np.diff(angles))
        rows.insert(missing % len(angles), rows[missing])
        assert changes(np.array(angles)).tolist() == rows


def test_the_command_takes_a_performer_and_says_what_is_wrong(tmp_path: Path) -> None:
    write_recording(tmp_path / "mesh.mcap", [Series("mesh", topology().spec(24.0), grid(24.0, 24), STRIDE)], {})
    marks = pacing(np.arange(60) / 30)
    spec = StreamSpec((len(NAMES), 3), rate_hz=30.0, channels=NAMES, units=("cm",))
    write_recording(tmp_path / "walk.mcap", [Series("walk", spec, grid(30.0, 60), 40.0 * marks)], {})
    text = "markers: {" + ", ".join(f"{n}: {v}" for n, v in marked().items()) + "}\nreference: [withers, croup]\n"
    (tmp_path / "m.yaml").write_text(f"{text}limbs: [{', '.join(LIMBS)}]\nheading: [croup, withers]\n")
    files = (tmp_path / "mesh.mcap", "-o", tmp_path / "m.npz", "--markers", tmp_path / "m.yaml")
    kinegraph("motion", "train", "steering", *files, "--performer", tmp_path / "walk.mcap")
    assert read_model(tmp_path / "m.npz", KIND).header["performer"] == "walk.mcap"
    kinegraph(
        "motion",
        "train",
        "steering",
        *files,
        "--performer",
        tmp_path / "walk.mcap",
        "--ranges",
        "graph",
        "--pairing",
        "swing",
        "--overwrite",
    )
    header = read_model(tmp_path / "m.npz", KIND).header
    assert (header["ranges"], header["pairing"]) == ("graph", "swing")
    kinegraph("motion", "train", "steering", *files, "--performer", tmp_path / "walk.mcap", "--overwrite")
    made = steered(tmp_path / "m.npz", 0.4 * marks)
    assert np.isfinite(made).all() and np.ptp(made[:, AT[0], 2]) > 0.1
    for more, why in (
        (("--performer", tmp_path / "mesh.mcap"), "no stream holds all markers"),
        (("--method", "strait"), "did you mean 'straight'|straight"),
        (("--method", "straight"), "limbs move by themselves"),
        (("--ranges", "graph"), "--ranges graph: only for a performer"),
        (("--pairing", "swing"), "--pairing swing: only for a performer"),
        (("--ranges", "graphs"), "did you mean 'graph'|graph"),
        (("--method", "local", "--performer", tmp_path / "walk.mcap"), "limbs move by themselves"),
    ):
        with pytest.raises(KinegraphError, match=why):
            cli.call("motion train steering", [str(a) for a in (*files, "--overwrite", *more)])
    (tmp_path / "m.yaml").write_text(text)
    for more in (("--performer", tmp_path / "walk.mcap"), ("--pose", "angles"), ("--regression", "linear")):
        with pytest.raises(KinegraphError, match="move with the markers that lie on them"):
            cli.call("motion train steering", [str(a) for a in (*files, "--overwrite", "--method", "local", *more)])
    (tmp_path / "m.yaml").write_text(f"{text}heading: [croup]\n")
    with pytest.raises(KinegraphError, match="two markers"):
        cli.call("motion train steering", [str(a) for a in (*files, "--overwrite")])


def test_the_limbs_of_a_performer_are_called_as_the_file_of_markers_says(tmp_path: Path) -> None:
    """The hind hooves are led by the performer's hands: as with one whose points bear the markers' names."""
    write_recording(tmp_path / "mesh.mcap", [Series("mesh", topology().spec(24.0), grid(24.0, 24), STRIDE)], {})
    called = {"hoof_hl": "LWRA", "hoof_hr": "RWRA", "hoof_fl": "LTOE"}
    marks = pacing(np.arange(60) / 30)
    for name, channels in (("own", NAMES), ("other", tuple(called.get(name, name) for name in NAMES))):
        spec = StreamSpec((len(NAMES), 3), rate_hz=30.0, channels=channels, units=("m",))
        write_recording(tmp_path / f"{name}.mcap", [Series("walk", spec, grid(30.0, 60), 0.4 * marks)], {})
    text = "markers: {" + ", ".join(f"{n}: {v}" for n, v in marked().items()) + "}\nreference: [withers, croup]\n"
    mapped = f"{text}limbs: [{', '.join(LIMBS)}]\nperformer: {{{', '.join(f'{a}: {b}' for a, b in called.items())}}}\n"
    (tmp_path / "own.yaml").write_text(f"{text}limbs: [{', '.join(LIMBS)}]\n")
    (tmp_path / "other.yaml").write_text(mapped)
    for name in ("own", "other"):
        kinegraph(
            "motion", "train", "steering", tmp_path / "mesh.mcap", "--markers", tmp_path / f"{name}.yaml", "-o", tmp_path / f"{name}.npz",
            "--performer", tmp_path / f"{name}.mcap",
        )  # fmt: skip
    own, other = (read_model(tmp_path / f"{name}.npz", KIND).arrays for name in ("own", "other"))
    assert set(own) == set(other) and all(np.array_equal(own[key], other[key]) for key in own)
    for wrong, why in (
        (
            mapped.replace("hoof_hl: LWRA", "hof_hl: LWRA"),
            "performer: there is no marker 'hof_hl'; did you mean 'hoof_hl'",
        ),
        (mapped.replace("LWRA", "LWRB"), "'LWRB': did you mean '.WRA'.*`performer:` in the file of markers"),
        (f"{text}performer: LTOE\n", "must be a mapping of markers"),
    ):
        (tmp_path / "wrong.yaml").write_text(wrong)
        with pytest.raises(KinegraphError, match=why):
            given = (tmp_path / "mesh.mcap", "--markers", tmp_path / "wrong.yaml", "-o", tmp_path / "x.npz")
            cli.call("motion train steering", [*map(str, given), "--performer", str(tmp_path / "other.mcap")])


def test_a_mesh_with_holes_in_several_pieces_is_steered_all_the_same() -> None:
    """Two walkers in one mesh, a third of the triangles missing: pieces that no edge joins are parts of their own."""
    both = np.concatenate([STRIDE, STRIDE + np.array([2.0, 0.0, 0.0])], axis=1)
    faces = np.concatenate([FACES, FACES + 432])[np.arange(2 * len(FACES)) % 3 > 0]
    model = fit_steering(both[::2], faces, marked(), REFERENCE, count=20)
    made = model(both[1::2, AT], 864)
    assert np.isfinite(made).all() and np.linalg.norm(made - both[1::2], axis=-1).mean() < 0.02


def test_markers_that_are_exchanged_are_far_from_the_training() -> None:
    operator = SteerMesh()
    operator.open({"in": StreamSpec((len(NAMES), 3), rate_hz=30.0, channels=NAMES, units=("m",))})
    marks = STRIDE[:, AT]
    swapped = marks[:, [1, 0, 2, 3, 5, 4]]
    rows = np.concatenate([marks, swapped]).reshape(48, -1)
    made = operator.process("in", Chunk(grid(30.0, 48), rows, 0))
    mesh, quality = (chunk.data for port, chunk in made if port != "names")
    assert np.isfinite(mesh).all() and 10 * quality[:24].max() < quality[24:].min()


@pytest.mark.parametrize("pair", [(0, 1), (2, 5), (1, 3)])
@pytest.mark.parametrize("way", ["parts", "local"])
def test_two_markers_that_bear_each_others_names_are_named_once_and_again_when_cured(
    pair: tuple[int, int], way: Method, tmp_path: Path
) -> None:
    model = choose(STRIDE[::2], FACES, marked(), REFERENCE, method=way)[0]
    write_model(tmp_path / "m.npz", KIND, *to_arrays(model, topology(), ()))
    order = np.arange(6)
    order[list(pair)] = pair[::-1]
    marks = STRIDE[np.arange(240) % 24][:, AT]
    marks[30:150] = marks[30:150][:, order]
    marks[50] = np.nan
    for size in (1, 240):
        operator = SteerMesh(model=tmp_path / "m.npz")
        operator.open({"in": StreamSpec((6, 3), rate_hz=30.0, channels=NAMES, units=("m",))})
        rows = []
        for begin in range(0, 240, size):
            chunk = Chunk(grid(30.0, 240)[begin : begin + size], marks[begin : begin + size].reshape(size, -1), 0)
            rows += [
                row for port, made in operator.process("in", chunk) if port == "names" for row in made.data.tolist()
            ]
        times = [int(grid(30.0, 240).searchsorted(row[0])) for row in rows]
        assert [row[1:] for row in rows] == [(what, NAMES[pair[0]], NAMES[pair[1]]) for what in ("exchanged", "cured")]
        assert 30 + 9 <= times[0] < 110 and 150 < times[1] <= 181


class ModelOfDistances:
    """Four markers; how far they are from the training with two of them exchanged is as given."""

    markers = ("a", "b", "c", "d")

    def __init__(self, left: dict[tuple[int, int], float]) -> None:
        self.left = left

    def outside(self, marks: Samples, enough: float = np.inf) -> float:
        one, other = np.flatnonzero(marks[0, :, 0] != np.arange(4))
        return self.left.get((int(one), int(other)), 1.0)


@pytest.mark.parametrize(("rival", "named"), [(0.1, ("c", "d")), (0.39, None), (0.9, ("a", "b"))])
def test_a_pair_is_held_against_all_others_and_none_is_named_where_two_are_alike(
    rival: float, named: tuple[str, str] | None
) -> None:
    model = ModelOfDistances({(0, 1): 0.4, (2, 3): rival})
    marks, names = np.repeat(np.arange(4.0)[:, None], 3, axis=1), ExchangedNames.empty()
    rows = [row for k in range(120) if (row := names.see(model, marks, 1.0, k))]  # type: ignore[arg-type]
    assert [row[1:] for row in rows] == ([("exchanged", *named)] if named else [])


def test_one_frame_is_too_few_to_learn_from(tmp_path: Path) -> None:
    write_recording(tmp_path / "one.mcap", [Series("mesh", topology().spec(24.0), grid(24.0, 1), STRIDE[:1])], {})
    (tmp_path / "m.yaml").write_text("markers: {a: 1}\n")
    with pytest.raises(KinegraphError, match="at least 2"):
        cli.call(
            "motion train steering", [str(tmp_path / "one.mcap"), "--markers", str(tmp_path / "m.yaml"), "-o", "x.npz"]
        )


def test_markers_pull_wholly_up_to_one_kernels_width_and_less_beyond() -> None:
    assert [faded(outside) for outside in (0.0, 1.0)] == [1.0, 1.0]
    assert faded(2.0) == pytest.approx(math.exp(-1.0)) and faded(3.0) == pytest.approx(math.exp(-2.0))


@pytest.mark.parametrize("seed", range(5))
def test_eigenvectors_are_numpys(seed: int) -> None:
    made = np.random.default_rng(seed).normal(size=(4, 4))
    given, vectors = made + made.T, np.empty((4, 4))
    turned = given.copy()
    _largest(turned, vectors)
    order = np.argsort(np.diag(turned))
    values, expected = np.linalg.eigh(given)
    assert np.allclose(np.diag(turned)[order], values, atol=1e-12)
    assert np.allclose(np.abs((vectors[:, order] * expected).sum(axis=0)), 1.0, atol=1e-12)
