"""`kinegraph dev try`: a user's own operator, in a file of their own, is held to the laws."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

OPERATOR = '''
from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param


@dataclass(frozen=True, slots=True)
class Gain(Operator[None]):
    """Every sample times `factor`."""

    factor: float = param(2.0)

    def open(self, specs):
        self.set_state(None)
        return {"out": specs["in"]}

    def process(self, port, chunk):
        x = np.where(np.isfinite(chunk.data), chunk.data, np.nan)
        return Chunk(chunk.time, BODY, chunk.until, chunk.lost)

    @classmethod
    def cases(cls):
        spec = StreamSpec((2,), rate_hz=100.0)
        data = np.random.default_rng(1).normal(size=(300, 2))
        return [Case(cls(), {"in": (spec, grid(100.0, 300), data)}, least=300)]
'''


def attempt(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "kinegraph", "dev", "try", *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_sound_operator_passes(tmp_path: Path) -> None:
    (tmp_path / "my_ops.py").write_text(OPERATOR.replace("BODY", "x * self.factor"))
    found = attempt(tmp_path, "my_ops.Gain", "--examples", "10")
    assert found.returncode == 0, found.stderr
    assert "case 1 of 1: every law held, 10 random tries" in found.stdout


def test_inputs_that_are_no_mapping_are_refused_in_words(tmp_path: Path) -> None:
    (tmp_path / "my_ops.py").write_text(
        OPERATOR.replace("BODY", "x").replace("    factor: float", '    inputs = ("in",)\n    factor: float')
    )
    found = attempt(tmp_path, "my_ops.Gain")
    assert found.returncode != 0 and "it must be a mapping of names to Input()" in found.stderr, found.stderr
    assert "Traceback" not in found.stderr


def test_inputs_of_several_rates_are_no_fault_of_the_operator(tmp_path: Path) -> None:
    """Where the case is played again, a stream that is over earlier begins after a gap; it must say so."""
    text = OPERATOR.replace("BODY", "x * self.factor").replace(
        """    def open(self, specs):
        self.set_state(None)
        return {"out": specs["in"]}
""",
        """    inputs = {"in": Input(), "slow": Input()}

    def open(self, specs):
        self.set_state(None)
        return {"out": specs["in"]}
""",
    )
    text = text.replace(
        "(self, port, chunk):", "(self, port, chunk):\n        if port == 'slow':\n            return None"
    )
    text = text.replace(
        "grid(100.0, 300), data)}", "grid(100.0, 300), data), 'slow': (spec_slow, grid(7.0, 22), data[:22])}"
    )
    text = text.replace("        data = np", "        spec_slow = StreamSpec((2,), rate_hz=7.0)\n        data = np")
    (tmp_path / "my_ops.py").write_text(text.replace("dataclass(frozen=True, slots=True)", "dataclass(frozen=True)"))
    found = attempt(tmp_path, "my_ops.Gain", "--examples", "10")
    assert found.returncode == 0, found.stderr


def test_a_broken_one_is_told_which_law_where_and_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "my_ops.py").write_text(OPERATOR.replace("BODY", "x - x[:1]"))
    found = attempt(tmp_path, "my_ops.Gain")
    assert found.returncode == 1
    assert "my_ops.Gain breaks law 1, rule 'cuts'" in found.stderr
    assert "output 'out', sample" in found.stderr
    assert "chunks: 'in':" in found.stderr
    assert "what to do:" in found.stderr
    assert "Traceback" not in found.stderr


@pytest.mark.parametrize(
    ("use", "complaint"),
    [
        ("my_ops.Gian", "did you mean 'Gain'?"),
        ("devices.people.treadmill.Treadmill", "the laws are for operators and outlets"),
    ],
)
def test_what_is_no_operator_is_refused(tmp_path: Path, use: str, complaint: str) -> None:
    (tmp_path / "my_ops.py").write_text(OPERATOR.replace("BODY", "x"))
    found = attempt(tmp_path, use)
    assert found.returncode == 2
    assert complaint in found.stderr
