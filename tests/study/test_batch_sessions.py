"""What a batch left is read as recordings are: the same samples, and the same from every command that takes sessions."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.operators.sleep.scorer import EPOCH
from kinegraph.stream.batch.jobs import Job
from kinegraph.stream.batch.manifest import JobEntry, Manifest
from kinegraph.stream.batch.parquet import ParquetTable
from kinegraph.stream.batch.sessions import matched, open_session, sessions_at
from kinegraph.stream.batch.work import Common, do
from kinegraph.stream.chunk import NS, Chunk, StreamSpec, grid
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.series import Series, write_recording
from kinegraph.stream.system.atomic_file import private_folder
from tests.avatar.test_steering import FACES, marked, walking
from tests.avatar.test_whole_pose import POSES, RATE, TREE
from tests.gait.test_emg_compare import bursts
from tests.gait.test_emg_compare import session as cycles_of
from tests.gait.test_steps import recorded
from tests.motion.test_evaluate_segmentation import recording as segments_of
from tests.support.command_line import Command, kinegraph, refused

__all__ = ["kinegraph"]

GRAPH = """
nodes:
  board: {use: devices.people.treadmill.Treadmill, realtime: false, duration_s: 4}
  smooth: {use: operators.filters.iir.Lowpass, from: board.emg, cutoff_hz: 6}
  active: {use: operators.filters.threshold.Threshold, from: smooth, channel: TA, level: 1}
record: [smooth, active.interval]
session: {subject: S01}
"""


def results_of(folder: Path, recordings: Iterable[Path], settings: Iterable[dict[str, float]] = ({},)) -> Path:
    """A batch's results with all streams of these recordings, as its workers leave them."""
    private_folder(folder)
    for path in recordings:
        for chosen in settings:
            job = Job(path, path.stem, chosen)
            tables = {}
            with Recording.open(path) as opened:
                facts = opened.header.get("session") or {}
                for name, stream in opened.streams.items():
                    tables[name] = f"{name}/recording={job.name}/{job.key}.parquet"
                    private_folder((folder / tables[name]).parent)
                    table = ParquetTable(folder / tables[name], stream.spec, {**facts, **chosen})
                    for chunk in opened.chunks(name):
                        table.add(chunk)
                    table.close()
                begin = opened.begin_of_inputs
            entry = JobEntry(job.key, job.name, chosen, "done", "", facts=facts, tables=tables, begin_ns=begin)
            Manifest(folder).save(entry)
    return folder


def test_what_a_job_gave_is_what_a_replay_gives(tmp_path: Path) -> None:
    (tmp_path / "graph.yaml").write_text(GRAPH)
    kg.run(kg.load(tmp_path / "graph.yaml"), tmp_path / "walk")
    (tmp_path / "out").mkdir()
    Common(GRAPH, "graph", str(tmp_path / "graph.yaml")).save(tmp_path / "out")
    assert do(tmp_path / "out", Job(tmp_path / "walk", "walks/walk", {"smooth.cutoff_hz": 5}))[1]
    replayed = kg.replay(kg.load(tmp_path / "graph.yaml", {"smooth.cutoff_hz": 5}), tmp_path / "walk")
    (path,) = sessions_at([tmp_path / "out"])
    with open_session(path) as session, Recording.open(tmp_path / "walk") as recording:
        assert session.name == "walk smooth.cutoff_hz=5" and session.header["session"] == {"subject": "S01"}
        assert session.begin_of_inputs == recording.begin_of_inputs
        for name in ("smooth", "active.interval"):
            assert session.stream(name).spec == replayed[name].spec
            time, data = session.read(name)
            assert time.tobytes() == replayed[name].time.tobytes() and len(time)
            assert data.tobytes() == np.ascontiguousarray(replayed[name].data).tobytes()
        part = session.series("smooth", 1.0, 2.0)
        assert 900 < len(part) <= 1000 and part.time[0] >= recording.begin_of_inputs + NS
        with pytest.raises(KinegraphError, match="there is no table of 'smoth'"):
            session.stream("smoth")


