"""The script that changes the code to try the tests: what it changes, whose tests it runs, and how it judges what came of it."""

from __future__ import annotations

import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests import mutation
from tests.laws.module_tests import SAMPLE, own_commands, own_operators, own_tests
from tests.mutation import HOUSE, Mutant, drawn, mutants, told

SOURCE = '''"""Not 1 + 1."""
from typing import TYPE_CHECKING
if TYPE_CHECKING:
    LIMIT = 3
def f(n: int = 4, *, loud: bool = False) -> int:
    é = f"{n + 1}"
    return n - 1 if n < 2 and not loud else len(é)
def cases():
    return 5
'''


def test_what_is_changed_is_behaviour(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mutation, "HOUSE", tmp_path)
    path = tmp_path / "module.py"
    path.write_text(SOURCE, encoding="utf-8")
    found = [(m.line, m.before, m.after) for m in mutants(path)]
    assert set(found) == {
        (5, "4", "(5)"),
        (5, "False", "(True)"),
        (7, "n - 1", "(n + 1)"),
        (7, "1", "(2)"),
        (7, "n < 2", "(n <= 2)"),
        (7, "2", "(3)"),
        (7, "n < 2 and (not loud)", "(n < 2 or not loud)"),
        (7, "not loud", "(loud)"),
    }
    for mutant in mutants(path):
        source = path.read_bytes()
        changed = source[: mutant.start] + mutant.after.encode() + source[mutant.stop :]
        assert compile(changed, "module.py", "exec")
        assert changed.decode().splitlines()[mutant.line - 1] != SOURCE.splitlines()[mutant.line - 1]


def test_the_same_seed_draws_the_same_mutants() -> None:
    assert drawn(1, 20) == drawn(1, 20) != drawn(2, 20)


def test_what_changes_elsewhere_leaves_a_draw_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.mutation.HOUSE", tmp_path)
    (tmp_path / "stream").mkdir()
    module = tmp_path / "stream" / "module.py"
    module.write_text(SOURCE, encoding="utf-8")
    before = [m.key for m in drawn(1, 5)]
    module.write_text(f"{SOURCE}\n\ndef more(n):\n    return n * (n + 7)\n", encoding="utf-8")
    (tmp_path / "stream" / "another.py").write_text("LIMIT = 3\n", encoding="utf-8")
    after = [m.key for m in drawn(1, 11)]
    assert [key for key in after if key in before] == before and len(after) == 11


@pytest.mark.parametrize(
    ("module", "first"),
    [
        ("operators.gait.force", "tests/gait/test_contacts.py"),
        ("stream.params", "tests/engine/test_params.py"),
        ("operators.emg.commands.check_electrodes", "tests/gait/test_check_electrodes.py"),
        ("operators.whole_pose.commands.train", "tests/avatar/test_pose_training.py"),
        ("stream.face.script", "tests/study/test_face.py"),
        ("stream.engine.session", "tests/engine/test_session.py"),
        ("stream.engine.edge", "tests/engine/test_promises.py"),
    ],
)
def test_a_module_is_tried_by_its_own_tests(module: str, first: str) -> None:
    assert first in own_tests(module)
    assert all((HOUSE / path).exists() for path in own_tests(module))


def test_a_module_is_tried_by_golden_answers_of_what_it_is_part_of() -> None:
    found = {"operators.iir.Lowpass": "operators.iir", "operators.emg.Envelope": "operators.emg.envelope"}
    assert own_operators("operators.emg.envelope_kernel", found) == ["operators.emg.Envelope"]
    assert own_operators("stream.conformance.play", found) == list(SAMPLE)
    assert not own_operators("stream.commands.info", found)
    commands = {"train-steering": "operators.steering.commands.train", "train-map": "operators.pose_map.commands.train"}
    assert own_commands("operators.steering.fit", commands) == ["train-steering"]


def test_numbers_outside_functions_are_compared_before_anything_is_compiled() -> None:
    source = (HOUSE / "operators" / "gait" / "textbook.py").read_text(encoding="utf-8").splitlines()
    table = next(k for k, line in enumerate(source, 1) if line.startswith("WORKS_PCT"))
    inner = next(k for k, line in enumerate(source, 1) if line.startswith("def side_called")) + 2
    first = "tests/laws/test_constants.py"
    assert mutation._runs("operators/gait/textbook.py", "", table)[0][0] == first
    assert not any(first in run for run in mutation._runs("operators/gait/textbook.py", "", inner))


NEIGHBOURS, BUNDLE = "operators.neighbours.Neighbours", "operators.features.bundle.Bundle"


def test_the_nearest_operators_answers_and_the_nearest_tests_come_first_in_one_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(mutation, "_declares", lambda *_: False)
    first, others = mutation._runs("operators/depth/motion.py", "", 1)
    assert first[0] == "tests/laws/test_golden_answers.py::test_it_answers_as_it_did[operators.depth.motion.Motion]"
    assert first[1] == "tests/sleep/test_depth_motion.py"
    assert others[-1] == "tests/laws/test_laws.py::test_laws_by_chance[operators.depth.motion.Motion]"
    first, _ = mutation._runs(
        "operators/neighbours/seal.py", "", 1
    )  # part of another package's, too, which takes the minute to compile
    own, other = (f"{mutation.GOLDEN[0]}test_it_answers_as_it_did[{use}]" for use in (NEIGHBOURS, BUNDLE))
    assert first.index(own) < first.index("tests/motion/test_neighbours.py") < first.index(other)


