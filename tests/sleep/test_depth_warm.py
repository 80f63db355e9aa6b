"""Kernels of rare moments are compiled before a graph runs, too: the first epoch of breath is no time for a compiler."""

from __future__ import annotations

import subprocess
import sys

CODE = """
from kinegraph.operators.bed import breath
from kinegraph.operators.bed.breathing import Breathing
case = Breathing.cases()[0]
case.operator.open({port: spec for port, (spec, _, _) in case.inputs.items()})
print([k.__name__ for k in (breath.vary, breath.spectra) if not k.signatures])
"""


def test_opening_is_enough_to_have_the_breaths_kernels() -> None:
    """In a process of its own: here other tests have compiled them."""
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
