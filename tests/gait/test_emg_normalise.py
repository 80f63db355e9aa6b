"""Amplitude references: what a calibration finds, what the file holds, and what it is refused for."""

from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from kinegraph.operators.cycles.cycles import Cycles
from kinegraph.operators.cycles.statistics.ensemble import CycleEnsemble
from kinegraph.operators.cycles.statistics.operator import CycleStatistics
from kinegraph.operators.emg.amplitude_reference import AmplitudeReference, CalibrationError
from kinegraph.operators.emg.commands.calibrate import calibrate, envelope_of
from kinegraph.operators.emg.envelope import Envelope
from kinegraph.operators.emg.normalise import Normalise
from kinegraph.stream.chunk import FOREVER, Chunk, StreamSpec
from kinegraph.stream.errors import InputError, KinegraphError, ParameterError
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.recording import Recorder
from tests.support.emg_run import contacts, drive, enveloped, stamps, treadmill

NAMES = ("TA", "SO")


def emg(seconds=12.0, scale=(50.0, 20.0), seed=0):
    rng = np.random.default_rng(seed)
    n = int(seconds * 1000)
    phase = np.arange(n)[:, None] / 1000
    strength = 1 + np.sin(2 * np.pi * (phase + np.array([0.0, 0.4])))
    spec = StreamSpec((2,), rate_hz=1000.0, channels=NAMES, units=("uV",))
    return spec, stamps(n), rng.standard_normal((n, 2)) * strength * np.array(scale)


@pytest.fixture
def walked(tmp_path):
    """A recording of twelve seconds: treadmill.emg and a touch-down every second."""
    signal, touch = emg(), contacts(np.arange(1.0, 11.5))
    return recorded(tmp_path / "walk.mcap", {"treadmill.emg": signal, "treadmill.touchdown": touch})


def recorded(path, streams, session=None):
    with Recorder(path, {"session": session or {"subject": "S01"}}, RecordingOptions(), wait=True) as recorder:
        for sequence, (name, (spec, time, data)) in enumerate(streams.items()):
            recorder.write(
                recorder.add_stream(name, spec, "input"), Chunk(time, data, FOREVER), int(time[-1]), sequence
            )
    return path


def run(kind, recording, *options):
    import typer

    app = typer.Typer()
    app.command()(calibrate)
    result = CliRunner().invoke(app, [kind, str(recording), *options])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


def test_a_recorded_subject_names_no_other_folder(tmp_path, monkeypatch):
    here = tmp_path / "here"
    here.mkdir()
    (tmp_path / "there").mkdir()
    monkeypatch.chdir(here)
    spec, time, data = emg()
    run("mvc", recorded(here / "walk.mcap", {"treadmill.emg": (spec, time, data)}, {"subject": "../there/S01"}))
    assert sorted(path.name for path in here.iterdir()) == ["_there_S01.mvc.json", "walk.mcap"]
    assert not any((tmp_path / "there").iterdir())


def test_mvc_is_the_highest_half_second(walked, tmp_path):
    run("mvc", walked, "-o", str(tmp_path / "mvc.json"))
    found = AmplitudeReference.read(tmp_path / "mvc.json")
    spec, time, envelope = enveloped(emg())
    settled = envelope[time >= time[0] + round(spec.settling_s * 1e9)]
    expected = [max(settled[k : k + 60, c].mean() for k in range(len(settled) - 59)) for c in range(2)]
    np.testing.assert_allclose(found.values["mvc"], expected, rtol=1e-12)
    assert (found.subject, found.unit, found.channels, found.source) == ("S01", "uV", ["TA", "SO"], "walk.mcap")
    assert found.envelope == spec.meta["envelope"]


