"""`python -m tests.mutation --seed 1`: random small changes to operators/ and stream/; does a test notice each of them?

A mutant turns one comparison, sum, number or truth value around, in a copy of the tree. Its module's tests run against it (the golden
answers of the operators and commands that it is part of, the tests nearest to it in the imports, and the laws on its operators), for at
most a minute of processor time, however busy the machine is. Survivors are listed; exit code 1 if fewer than nine in ten were noticed. A
survivor that changes nothing that anyone could see is named in equivalent_mutants.txt, with the reason.

What is unchanged is compiled before, outside of the minute: golden-answer tests run once on the unchanged tree, when they are first to be
asked. Kernels are cached by their code, so with a mutant only those are compiled that its change reaches.

In pieces: `--skip 10 --count 20` tries the second ten, and `--tree FOLDER` keeps the copy, so that the next piece finds its kernels
compiled.
"""

from __future__ import annotations

import argparse
import ast
import compileall
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from hashlib import sha256
from heapq import nsmallest
from math import ceil
from operator import itemgetter
from pathlib import Path
from py_compile import PycInvalidationMode
from queue import SimpleQueue
from threading import Lock, Timer
from xml.etree import ElementTree

from stream.graph.parts import catalogue
from tests.constants import KEPT
from tests.golden_commands import SCENES
from tests.laws.module_tests import own_commands, own_operators, own_tests, same_package

