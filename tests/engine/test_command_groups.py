"""Commands are fifteen at top level and the others in groups; a former name leads to the present one; packages add to both."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from kinegraph.stream.cli.registry import GROUPS, RENAMED, names
from tests.support.command_line import KINEGRAPH, Command, refused, shell

TOP = {
    "demo",
    "lab",
    "ward",
    "run",
    "replay",
    "check",
    "draw",
    "components",
    "configs",
    "info",
    "recover",
    "record",
    "devices",
    "view",
    "batch",
}
ENTRIES = """[kinegraph.commands]
measure = lab:measure
gait.walk = lab:walk
gait.run = lab:measure
emg.weigh = lab:measure
motion.train.gait = lab:walk
"""
MODULE = '''
def measure() -> None:
    """Measure something."""
    print("measured")


def walk(name: str) -> None:
    """Walk for somebody."""
    print("walked for", name)
'''


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An installed package that adds commands at top level, to our groups, and a group of its own."""
    facts = tmp_path / "site" / "lab-1.0.dist-info"
    facts.mkdir(parents=True)
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: lab\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text(ENTRIES)
    (tmp_path / "site" / "lab.py").write_text(MODULE)
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    monkeypatch.delitem(sys.modules, "lab", raising=False)


def listed(text: str) -> set[str]:
    return {line.split()[0] for line in text.splitlines() if re.match(r"  \S", line)}


def test_help_lists_fifteen_commands_and_the_groups(kinegraph: Command) -> None:
    code, out, _ = kinegraph("--help")
    assert code == 0 and listed(out) == {*TOP, "emg", "sleep", "motion", "files", "dev"}
    assert {name for name in names() if " " not in name} == TOP
    assert kinegraph() == (2, "", out) and kinegraph("help") == (0, out, "")


@pytest.mark.parametrize("group", GROUPS)
def test_a_group_lists_its_commands(group: str, kinegraph: Command) -> None:
    code, out, _ = kinegraph(*group.split(), "--help")
    inside = {name.removeprefix(f"{group} ").split()[0] for name in names() if name.startswith(f"{group} ")}
    assert code == 0 and GROUPS[group] in out and listed(out) == inside and inside
    assert kinegraph(*group.split()) == (2, "", out)


@pytest.mark.parametrize("old", RENAMED)
def test_a_former_name_is_refused_with_the_present_one(old: str, kinegraph: Command) -> None:
    new = RENAMED[old]
    assert new in {*names(), *GROUPS} and old not in names()
    refused(kinegraph(*old.split(), "a"), f"kinegraph {old} is now kinegraph {new}\n")


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        ("rnu", "did you mean 'kinegraph run'?"),
        ("label x.mcap", "did you mean 'kinegraph motion label'?"),
        ("evaluate", "did you mean 'kinegraph motion evaluate' or 'kinegraph sleep evaluate'?"),
        ("emg callibrate rest", "no command 'emg callibrate'; did you mean 'kinegraph emg calibrate'?"),
        ("motion train steerin", "did you mean 'kinegraph motion train steering'?"),
        ("emg xyzzy", "`kinegraph emg --help` lists all commands"),
        ("xyzzy", "`kinegraph --help` lists all commands"),
    ],
)
def test_a_misspelt_command_gets_a_hint(words: str, meant: str, kinegraph: Command) -> None:
    refused(kinegraph(*words.split()), "there is no command", meant)


def test_a_command_of_a_group_has_its_own_help(kinegraph: Command) -> None:
    code, out, _ = kinegraph("files", "compare-clocks", "--help")
    assert code == 0 and "Usage: kinegraph files compare-clocks [OPTIONS] " in out


@pytest.mark.usefixtures("lab")
def test_a_package_adds_commands_to_the_top_level_to_groups_and_a_group_of_its_own(kinegraph: Command) -> None:
    assert kinegraph("measure")[1] == kinegraph("emg", "weigh")[1] == "measured\n"
    assert kinegraph("gait", "walk", "Ada")[1] == kinegraph("motion", "train", "gait", "Ada")[1] == "walked for Ada\n"
    out = kinegraph("--help")[1]
    assert {"measure", "gait"} <= listed(out) and "Measure something." in out and "walk, run" in out
    assert listed(kinegraph("gait", "--help")[1]) == {"walk", "run"}
    assert "Walk for somebody." in kinegraph("motion", "train", "--help")[1]


@pytest.mark.parametrize("group", [[], ["emg"], ["motion", "train"]])
def test_help_loads_no_command_of_a_group(group: list[str]) -> None:
    code = f"import sys; sys.argv[1:] = {[*group, '--help']}; from kinegraph.stream.cli.main import main\ntry: main()\n"
    code += "except SystemExit: pass\nprint([m for m in sys.modules if m.startswith('kinegraph.operators') or m == 'numba'])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_what_draws_reports_and_compiles_is_loaded_when_it_is_used() -> None:
    heavy = "print([m for m in ('numpy', 'numba', 'matplotlib', 'jinja2', 'pandas') if m in sys.modules])"
    code = f"import sys, kinegraph as kg; {heavy}; kg.load('treadmill_emg').check(); {heavy}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["[]", "['numpy', 'numba']"]


def test_the_help_of_a_group_is_not_cut_off_and_fits_the_terminal(
    kinegraph: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    out = kinegraph("motion", "train", "--help")[1]
    assert max(map(len, out.splitlines())) <= 80
    text = " ".join(out.split())
    assert "steering Learn how a mesh moves with a few of its vertices (thesis, chapter 9). steps" in text


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["re"], ["record", "recover", "replay"]),
        (["emg", "ca"], ["calibrate"]),
        (["motion", "train", "st"], ["steering", "steps"]),
        (["mo"], ["motion"]),
        (["run", "treadmill_"], ["treadmill_both_legs", "treadmill_emg"]),
        (["run", "treadmill_emg", "--sim"], ["--simulate"]),
        (["run", "treadmill_emg", "--no-r"], ["--no-record"]),
        (["demo", "n"], ["night"]),
        (["replay", "treadmill_emg", "rec"], []),
        (["xyzzy", ""], []),
    ],
)
def test_a_shell_is_given_what_a_word_may_become(words: list[str], found: list[str], kinegraph: Command) -> None:
    code, out, _ = kinegraph("dev", "completion", "bash", "--", *words)
    assert code == 0 and out.split() == found


def test_a_shell_that_is_not_known_is_refused(kinegraph: Command) -> None:
    refused(kinegraph("dev", "completion", "bsh"), "there is no completion for 'bsh'; did you mean 'bash'?")


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
def test_bash_completes(tmp_path: Path) -> None:
    typed = "COMP_WORDS=(kinegraph emg ca); COMP_CWORD=2; _kinegraph; echo ${COMPREPLY[@]}"
    done = shell(f"PATH={KINEGRAPH.parent}:$PATH; source <(kinegraph dev completion bash); {typed}", tmp_path)
    assert done.stdout == "calibrate\n", done.stderr
