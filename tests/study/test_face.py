"""The Python face: what is public, operators on arrays, graphs built by calls, run on arrays, recordings and simulated devices."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

import kinegraph as kg
from kinegraph import devices, operators
from kinegraph.operators import Cycles, Lowpass, Rectify, Threshold
from kinegraph.operators.body.network.blazepose import default_model
from kinegraph.stream.errors import GraphError, InputError, KinegraphError, ParameterError
from kinegraph.stream.graph.shipped import shipped
from kinegraph.stream.laws import Broken
from tests.public_names import HOUSE, PACKAGES, text_of
from tests.support.tiers import one_in_five

RNG = np.random.default_rng(12)
TWO = RNG.normal(size=(3000, 2))

PUBLIC = """BatchResults live Case Chunk Graph Input KinegraphError Operator Outlet Recording Results Series Source
StreamSpec __version__ kernel load param replay run try_"""


def low() -> kg.Graph:
    """Two channels, rectified and smoothed, and where the first is active."""
    graph = kg.Graph("low", session={"subject": "S01"})
    emg = graph.add("emg", kg.Input(channels=("TA", "SO"), rate_hz=1000, units=("uV",)))
    rectified = graph.add("rectified", Rectify(), emg)
    graph.add("smooth", Lowpass(cutoff_hz=6), rectified, record=True)
    graph.add("active", Threshold(level=0.8, channel="TA"), "smooth")
    graph.record("active.interval")
    return graph


# what is public ------------------------------------------------------------------------------------------------------


def test_what_is_public_is_listed() -> None:
    assert sorted(kg.__all__) == sorted(PUBLIC.split())
    for name in kg.__all__:
        assert getattr(kg, name) is not None
        assert name == "__version__" or name in dir(kg)
        assert re.search(rf"\b{name}\b", (HOUSE / "docs" / "use" / "python.md").read_text()), (
            f"docs/use/python.md does not show {name}"
        )
    with pytest.raises(AttributeError, match="no attribute 'Graf'"):
        kg.Graf  # type: ignore[attr-defined]  # noqa: B018


def test_what_type_checkers_see_is_what_is_offered() -> None:
    tree = ast.parse((HOUSE / "kinegraph" / "__init__.py").read_text(encoding="utf-8"))
    typed = {
        alias.asname or alias.name: f"{node.module}:{alias.name}"
        for branch in tree.body
        if isinstance(branch, ast.If)
        for node in branch.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    for name, place in typed.items():
        module, _, theirs = place.partition(":")
        assert getattr(kg, name) is getattr(sys.modules[module], theirs)
    assert {*typed, "__version__"} == {*kg.__all__}


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_offers_all_its_parts_by_short_names(package: str) -> None:
    written = (HOUSE / package / "__init__.py").read_text(encoding="utf-8")
    assert ast.dump(ast.parse(written)) == ast.dump(ast.parse(text_of(package))), "run: python -m tests.public_names"
    module = {"operators": operators, "devices": devices}[package]
    for name in module.__all__:
        assert getattr(module, name).__name__ == name


def test_short_names_import_nothing_before_they_are_asked_for() -> None:
    heavy = ("numba", "scipy", "pandas", "pydantic")
    code = f"import sys, kinegraph.operators, kinegraph.devices; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


# operators on arrays ---------------------------------------------------------------------------------------------------


def test_an_operator_on_an_array() -> None:
    expected = sosfilt(butter(4, 6, fs=1000, output="sos"), TWO, axis=0)
    np.testing.assert_array_equal(Lowpass(cutoff_hz=6)(TWO, rate_hz=1000), expected)
    np.testing.assert_array_equal(Lowpass(cutoff_hz=6)(TWO[:, 0], rate_hz=1000), expected[:, 0])
    np.testing.assert_array_equal(Lowpass(cutoff_hz=6)(list(TWO[:, 0]), rate_hz=1000), expected[:, 0])


def test_an_operator_with_several_outputs_gives_them_by_name() -> None:
    found = Threshold(level=1.0)(TWO[:, 0], rate_hz=100)
    assert set(found) == {"onset", "interval"}
    assert len(found["interval"]) > 10
    assert found["interval"].dtype.names == ("onset", "end", "peak")


def test_a_hole_in_the_stamps_is_a_gap() -> None:
    time = np.arange(3000) * 1_000_000
    time[1500:] += 10_000_000_000
    found = Lowpass(cutoff_hz=6)(TWO, rate_hz=1000, time=time)
    np.testing.assert_array_equal(found[1500:], Lowpass(cutoff_hz=6)(TWO[1500:], rate_hz=1000))


@pytest.mark.parametrize(
    ("call", "error", "complaint"),
    [
        (lambda: Lowpass(cutoff_hz=-5), ParameterError, "cutoff_hz is -5; it must be above 0"),
        (lambda: Lowpass("abc"), ParameterError, "cutoff_hz is 'abc'; it must be a number"),  # type: ignore[arg-type]
        (lambda: Lowpass(6)(TWO), KinegraphError, "Give rate_hz=1000"),
        (lambda: Lowpass(6)(TWO, rate_hz=10), ParameterError, "cutoff_hz is 6.0; it must be below 5"),
        (lambda: Lowpass(6)(["a"], rate_hz=10), InputError, "it must be an array"),
        (lambda: Lowpass(6)(TWO, rate_hz=1000, time=np.arange(3000) / 1e3), InputError, "multiply seconds by 1e9"),
        (lambda: Lowpass(6)(TWO, rate_hz=1000, time=np.arange(3)), KinegraphError, "3 stamps for 3000 samples"),
        (lambda: Lowpass(6)(TWO[:2], rate_hz=1000, time=[2, 1]), KinegraphError, "time runs backwards at sample 1"),
        (lambda: Cycles()(TWO, rate_hz=1000), KinegraphError, "put it into a kinegraph.Graph"),
    ],
)
def test_what_cannot_be_is_refused_where_it_is_given(
    call: Callable[[], Any], error: type[Exception], complaint: str
) -> None:
    with pytest.raises(error, match=re.escape(complaint)):
        call()


def test_float_stamps_are_refused_in_a_case_too() -> None:
    spec = kg.StreamSpec((2,), rate_hz=1000.0)
    with pytest.raises(InputError, match="multiply seconds by 1e9"):
        kg.Case(Rectify(), {"in": (spec, np.arange(3000) / 1e3, TWO)})


# graphs ----------------------------------------------------------------------------------------------------------------


def test_what_python_builds_is_what_yaml_builds() -> None:
    built = low()
    read = kg.Graph.from_yaml(built.to_yaml())
    assert read.specs == built.specs
    assert read.nodes == built.nodes
    assert read.check().record == built.check().record
    assert read.check().session == {"subject": "S01"}


@pytest.mark.parametrize("name", one_in_five(sorted(shipped())))
def test_a_graph_written_as_python_is_the_same_graph(name: str) -> None:
    if name == "body_markers":
        pytest.importorskip("ai_edge_litert", reason="LiteRT is not installed (extra pose)")
        if not default_model().exists():
            pytest.skip("the pose network was not fetched (kinegraph files fetch pose-model)")
    graph = kg.load(name)
    made: dict[str, Any] = {}
    exec(graph.to_python(), made)
    again = made["graph"]
    assert (again.name, again.specs, again.nodes) == (graph.name, graph.specs, graph.nodes)
    first, second = graph.check(), again.check()
    for node, other in zip(first.nodes.values(), second.nodes.values(), strict=True):
        assert (node.name, node.inputs, node.options) == (other.name, other.inputs, other.options)
    assert (first.record, first.session, first.recording) == (second.record, second.session, second.recording)
    assert first.latency_budget_ms == second.latency_budget_ms


def test_two_classes_of_one_name_are_imported_under_two(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    copy = "from kinegraph.operators.filters import iir\n\n\nclass Lowpass(iir.Lowpass):\n    __slots__ = ()\n"
    (tmp_path / "another_lowpass.py").write_text(copy, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    from another_lowpass import Lowpass as Another  # type: ignore[import-not-found]

    graph = kg.Graph("two")
    emg = graph.add("emg", kg.Input(channels=("TA",), rate_hz=1000, units=("uV",)))
    graph.add("first", Lowpass(cutoff_hz=6), emg)
    graph.add("second", Another(cutoff_hz=12), emg)
    program = graph.to_python()
    assert [line for line in program.splitlines() if "Lowpass" in line and "import" in line] == [
        "from another_lowpass import Lowpass as Lowpass2",
        "from kinegraph.operators.filters.iir import Lowpass",
    ]
    made: dict[str, Any] = {}
    exec(program, made)
    assert {name: type(part) for name, part in made["graph"].nodes.items()} == {
        "emg": kg.Input, "first": Lowpass, "second": Another
    }  # fmt: skip


def test_a_loaded_graph_keeps_its_comments_and_grows() -> None:
    graph = kg.load("myoware")
    assert graph.to_yaml() == shipped()["myoware"].read_text(encoding="utf-8")
    graph.add("slow", Lowpass(cutoff_hz=50), "envelope", record=True)
    assert kg.Graph.from_yaml(graph.to_yaml()).specs == graph.specs
    assert str(graph.check().record[-1]) == "slow"
    assert kg.load("treadmill_emg", {"envelope.cutoff_hz": 10}).nodes["leg.chain.envelope"].cutoff_hz == 10  # type: ignore[union-attr]


@dataclass(frozen=True)
class Unsaid:
    """No part at all."""


@pytest.mark.parametrize(
    ("add", "complaint"),
    [
        (lambda g: g.add("x", Lowpass(600), "emg"), "node 'x': cutoff_hz is 600.0; it must be below 500"),
        (lambda g: g.add("x", Lowpass(6), "emgg"), "node 'x': there is no node 'emgg'; did you mean 'emg'?"),
        (lambda g: g.add("x", Lowpass(6)), "node 'x': 'from' is missing"),
        (lambda g: g.add("x", Lowpass(6), "x"), "node 'x': there is no node 'x'"),
        (lambda g: g.add("smooth", Lowpass(6), "emg"), "node 'smooth': the graph already has a node of this name"),
        (
            lambda g: g.add("x", Lowpass(6), "emg", worke="a"),
            "Lowpass has no parameter 'worke'; did you mean 'worker'?",
        ),
        (lambda g: g.add("x y", Lowpass(6), "emg"), "a node's name is made of letters"),
        (lambda g: g.add("x", Unsaid(), "emg"), "is not a source, operator or outlet"),
        (lambda g: g.record("smoth"), "there is no node 'smoth'; did you mean 'smooth'?"),
        (lambda g: kg.Graph(latency_budget_ms=-1), "latency_budget_ms is -1; it must be above 0"),
        (lambda g: kg.Graph(recording={"folder": 3}), "folder is 3; it must be a text"),
        (lambda g: kg.Graph(session={"a": object()}), "session: object cannot be written as YAML"),
        (lambda g: kg.load("tredmill_emg"), "did you mean 'treadmill_emg'?"),
    ],
)
def test_what_is_wrong_with_a_graph_is_said_where_it_is_added(add: Callable[[kg.Graph], Any], complaint: str) -> None:
    graph = low()
    before = graph.to_yaml()
    with pytest.raises(KinegraphError, match=re.escape(complaint)):
        add(graph)
    assert graph.to_yaml() == before


def test_a_class_that_no_graph_could_name_is_refused() -> None:
    @dataclass(frozen=True, slots=True)
    class Local(Rectify):
        pass

    with pytest.raises(GraphError, match="a graph names classes at the top level of a module"):
        low().add("x", Local(), "emg")


# running ---------------------------------------------------------------------------------------------------------------


def test_a_graph_on_an_array() -> None:
    results = low().run(TWO)
    assert [*results] == ["smooth", "active.interval"]
    np.testing.assert_array_equal(results["smooth"].data, Lowpass(cutoff_hz=6)(np.abs(TWO), rate_hz=1000))
    assert len(results["active.interval"]) == len(
        Threshold(0.8, channel=0)(results["smooth"].data, rate_hz=1000)["interval"]
    )
    assert [*low().run(TWO, keep=["rectified"])] == ["rectified"]
    with pytest.raises(KeyError, match=r"no output 'smoth' was kept; did you mean 'smooth'?"):
        results["smoth"]


def test_results_as_tables() -> None:
    pandas = pytest.importorskip("pandas")
    results = low().run(TWO)
    table = results["smooth"].to_pandas()
    assert [*table.columns] == ["TA", "SO"]
    np.testing.assert_array_equal(table.to_numpy(), results["smooth"].data)
    assert table.index.tz is not None and table.index[0] == pandas.Timestamp(
        int(results["smooth"].time[0]), unit="ns", tz="UTC"
    )
    assert table.attrs["units"] == {"TA": "uV", "SO": "uV"}
    assert [*results["active.interval"].to_pandas().columns] == ["onset", "end", "peak"]


def test_without_pandas_it_is_said_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(KinegraphError, match=re.escape("pip install 'kinegraph[pandas]'")):
        low().run(TWO)["smooth"].to_pandas()


def test_gaps_of_an_array_pass_through_a_graph() -> None:
    time = np.arange(3000) * 1_000_000
    time[1500:] += 3_000_000
    lost = low().run(TWO, time=time)["smooth"].lost
    assert lost is not None
    assert {int(i): int(lost[i]) for i in np.flatnonzero(lost)} == {1500: 3}


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (lambda g: g.run({"emgg": TWO}), "there is no source 'emgg'; did you mean 'emg'?"),
        (lambda g: g.run(TWO[:, :1]), "input 'emg' is samples of shape (1,); it must be 2 channels"),
        (lambda g: g.run(TWO, time=np.arange(3000) / 1e3), "multiply seconds by 1e9"),
        (lambda g: g.run(TWO, keep=["smoth"]), "keep: there is no output 'smoth'; did you mean 'smooth'?"),
        (lambda g: g.run(TWO, outlets=["screen"]), "there is no outlet 'screen'"),
        (lambda g: g.run("nowhere"), "nowhere: there is no such recording"),
        (lambda g: g.run(TWO[:0]), "there are no samples"),
        (lambda g: kg.load("treadmill_emg").run(TWO), "the graph reads 4 streams; give a mapping"),
    ],
)
def test_what_a_graph_cannot_run_on_is_refused(call: Callable[[kg.Graph], Any], complaint: str) -> None:
    with pytest.raises(KinegraphError, match=re.escape(complaint)):
        call(low())


def test_live_then_replayed_and_a_reader_of_ones_own(tmp_path: Path) -> None:
    graph = kg.Graph("walk")
    graph.add("treadmill", devices.Treadmill(realtime=False, duration_s=5.0))
    graph.add("smooth", Lowpass(cutoff_hz=6), "treadmill.emg", record=True)
    outcome = kg.run(graph, tmp_path / "session")
    assert outcome.exit_code == 0
    results = kg.replay(graph, tmp_path / "session")
    assert results.differing == ()
    with kg.Recording.open(tmp_path / "session") as recording:
        time, data = recording.read("smooth")
    np.testing.assert_array_equal(results["smooth"].data, data)
    np.testing.assert_array_equal(results["smooth"].time, time)
    other = kg.Graph("walk")
    other.add("treadmill", devices.Treadmill(realtime=False, duration_s=5.0))
    other.add("smooth", Lowpass(cutoff_hz=7), "treadmill.emg", record=True)
    assert other.run(tmp_path / "session").differing == ("smooth",)


def test_an_input_cannot_run_live() -> None:
    graph = kg.Graph()
    graph.add("emg", kg.Input(channels=["a"], rate_hz=100), deadline_s=1.0)  # type: ignore[arg-type]
    graph.add("r", Rectify(), "emg")
    with pytest.raises(KinegraphError, match="an Input has no device"):
        kg.run(graph)


def test_an_operator_is_held_to_the_laws() -> None:
    from tests.laws.broken_operators import __dict__ as broken

    kg.try_(Rectify, examples=3)
    wrong = [
        cls
        for cls in broken.values()
        if isinstance(cls, type) and issubclass(cls, kg.Operator) and cls.__dict__.get("cases")
    ]
    with pytest.raises(Broken):
        kg.try_(wrong[0], examples=20)