HOUSE = Path(__file__).resolve().parent.parent
COPIED = (
    "stream",
    "devices",
    "operators",
    "tests",
    "configs",
    "bench",
    "docs",
    "kinegraph.py",
    "pyproject.toml",
    "README.md",
    "Makefile",
)
EQUIVALENT = Path(__file__).with_name("equivalent_mutants.txt")
LEAST = 0.9
"""The share of mutants that must be noticed."""
HANGS_S = 15
"""A test that is still running so long after the time for tests was up has been hung by the mutant."""
WAITS = 10
"""Tests that wait rather than work are ended after so many times the processor time that they may take."""
ONE_THREAD = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
"""Threads of linear algebra wait for each other by turning round: two of them use up the minute in half of it, and do no more."""
NEAREST = 3
"""This many of a module's own test files come before the golden answers of commands, which take longer."""
COMPILES_S = 600
"""Processor time for a golden-answer test on the unchanged tree, with nothing compiled."""
GOLDEN = ("tests/laws/test_golden_answers.py::", "tests/laws/test_golden_commands.py::")
INTERRUPTED = 2
"""How pytest ends where it began no other test."""
OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change: of the text from `start` to `stop` (in bytes) of a file."""

    path: str
    line: int
    start: int
    stop: int
    before: str
    after: str
    code: str = ""

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.before}  ->  {self.after}"

    @property
    def key(self) -> str:
        """How the mutant is known when lines have moved."""
        return f"{self.path}: {self.before}  ->  {self.after}  in  {self.code}"


def mutants(path: Path) -> Iterator[Mutant]:
    """Every mutant of a file, in its order; but for what is no behaviour: annotations, texts, an operator's cases, types' imports."""
    source = path.read_bytes()
    starts, lines = [0], source.splitlines(keepends=True)
    for line in lines:
        starts.append(starts[-1] + len(line))
    for node in _behaviour(ast.parse(source)):
        changed = _changed(node)
        if changed is not None and isinstance(node, ast.expr) and node.end_lineno and node.end_col_offset is not None:
            start, stop = starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset
            yield Mutant(
                str(path.relative_to(HOUSE)),
                node.lineno,
                start,
                stop,
                ast.unparse(node),
                f"({ast.unparse(changed)})",
                lines[node.lineno - 1].decode().strip(),
            )


def _behaviour(node: ast.AST) -> Iterator[ast.AST]:
    if isinstance(node, ast.JoinedStr) or (isinstance(node, ast.FunctionDef) and node.name == "cases"):
        return
    if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
        return
    yield node
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield from _behaviour(child)


def _changed(node: ast.AST) -> ast.expr | None:
    """The node with one thing turned around; None where there is nothing to turn."""
    match node:
        case ast.Compare(left, [op], comparators) if type(op) in OPERATORS:
            return ast.Compare(left, [OPERATORS[type(op)]()], comparators)  # type: ignore[list-item]
        case ast.BinOp(left, op, right) if type(op) in OPERATORS:
            return ast.BinOp(left, OPERATORS[type(op)](), right)  # type: ignore[arg-type]
        case ast.BoolOp(op, values):
            return ast.BoolOp(OPERATORS[type(op)](), values)  # type: ignore[arg-type]
        case ast.UnaryOp(ast.Not(), operand):
            return operand
        case ast.Constant(bool(value)):
            return ast.Constant(not value)
        case ast.Constant(int(value) | float(value)):
            return ast.Constant(value + 1)
    return None


def drawn(seed: int, count: int) -> list[Mutant]:
    """Mutants drawn from all there are; the same ones for the same seed, as long as their own lines stay as they are.

    Every mutant has its lot, by the seed and its key (and which of those with this key it is): a change elsewhere moves none of them.
    """
    files = sorted(p for package in ("operators", "stream") for p in (HOUSE / package).rglob("*.py"))
    lots, times = [], Counter[str]()
    for mutant in (one for path in files for one in mutants(path)):
        lots.append((sha256(f"{seed} {mutant.key} {times[mutant.key]}".encode()).digest(), mutant))
        times[mutant.key] += 1
    return [mutant for _, mutant in nsmallest(count, lots, key=itemgetter(0))]


@dataclass(slots=True)
class Unchanged:
    """What is known of tests on the unchanged tree: which are `passing`, which are `broken`. Golden answers run on it once a session."""

    broken: set[str] = field(default_factory=set)
    passing: set[str] = field(default_factory=set)
    _begun: dict[str, Lock] = field(default_factory=dict)
    _ended: set[str] = field(default_factory=set)

    def compiled(self, mutant: Mutant, tree: Path) -> None:
        """Return when the golden answers that this mutant is tried by have run, in this copy of the tree or in another one."""
        for run in _runs(mutant.path, mutant.code, mutant.line):
            for name in (one for one in run if one.startswith(GOLDEN)):
                with self._begun.setdefault(name, Lock()):
                    if name not in self._ended:
                        self.passes([name], tree, COMPILES_S)
                        self._ended.add(name)

    def passes(self, arguments: list[str], tree: Path, seconds: float) -> bool | None:
        """Whether tests that are asked by these arguments pass; None where that takes longer than this, or no one test has failed."""
        if self.passing.issuperset(arguments):
            return True
        failed, _, late = _run(arguments, tree, seconds)
        if not failed:
            self.passing.update(arguments if len(arguments) == 1 else ())
            return True
        if late or len(failed) > 1 or "::" not in failed[0]:
            return None
        self.broken.add(failed[0])
        return False


def tried(mutant: Mutant, tree: Path, seconds: float, unchanged: Unchanged) -> tuple[str, float, str]:
    """What became of a mutant in this copy of the tree, after how many seconds of processor time, and which test noticed it.

    A failure counts if the same tests pass without the mutant. Tests that fail anyway are left out from then on; those that only take
    longer than there is time are asked again with the next mutant, whose kernels may be compiled already.
    """
    changed = tree / mutant.path
    source = changed.read_bytes()
    runs = _runs(mutant.path, mutant.code, mutant.line)
    if not runs:
        return "no tests", 0.0, ""
    while True:
        changed.write_bytes(source[: mutant.start] + mutant.after.encode() + source[mutant.stop :])
        try:
            failed, used = _first_failure(runs, tree, seconds, unchanged.broken)
        finally:
            changed.write_bytes(source)
        if not failed:
            return "survived", used, ""
        match unchanged.passes(failed, tree, seconds):
            case True:
                return "noticed", used, failed[0]
            case None:
                return "survived", used, ""  # one of these tests takes longer than that, with the mutant and without


def _first_failure(runs: list[list[str]], tree: Path, seconds: float, broken: set[str]) -> tuple[list[str], float]:
    """The arguments of pytest for what failed first within this processor time, none if all passed; and how much of it was used."""
    left_out = [word for name in sorted(broken) for word in ("--deselect", name)]
    total = 0.0
    for arguments in runs:
        if seconds - total > 1:
            failed, used, _ = _run([*arguments, *left_out], tree, seconds - total)
            total += used
            if failed:
                return failed, total
    return [], total


def _declares(path: str, line: int) -> bool:
    """Whether a line stands outside all functions' bodies: there numbers are declared, which are compared before anything is compiled."""
    tree = ast.parse((HOUSE / path).read_bytes())
    functions = (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef))
    return not any(one.body[0].lineno <= line <= (one.end_lineno or 0) for one in functions)


def _runs(path: str, code: str, line: int) -> list[list[str]]:
    """The arguments of pytest for the tests of a module: golden answers of operators and commands, its own, the laws on operators in it.

    For a `line` that declares something, those of what is declared come first; for `code` that declares a dataclass, those of how, too.
    Then golden answers of the nearest operators, those of other packages, which may take long to compile, after the nearest tests; in
    one process, since imports take seconds in each. All others come in a second one.
    """
    module = path.removesuffix(".py").replace("/", ".").removesuffix(".__init__")
    found = {use: part.__module__ for use, part in catalogue(("operators",))[0].items()}
    answers, commands = (f"{place}test_it_answers_as_it_did" for place in GOLDEN)
    near = own_operators(module, found)
    apart = [use for use in near[1:] if not same_package(found[use], module)]
    scenes = {name: home for name, (home, _) in SCENES.items()}
    golden_commands = [f"{commands}[{name}]" for name in own_commands(module, scenes)]
    own = own_tests(module)
    uses = [use for use, home in found.items() if home == module]
    laws = [
        f"tests/laws/test_laws.py::test_laws_{how}[{use}]" for use in uses for how in ("without_chance", "by_chance")
    ]
    declared = ["tests/house/test_frozen.py"] if code.startswith("@dataclass(") else []
    if _declares(path, line) and module in json.loads(KEPT.read_text(encoding="utf-8")):
        declared.append("tests/laws/test_constants.py")
    golden, later = ([f"{answers}[{use}]" for use in near if (use in apart) == late] for late in (False, True))
    first = [*declared, *golden, *own[:NEAREST], *later]
    return [run for run in (first, [*golden_commands, *own[NEAREST:], *laws]) if run]