def test_rest_is_the_mean_and_the_baseline_noise(walked, tmp_path):
    output = run("rest", walked, "-o", str(tmp_path / "rest.json"))
    found = AmplitudeReference.read(tmp_path / "rest.json")
    spec, time, envelope = enveloped(emg())
    np.testing.assert_allclose(
        found.values["rest"], envelope[time >= time[0] + round(spec.settling_s * 1e9)].mean(axis=0), rtol=1e-12
    )
    blocks = emg()[2].reshape(12, 10, 100, 2).std(axis=2).min(axis=1)
    np.testing.assert_allclose(found.noise, blocks.mean(axis=0), rtol=1e-12)
    assert "rest (µV)" in output and "noise (µV)" in output


def test_a_contraction_that_is_taken_again_leaves_out_what_came_before(tmp_path):
    spec, time, data = emg()
    data[2000:3000, 0] *= 20  # the cable was pulled
    data[2000:3000, 1] *= 20
    text = np.dtype([("onset", "<i8"), ("text", "U64")])
    note = (StreamSpec((), text, units=("ns", "")), time[4000:4001], np.array([(time[4000], "again TA")], text))
    path = recorded(tmp_path / "mvc.mcap", {"treadmill.emg": (spec, time, data), "annotations": note})
    run("mvc", path, "-o", str(tmp_path / "again.json"))
    tibialis, soleus = AmplitudeReference.read(tmp_path / "again.json").values["mvc"]
    assert tibialis < 200 and soleus > 200


@pytest.mark.parametrize("kind", ["rest", "mvc"])
def test_muscles_that_do_the_same_throughout_are_no_baseline_noise(tmp_path, kind):
    spec = StreamSpec((2,), rate_hz=1000.0, channels=NAMES, units=("uV",))
    noise = np.random.default_rng(0).standard_normal((8000, 2)) * 3.0
    steady = recorded(tmp_path / "steady.mcap", {"emg": (spec, stamps(8000), noise)})
    output = run(kind, steady, "-o", str(tmp_path / "made.json"))
    assert "good" in output and "doubtful" not in output


def test_task_is_peak_and_mean_of_the_mean_cycle(walked, tmp_path):
    run("task", walked, "-o", str(tmp_path / "task.json"))
    found = AmplitudeReference.read(tmp_path / "task.json")
    cycles = drive(Cycles(), {"signal": enveloped(emg()), "touchdown": contacts(np.arange(1.0, 11.5))})["cycles"][2]
    np.testing.assert_allclose(found.values["task_peak"], cycles.mean(axis=0).max(axis=0), rtol=1e-12)
    np.testing.assert_allclose(found.values["task_mean"], cycles.mean(axis=(0, 1)), rtol=1e-12)


def test_every_number_downstream_names_the_normalisation(walked, tmp_path):
    path = tmp_path / "task.json"
    run("task", walked, "-o", str(path))
    envelope = enveloped(emg())
    scaled = drive(Normalise("task_peak", str(path)), {"in": envelope})["out"]
    reference = np.array(AmplitudeReference.read(path).values["task_peak"])
    np.testing.assert_allclose(scaled[2], envelope[2] / reference * 100, rtol=1e-12)
    cycles = drive(Cycles(), {"signal": scaled, "touchdown": contacts(np.arange(1.0, 11.5))})
    both = {"closed": cycles["closed"], "cycles": cycles["cycles"]}
    statistics = drive(CycleStatistics(), both)["out"]
    ensemble = drive(CycleEnsemble(pairs=(("TA", "SO"),)), both)
    for spec, _, _ in (scaled, *cycles.values(), statistics, *ensemble.values()):
        assert spec.meta["normalisation"] == "task_peak"
        assert spec.meta["normalisation_reference"]["subject"] == "S01"
    assert statistics[0].unit_of("peak") == "% task peak"
    assert statistics[0].unit_of("integrated") == "% task peak s"
    assert ensemble["mean"][2][-1].max(axis=0) == pytest.approx([100, 100])
    assert len(ensemble["pairs"][2]) == len(cycles["cycles"][2])