@pytest.mark.parametrize("code", [0, 1, -9])
def test_what_is_unchanged_is_compiled_once_however_many_mutants_come_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    """Golden answers only; those that fail without any mutant are left out, but not those that take long."""
    answers = f"{mutation.GOLDEN[0]}test_it_answers_as_it_did[operators.Some]"
    asked = []

    def run(arguments: list[str], tree: Path, seconds: float) -> tuple[list[str], float, bool]:
        asked.append(arguments)
        assert seconds == mutation.COMPILES_S
        time.sleep(0.01)
        return (arguments if code else []), 1.0, code < 0

    monkeypatch.setattr(mutation, "_run", run)
    monkeypatch.setattr(mutation, "_runs", lambda *_: [[answers, "tests/a.py"]])
    unchanged = mutation.Unchanged()
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda k: unchanged.compiled(Mutant("module.py", k, 0, 1, "4", "(5)"), tmp_path), range(8)))
    assert asked == [[answers]]
    assert unchanged.broken == ({answers} if code > 0 else set())
    assert unchanged.passing == ({answers} if not code else set())


def test_what_passes_without_a_mutant_is_not_asked_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "module.py").write_text(SOURCE, encoding="utf-8")
    asked = []

    def run(arguments: list[str], tree: Path, seconds: float) -> tuple[list[str], float, bool]:
        asked.append(arguments)
        return (["tests/a.py::test_b"] if "(5)" in (tree / "module.py").read_text(encoding="utf-8") else []), 3.0, False

    monkeypatch.setattr(mutation, "_run", run)
    monkeypatch.setattr(mutation, "_runs", lambda *_: [["tests/a.py"]])
    unchanged = mutation.Unchanged()
    for _ in range(2):
        told_so = mutation.tried(Mutant("module.py", 5, 0, 1, "4", "(5)"), tmp_path, 60.0, unchanged)
        assert told_so == ("noticed", 3.0, "tests/a.py::test_b")
    assert asked == [["tests/a.py"], ["tests/a.py::test_b"], ["tests/a.py"]]


@pytest.mark.parametrize("ended", [False, True])
def test_tests_that_only_take_too_long_are_asked_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ended: bool
) -> None:
    """Tests that fail without the mutant are left out from then on, but for those that ran out of time with it and without."""
    (tmp_path / "module.py").write_text(SOURCE, encoding="utf-8")
    asked = []

    def run(arguments: list[str], tree: Path, seconds: float) -> tuple[list[str], float, bool]:
        asked.append(arguments)
        return ([] if "--deselect" in arguments else ["tests/a.py::test_b"]), 1.0, ended

    monkeypatch.setattr(mutation, "_run", run)
    monkeypatch.setattr(mutation, "_runs", lambda *_: [["tests/a.py"]])
    unchanged = mutation.Unchanged()
    assert mutation.tried(Mutant("module.py", 5, 0, 1, "4", "(5)"), tmp_path, 60.0, unchanged)[0] == "survived"
    assert unchanged.broken == (set() if ended else {"tests/a.py::test_b"})
    assert len(asked) == (2 if ended else 3)
    assert (tmp_path / "module.py").read_text(encoding="utf-8") == SOURCE


def test_tests_that_cannot_be_collected_without_a_mutant_either_say_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "module.py").write_text(SOURCE, encoding="utf-8")
    named = ["tests/a.py::test_b", "tests/c.py"]
    monkeypatch.setattr(mutation, "_run", lambda *_: ([*named, "--collect-only"], 1.0, False))
    monkeypatch.setattr(mutation, "_runs", lambda *_: [named])
    unchanged = mutation.Unchanged()
    assert mutation.tried(Mutant("module.py", 5, 0, 1, "4", "(5)"), tmp_path, 60.0, unchanged)[0] == "survived"
    assert not unchanged.broken and not unchanged.passing


def test_the_clock_fails_no_test_on_a_busy_machine(tmp_path: Path) -> None:
    """Whatever time our settings give a test."""
    support = tmp_path / "tests" / "support"
    shutil.copytree(HOUSE / "tests" / "support", support, ignore=lambda _, names: {*names} - {"stop_in_time.py"})
    (tmp_path / "pyproject.toml").write_text("[tool.pytest.ini_options]\ntimeout = 0.2\n", encoding="utf-8")
    (tmp_path / "test_slow.py").write_text("import time\ndef test_slow():\n    time.sleep(0.5)\n", encoding="utf-8")
    assert mutation._run(["test_slow.py"], tmp_path, 60.0)[0] == []


def test_nine_in_ten_must_be_noticed_of_those_that_change_anything(capsys: pytest.CaptureFixture[str]) -> None:
    made = [Mutant("a.py", k, 0, 1, str(k), f"({k + 1})") for k in range(12)]
    results = {m: "survived" if m.line in (3, 4) else "noticed" for m in made}
    assert told(results, set()) == 1
    assert told(results, {made[3].key}) == 0
    printed = capsys.readouterr().out
    assert "10 of 12 mutants that change behaviour were noticed" in printed
    assert "10 of 11 mutants that change behaviour were noticed; 1 are equivalent" in printed
    assert "survived: a.py:4: 4  ->  (5)" in printed
