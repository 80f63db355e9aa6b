"""`--json`: what a command prints can be read by programs, and holds what people are shown."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.stream.cli.commands.json_option import print_json
from kinegraph.stream.cli.completion import candidates
from tests.support.command_line import Command

PRINTING = (
    "check",
    "components",
    "configs",
    "info",
    "replay",
    "recover",
    "dev try",
    "batch",
    "devices",
    "emg sessions",
    "emg calibrate",
    "emg check-contacts",
    "emg check-electrodes",
    "emg compare",
    "emg train-model",
    "sleep check",
    "sleep evaluate",
    "sleep explain",
    "sleep nights",
    "motion evaluate",
    "motion train steps",
    "files compare-clocks",
    "files export",
    "files import",
)


def results(kinegraph: Command, *arguments: object) -> Any:
    code, out, output = kinegraph(*arguments, "--json")
    assert code == 0, output
    return json.loads(out)


@pytest.mark.parametrize("name", PRINTING)
def test_every_command_that_prints_results_offers_it(name: str) -> None:
    assert candidates([*name.split(), "--js"]) == ["--json"]


def test_check(kinegraph: Command, made: Path) -> None:
    found = results(kinegraph, "check", made / "graph.yaml")
    rect = next(node for node in found["nodes"] if node["name"] == "rect")
    assert rect["use"] == "operators.filters.rectify.Rectify" and rect["reads"] == {"in": "board.emg"}
    assert found["paths"][0]["nodes"][-1] == "rect" and found["delay_s"] >= 0


def test_components(kinegraph: Command) -> None:
    (lowpass,) = results(kinegraph, "components", "operators.filters.iir.Lowpass")
    assert lowpass["kind"] == "operator" and lowpass["inputs"] == ["in"]
    assert lowpass["parameters"]["properties"]["cutoff_hz"]["exclusiveMinimum"] == 0
    assert len(results(kinegraph, "components", "filter")) > 1


def test_configs(kinegraph: Command, tmp_path: Path) -> None:
    assert "treadmill_emg" in {entry["name"] for entry in results(kinegraph, "configs")}
    assert results(kinegraph, "configs", "treadmill_emg", "-o", "mine") == ["mine/treadmill_emg.yaml"]


def test_replay(kinegraph: Command, made: Path) -> None:
    found = results(kinegraph, "replay", made / "graph.yaml", made / "s")
    assert found["seconds"] == pytest.approx(2.0, abs=0.1) and not found["stopped"]
    assert found["outputs"]["rect"]["identical"] is True


def test_recover(kinegraph: Command, made: Path) -> None:
    assert results(kinegraph, "recover", made / "s") == []


def test_export_and_import(kinegraph: Command, made: Path, tmp_path: Path) -> None:
    exported = results(kinegraph, "files", "export", made / "s", "-o", tmp_path / "tables", "--stream", "board.emg")
    (table,) = exported["written"]
    assert table["samples"] > 0 and Path(table["file"]).exists() and "rect" in exported["left_out"]
    arguments = ("--stream", "emg=TA,GM", "--time", "time", "--unit", "uV", "--preview")
    imported = results(kinegraph, "files", "import", table["file"], *arguments)
    assert imported["recording"] is None and imported["streams"]["emg"]["samples"] == table["samples"]


def test_try(kinegraph: Command) -> None:
    found = results(kinegraph, "dev", "try", "operators.filters.rectify.Rectify", "--examples", "1")
    assert found["broken"] is None and found["cases"][0]["tries"] == 1


def test_emg_sessions(kinegraph: Command, made: Path) -> None:
    (row,) = results(kinegraph, "emg", "sessions", made)
    assert "subject" in row


def test_what_json_does_not_have_is_null(capsys: pytest.CaptureFixture[str]) -> None:
    print_json({"a": np.float64(1.5), "b": float("nan"), "c": np.arange(2), "d": Path("x"), "e": (True, None, "µV")})
    assert json.loads(capsys.readouterr().out) == {"a": 1.5, "b": None, "c": [0, 1], "d": "x", "e": [True, None, "µV"]}