def test_the_real_recording_gives_a_reference(tmp_path):
    streams = treadmill()
    path = recorded(tmp_path / "walk.mcap", {f"treadmill.{name}": stream for name, stream in streams.items()})
    run("task", path, "-o", str(tmp_path / "task.json"), "--subject", "TW12")
    found = AmplitudeReference.read(tmp_path / "task.json")
    inputs = {"signal": enveloped(streams["emg"]), "touchdown": streams["touchdown"]}
    np.testing.assert_allclose(
        found.values["task_peak"], drive(Cycles(), inputs)["cycles"][2].mean(axis=0).max(axis=0), rtol=1e-12
    )
    assert found.subject == "TW12"


def test_none_changes_nothing():
    spec, time, data = enveloped(emg())
    out = drive(Normalise(), {"in": (spec, time, data)})["out"]
    assert np.array_equal(out[2], data)
    assert out[0].units == ("uV",)
    assert out[0].meta["normalisation"] == "none"


def test_a_reference_for_something_else_is_refused(walked, tmp_path):
    path = tmp_path / "mvc.json"
    run("mvc", walked, "-o", str(path))
    spec = enveloped(emg())[0]
    normalise = Normalise("mvc", str(path))
    other = spec.derive(channels=("TA", "GM"))
    with pytest.raises(ParameterError, match="no muscle 'GM'"):
        normalise.unopened().open({"in": other})
    with pytest.raises(ParameterError, match="is in 'uV', channel 'TA' in 'mV'"):
        normalise.unopened().open({"in": spec.derive(units=("mV",))})
    with pytest.raises(ParameterError, match="these have cutoff_hz 6"):
        normalise.unopened().open({"in": enveloped(emg(), cutoff_hz=6.0)[0]})
    with pytest.raises(ParameterError, match="offers mvc, not 'rest'"):
        Normalise("rest", str(path)).open({"in": spec})
    with pytest.raises(InputError, match="normalised already"):
        normalise.unopened().open({"in": normalise.unopened().open({"in": spec})["out"]})
    with pytest.raises(ParameterError, match="the file that holds"):
        Normalise("mvc").open({"in": spec})
    assert normalise.unopened().open({"in": spec.derive(shape=(1,), channels=("SO",))})["out"].units == ("% MVC",)


def test_what_is_no_reference_is_refused(tmp_path):
    path = tmp_path / "x.json"
    with pytest.raises(CalibrationError, match="cannot be read"):
        AmplitudeReference.read(path)
    path.write_text("{")
    with pytest.raises(CalibrationError, match="not JSON"):
        AmplitudeReference.read(path)
    path.write_text("[]")
    with pytest.raises(CalibrationError, match="not an object"):
        AmplitudeReference.read(path)
    path.write_text("{}")
    with pytest.raises(CalibrationError, match="it must hold the format"):
        AmplitudeReference.read(path)
    good = AmplitudeReference("mvc", {"mvc": [1.0, 2.0]}, ["TA", "SO"], "uV", {})
    good.write(path)
    assert AmplitudeReference.read(path) == good
    record = json.loads(path.read_text())
    for field, value in (
        ("values", {"mvc": [1.0, "many"]}),
        ("values", {"mvc": [1.0]}),
        ("values", {"mvc": [1.0, 0.0]}),
        ("kind", 3),
    ):
        path.write_text(json.dumps({**record, field: value}))
        with pytest.raises(CalibrationError):
            AmplitudeReference.read(path)


def test_calibrate_says_what_is_wrong(walked, tmp_path):
    target = str(tmp_path / "a.json")
    run("mvc", walked, "-o", target)
    with pytest.raises(KinegraphError, match="exists; --overwrite"):
        run("mvc", walked, "-o", target)
    run("mvc", walked, "-o", target, "--overwrite")
    spec, time, data = emg()
    silent = data.copy()
    silent[:, 1] = 0.0
    path = recorded(tmp_path / "silent.mcap", {"a": (spec, time, silent)})
    with pytest.raises(KinegraphError, match="SO gives no reference"):
        run("mvc", path, "-o", str(tmp_path / "b.json"))
    with pytest.raises(KinegraphError, match="which stream holds the touch-downs"):
        run("task", path, "-o", str(tmp_path / "b.json"))
    two = recorded(tmp_path / "two.mcap", {"a": emg(), "b": emg()})
    with pytest.raises(KinegraphError, match="--emg"):
        run("rest", two, "-o", str(tmp_path / "b.json"))
    short = recorded(tmp_path / "short.mcap", {"a": (spec, time[:300], data[:300])})
    with pytest.raises(KinegraphError, match="too short"):
        run("mvc", short, "-o", str(tmp_path / "b.json"))