def _run(arguments: list[str], tree: Path, seconds: float) -> tuple[list[str], float, bool]:
    """Run these tests; returns the arguments for the one that failed (for all, if they took too long), or none, the processor time, and
    whether they were ended from outside."""
    options = ["-x", "-q", "--junitxml=junit.xml", "-p", "no:cacheprovider", "-p", "tests.support.stop_in_time"]
    options += ["--timeout=0"]  # by the clock a busy machine fails what takes long to compile
    command = [sys.executable, "-m", "pytest", *options, *arguments]
    limited = ["/bin/sh", "-c", f'ulimit -t {ceil(seconds) + HANGS_S} && exec "$@"', "sh", *command]
    environment = {
        **os.environ, **ONE_THREAD, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1", "KINEGRAPH_STOP_S": str(seconds)
    }  # fmt: skip
    running = subprocess.Popen(
        limited, cwd=tree, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    hung = Timer(WAITS * seconds, os.killpg, (running.pid, signal.SIGKILL))
    hung.start()
    _, status, usage = os.wait4(running.pid, 0)
    hung.cancel()
    running.returncode = os.waitstatus_to_exitcode(status)
    return _judged(arguments, tree, running.returncode), usage.ru_utime + usage.ru_stime, running.returncode < 0


def _judged(arguments: list[str], tree: Path, code: int) -> list[str]:
    """The arguments of pytest for the test that failed, for all of them where none is known to be the one; none if all passed."""
    if code < 0:
        return arguments
    if code in (0, 5):
        return []
    cases = [*ElementTree.parse(tree / "junit.xml").iter("testcase")]
    failed = [case for case in cases if case.find("failure") is not None or case.find("error") is not None]
    for case in failed:
        if case.get("classname"):
            return [f"{str(case.get('classname')).replace('.', '/')}.py::{case.get('name')}"]
    return [] if code == INTERRUPTED and not failed else [*arguments, "--collect-only"]


def copy_to(place: Path) -> Path:
    """A copy of what tests need; where there is one already, that one, as it must be."""
    for name in COPIED:
        source = HOUSE / name
        if source.is_dir():
            shutil.rmtree(place / name, ignore_errors=True)
            shutil.copytree(source, place / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            place.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, place / name)
    checked = PycInvalidationMode.CHECKED_HASH  # a mutant may be as old and as long as what it changes
    compileall.compile_dir(place, quiet=2, invalidation_mode=checked)
    return place


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=60.0, help="processor time for the tests of one mutant")
    parser.add_argument(
        "--only", nargs="+", metavar="TEXT", default=[""], help="mutants in whose line one of these stands"
    )
    parser.add_argument("--skip", type=int, default=0, help="leave out this many of those drawn, the first ones")
    parser.add_argument("--jobs", type=int, default=1, help="how many at once")
    parser.add_argument(
        "--tree", type=Path, metavar="FOLDER", help="keep the copies of the tree here, and use them again"
    )
    given = parser.parse_args()
    equivalent = {line.rpartition("  # ")[0].strip() for line in EQUIVALENT.read_text(encoding="utf-8").splitlines()}
    chosen = [m for m in drawn(given.seed, given.count)[given.skip :] if any(text in str(m) for text in given.only)]
    results: dict[Mutant, str] = {}
    unchanged = Unchanged()
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder, ThreadPoolExecutor(given.jobs) as pool:
        trees: SimpleQueue[Path] = SimpleQueue()
        for k in range(given.jobs):
            trees.put(copy_to((given.tree or Path(folder)) / str(k)))

        def one(mutant: Mutant) -> None:
            tree = trees.get()
            try:
                unchanged.compiled(mutant, tree)
                results[mutant], seconds, by = tried(mutant, tree, given.seconds, unchanged)
            finally:
                trees.put(tree)
            print(f"{len(results):3} {results[mutant]:<9} {seconds:4.0f} s  {mutant}  {by}", flush=True)

        list(pool.map(one, chosen))
    for name in sorted(unchanged.broken):
        print(f"fails without any mutant, and was left out: {name}")
    return told(results, equivalent)


def told(results: dict[Mutant, str], equivalent: set[str]) -> int:
    """Print what came of it; the exit code."""
    behavioural = {m: r for m, r in results.items() if r == "noticed" or m.key not in equivalent}
    noticed = sum(result == "noticed" for result in behavioural.values())
    print(
        f"\n{noticed} of {len(behavioural)} mutants that change behaviour were noticed; {len(results) - len(behavioural)} are equivalent"
    )
    for mutant, result in behavioural.items():
        if result != "noticed":
            print(f"  {result}: {mutant}")
    return 0 if noticed >= LEAST * len(behavioural) else 1


if __name__ == "__main__":
    sys.exit(main())
