"""A package that was changed after it was installed: its entry points name modules that are not there any more."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.command_line import Command, refused

ENTRIES = """[kinegraph.commands]
weigh = gone_lab.weighing:weigh
measure = here_lab:measure
motion.train.weights = gone_lab.weighing:train
motion.weights = here_lab:gone

[kinegraph.views]
scales = gone_lab.weighing:View
"""
MODULE = '''def measure() -> None:
    """Measure something."""
'''


@pytest.fixture
def changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An installed package of which one module is gone, and one function of another."""
    facts = tmp_path / "site" / "lab_tools-1.0.dist-info"
    facts.mkdir(parents=True)
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-tools\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text(ENTRIES)
    (tmp_path / "site" / "here_lab.py").write_text(MODULE)
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    monkeypatch.setenv("COLUMNS", "200")


@pytest.mark.usefixtures("changed")
def test_help_names_what_is_gone_and_lists_the_other_commands(kinegraph: Command) -> None:
    code, out, _ = kinegraph("--help")
    assert code == 0 and "the command weigh (gone_lab.weighing:weigh) cannot be loaded" in out
    assert "if lab-tools has changed since it was installed, install it again" in out
    listed = {line.split()[0] for line in out.splitlines() if line.startswith("  ")}
    assert {"run", "measure", "motion"} <= listed and "weigh" not in listed
    assert "Measure something." in out


@pytest.mark.usefixtures("changed")
def test_a_command_or_view_that_is_gone_is_refused_by_name(kinegraph: Command) -> None:
    refused(kinegraph("weigh"), "the command weigh (gone_lab.weighing:weigh) cannot be loaded", "lab-tools")
    refused(kinegraph("wiegh"), "there is no command 'wiegh'")
    refused(kinegraph("run", "treadmill_emg", "--view", "scales", "--for", "0.1"), "the view scales (gone_lab")


@pytest.mark.usefixtures("changed")
@pytest.mark.parametrize(("group", "other"), [("motion", "label"), ("motion train", "steering")])
def test_a_command_that_is_gone_does_not_take_its_group_along(kinegraph: Command, group: str, other: str) -> None:
    code, out, _ = kinegraph(*group.split(), "--help")
    assert code == 0 and f"the command {group.replace(' ', '.')}.weights (" in out and "cannot be loaded" in out
    assert f"  {other} " in out and "  weights " not in out