def test_the_envelope_is_the_graphs():
    graph = "nodes:\n  e:\n    use: operators.emg.Envelope\n    from: x\n    cutoff_hz: 6\n    worker: slow\n"
    assert envelope_of(graph, "graph") == Envelope(cutoff_hz=6)
    assert envelope_of("", "graph") == Envelope()
    both = graph + "  f:\n    use: operators.emg.Envelope\n    from: x\n"
    with pytest.raises(KinegraphError, match="e, f differ"):
        envelope_of(both, "graph")


NORMALISED = """
session: {subject: %s}
nodes:
  treadmill: {use: devices.people.treadmill.Treadmill, realtime: false, duration_s: 2}
  envelope: {use: operators.emg.Envelope, from: treadmill.emg}
  amplitude: {use: operators.emg.normalise.Normalise, from: envelope, method: mvc, reference: REFERENCE%s}
"""


def reference_of(subject, path, names):
    spec = StreamSpec((len(names),), rate_hz=1000.0, channels=names, units=("uV",))
    envelope = Envelope().open({"in": spec})["out"].meta["envelope"]
    AmplitudeReference("mvc", {"mvc": [50.0] * len(names)}, list(names), "uV", envelope, subject=subject).write(path)
    return path


def graph_of(subject, reference, more=""):
    from kinegraph.stream.graph.reading.load import load_text

    return load_text((NORMALISED % (subject, more)).replace("REFERENCE", str(reference)))


@pytest.fixture
def of_s01(tmp_path):
    from kinegraph.stream.graph.reading.load import load_text

    graph = load_text("nodes: {treadmill: {use: devices.people.treadmill.Treadmill}}")
    return reference_of("S01", tmp_path / "S01.mvc.json", graph.nodes["treadmill"].specs["emg"].channels)


@pytest.mark.parametrize("subject", ["S02", "102"])
def test_a_reference_of_somebody_else_is_refused_live(of_s01, subject):
    with pytest.raises(KinegraphError, match=rf"'amplitude'.*taken of 'S01'.*is of '{subject}'.*any_subject"):
        graph_of(subject, of_s01)


@pytest.mark.parametrize(
    ("subject", "more"), [("S01", ""), ("' s01 '", ""), ("''", ""), ("S02", ", any_subject: true")]
)
def test_the_same_person_an_unknown_one_and_one_that_is_forced_are_taken(of_s01, subject, more):
    assert graph_of(subject, of_s01, more).nodes["amplitude"].specs["out"].meta["normalisation"] == "mvc"


def test_a_replay_goes_by_the_subject_of_the_recording(of_s01, tmp_path):
    from kinegraph.stream.engine.replay import Replay
    from kinegraph.stream.graph.reading.load import load_text
    from kinegraph.stream.recording import Recording

    names = AmplitudeReference.read(of_s01).channels
    spec = StreamSpec((len(names),), rate_hz=1000.0, channels=tuple(names), units=("uV",))
    noise = np.random.default_rng(1).standard_normal((3000, len(names)))
    streams = {"treadmill.emg": (spec, stamps(3000), noise)}
    text = (NORMALISED % ("S01", "")).replace("REFERENCE", str(of_s01))
    for subject, refused in (("S02", True), ("S01", False)):
        path = recorded(tmp_path / f"{subject}.mcap", streams, {"subject": subject})
        with Recording.open(path) as recording:
            graph = load_text(text, recorded={n: s.spec for n, s in recording.streams.items()})
            graph.session = recording.header["session"]
            if refused:
                with pytest.raises(KinegraphError, match="taken of 'S01'"):
                    Replay(graph, recording)
            else:
                Replay(graph, recording).run()