def test_gaps_texts_and_bytes_come_back(tmp_path: Path) -> None:
    spec = StreamSpec((2,), rate_hz=100.0)
    chunks = [Chunk(grid(100.0, 5), np.ones((5, 2)), 2 * NS), Chunk(grid(100.0, 4, 3 * NS), np.ones((4, 2)), 9 * NS, 7)]
    words = np.array([(1, "größer", b"ab")], [("n", "<i4"), ("u", "<U8"), ("s", "S4")])
    series = [Series.of_chunks("x", spec, chunks)]
    series.append(Series("words", StreamSpec((), words.dtype), np.array([NS]), words))
    write_recording(tmp_path / "a.mcap", series, {})
    results_of(tmp_path / "out", [tmp_path / "a.mcap"])
    with open_session(tmp_path / "out") as session:
        assert [(len(chunk), chunk.lost) for chunk in session.chunks("x")] == [(5, 0), (4, 7)]
        assert session.read("words")[1].tobytes() == words.tobytes()


def test_compare_and_the_emg_model_are_those_of_the_sessions(tmp_path: Path, kinegraph: Command) -> None:
    made = [cycles_of(tmp_path / f"{name}.mcap", bursts(20, seed=k)) for k, name in enumerate("ab")]
    results_of(tmp_path / "results", made)
    for given, out in ((made, "one"), ([tmp_path / "results"], "two")):
        assert kinegraph("emg", "compare", *given, "-o", out)[0] == 0
        assert kinegraph("emg", "train-model", *given, "-o", f"{out}.npz")[0] == 0
    assert Path("one/comparison.csv").read_bytes() == Path("two/comparison.csv").read_bytes()
    with np.load("one.npz") as one, np.load("two.npz") as two:
        assert one.files == two.files and all(one[n].tobytes() == two[n].tobytes() for n in one.files if n != "header")


def test_each_combination_of_settings_has_its_own_scores(tmp_path: Path, kinegraph: Command) -> None:
    made = [segments_of(tmp_path / f"{name}.mcap") for name in ("walk", "run")]
    (tmp_path / "walk.csv").write_text("start_s,end_s,label,repetitions\n0,5,walk,3\n5,5.5,,\n5.5,10,run,2\n6,,,\n")
    (tmp_path / "all.csv").write_text("result,truth,offset_s\nwalk,walk.csv,0\nrun,walk.csv,0\n")
    results_of(tmp_path / "results", made, ({"segment.radius": 1}, {"segment.radius": 2}))
    code, output, _ = kinegraph("motion", "evaluate", "results", "--table", "all.csv", "-o", "scores")
    assert code == 0 and output.count("2 recordings, segment.radius=") == 2
    sheet = Path("scores/scores.csv").read_text().splitlines()
    assert len(sheet) == 5 and {line.split(",")[0] for line in sheet[1:]} == {
        f"{name} segment.radius={value}" for name in ("walk", "run") for value in (1, 2)
    }
    kinegraph("motion", "evaluate", "walk.mcap", "walk.csv", "-o", "alone")
    alone = Path("alone/scores.csv").read_text().splitlines()[1].split(",")[1:]
    assert all(line.split(",")[1:] == alone for line in sheet[1:])
    refused(kinegraph("motion", "evaluate", "results", "walk.csv"), "2 recordings", "--table")
    (tmp_path / "bad.csv").write_text("result,truth\nwok,walk.csv\n")
    refused(kinegraph("motion", "evaluate", "results", "--table", "bad.csv"), "'wok'", "walk")


def test_nights_of_a_batch(tmp_path: Path, kinegraph: Command) -> None:
    rows = np.zeros(60, EPOCH)
    rows["onset"] = np.int64(1_700_000_000) * NS + np.arange(60) * 30 * NS
    rows["end"], rows["final"], rows["state"] = rows["onset"] + 30 * NS, True, ["wake"] * 10 + ["sleep"] * 50
    write_recording(tmp_path / "n.mcap", [Series("scorer", StreamSpec((), EPOCH), rows["end"].copy(), rows)], {})
    texts = [f"{np.datetime64(int(r['onset']), 'ns')}Z,{'W' if k < 12 else 'N2'}" for k, r in enumerate(rows)]
    (tmp_path / "psg.csv").write_text("\n".join(["time (UTC),state", *texts]))
    (tmp_path / "nights.csv").write_text("estimate,reference,person\nn,psg.csv,P1\n")
    results_of(tmp_path / "results", [tmp_path / "n.mcap"], ({"scorer.threshold": 1}, {"scorer.threshold": 2}))
    for given in (("psg.csv",), ("--nights", "nights.csv")):
        code, output, _ = kinegraph("sleep", "evaluate", "results", *given)
        assert code == 0 and output.count("0.833") == 2 and "scorer.threshold=2" in output
    refused(kinegraph("sleep", "evaluate", "results"), "REFERENCE")


