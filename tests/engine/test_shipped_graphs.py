"""Shipped graphs: nothing is written twice, what is common is a part, and today's graphs give what they gave before they used parts."""

from __future__ import annotations

import importlib.util
from collections import defaultdict
from pathlib import Path

from kinegraph.stream.graph.reading.expansion import expand
from kinegraph.stream.graph.reading.load import IMPLICIT
from kinegraph.stream.graph.reading.part_files import is_part
from kinegraph.stream.graph.reading.problems import Problems
from kinegraph.stream.graph.reading.settings_section import read_settings
from kinegraph.stream.graph.reading.yaml_lines import parse
from kinegraph.stream.graph.shipped import shipped, shipped_parts
from tests.support.command_line import Command, kinegraph

__all__ = ["kinegraph"]

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
BEFORE = Path(__file__).resolve().parents[1] / "recordings" / "before_parts"
BLOCK = 6


def lines(path: Path) -> list[str]:
    """A file's lines without comments, empty lines and indentation."""
    stripped = (line.partition(" #")[0].strip() for line in path.read_text(encoding="utf-8").splitlines())
    return [line for line in stripped if line and not line.startswith("#")]


def test_no_block_of_six_lines_occurs_twice() -> None:
    found = defaultdict[tuple[str, ...], list[str]](list)
    for path in CONFIGS.rglob("*.yaml"):
        text = lines(path)
        for i in range(len(text) - BLOCK + 1):
            found[tuple(text[i : i + BLOCK])].append(path.relative_to(CONFIGS).as_posix())
    twice = [f"{', '.join(files)}: {block[0]} ... {block[-1]}" for block, files in found.items() if len(files) > 1]
    assert not twice, "\n".join(twice)


def test_a_treadmill_session_is_short() -> None:
    assert len((CONFIGS / "treadmill_emg.yaml").read_text(encoding="utf-8").splitlines()) <= 40


def test_every_shipped_part_is_used_and_its_settings_feed_what_there_is() -> None:
    used: set[str] = set()
    for path in (*shipped().values(), *shipped_parts().values()):
        nodes = parse(path.read_text(encoding="utf-8"), str(path)).items()["nodes"].items().values()
        used |= {str(use.value) for node in nodes if is_part((use := node.items()["use"]).value)}
    assert used == shipped_parts().keys()


def test_every_setting_of_a_shipped_graph_has_a_label() -> None:
    for path in shipped().values():
        problems = Problems(str(path))
        root = expand(parse(path.read_text(encoding="utf-8"), str(path)), CONFIGS, problems, IMPLICIT).root
        for name, setting in read_settings(root.items().get("settings"), problems).items():
            assert setting.label and setting.targets, f"{path.name}: {name}"


def test_a_session_recorded_before_graphs_had_parts_is_verified_with_the_graph_of_today(kinegraph: Command) -> None:
    spec = importlib.util.spec_from_file_location("rename_graph", CONFIGS / "rename_graph.py")
    assert spec and spec.loader
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    Path("flat.yaml").write_text(script.before_parts(str(CONFIGS / "treadmill_emg.yaml")))
    code, output, _ = kinegraph("replay", "flat.yaml", BEFORE / "session.0000.mcap", "--verify")
    changed = {"mixtures.modes", "drift.distance"}
    """Since then maxima at rest are left out of the mixtures."""
    assert code == 1 and output.count("identical to the recording") == 16
    assert {line.split(":")[0].strip() for line in output.splitlines() if "DIFFERS" in line} == changed