@pytest.mark.nightly
def test_models_are_learned_from_a_batch(tmp_path: Path, kinegraph: Command) -> None:
    files, table = recorded(tmp_path, [f"r{k}" for k in range(6)]), tmp_path / "labels.csv"
    table.write_text("recording,person,gender\n" + "".join(f"r{k}.mcap,p{k},{'fm'[k % 2]}\n" for k in range(6)))
    results_of(tmp_path / "results", files)
    for given, out in ((files, "one"), ([tmp_path / "results"], "two")):
        output = kinegraph(
            "motion", "train", "steps", table, *given, "--target", "gender", "-o", f"{out}.npz", "--trees", "5"
        )
        assert output[0] == 0, output
    with np.load("one.npz") as one, np.load("two.npz") as two:
        assert all(one[n].tobytes() == two[n].tobytes() for n in one.files if n != "header")
    results_of(tmp_path / "twice", files, ({"a.b": 1}, {"a.b": 2}))
    refused(kinegraph("motion", "train", "steps", table, "twice", "--target", "gender", "-o", "x.npz"), "given twice")


def test_poses_and_meshes_are_learned_from_a_batch(tmp_path: Path, kinegraph: Command) -> None:
    write_recording(tmp_path / "poses.mcap", [Series("walk", TREE.spec(RATE), grid(RATE, len(POSES)), POSES)], {})
    for k in range(8):
        lines = [f"v {x} {y} {z}" for x, y, z in walking(k / 8)] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in FACES]
        (tmp_path / f"walk{k}.obj").write_text("\n".join(lines))
    kinegraph("files", "import", *sorted(tmp_path.glob("*.obj")), "--rate", 24, "-o", "mesh.mcap")
    Path("markers.yaml").write_text("markers: {" + ", ".join(f"{n}: {v}" for n, v in marked().items()) + "}\n")
    for kind, more in (("pose", ("--centres", 50)), ("steering", ("--markers", "markers.yaml"))):
        name = {"pose": "poses", "steering": "mesh"}[kind]
        results_of(tmp_path / kind, [tmp_path / f"{name}.mcap"])
        for given in (f"{name}.mcap", kind):
            output = kinegraph("motion", "train", kind, given, *more, "-o", f"{given}.npz")
            assert output[0] == 0, output
        with np.load(f"{name}.mcap.npz") as one, np.load(f"{kind}.npz") as two:
            assert all(one[n].tobytes() == two[n].tobytes() for n in one.files if n != "header")


def test_what_cannot_be_read_is_told(tmp_path: Path) -> None:
    results_of(tmp_path / "results", [segments_of(tmp_path / f"{name}.mcap") for name in ("a", "b")])
    with pytest.raises(KinegraphError, match="2 jobs"):
        open_session(tmp_path / "results")
    path = sessions_at([tmp_path / "results"])[0]
    assert [entry.name for _, entry, _ in matched(tmp_path / "results", {"elsewhere/a": 1})] == ["a"]
    with open_session(path) as session:
        table = tmp_path / "results" / session.entry.tables["stack"]
    table.write_bytes(b"PAR1 no table")
    with pytest.raises(KinegraphError, match="cannot be read"):
        open_session(path)
    record = json.loads(path.read_text())
    path.write_text(json.dumps({**record, "status": "failed", "error": "no such stream"}))
    with pytest.raises(KinegraphError, match="failed in the batch: no such stream"):
        open_session(path)
    assert len(sessions_at([tmp_path / "results", tmp_path / "a.mcap"])) == 2
