"""`--view lines` prints the result of every shipped graph: each has an outlet that writes on the terminal."""

from __future__ import annotations

import re

import pytest

from kinegraph.stream.graph.shipped import shipped, shipped_parts

PART = re.compile(r"use: (parts/[\w.]+)")
PARTS = {name: path.read_text(encoding="utf-8") for name, path in shipped_parts().items()}


def with_parts(text: str) -> str:
    return text + "".join(with_parts(PARTS[name]) for name in PART.findall(text))


@pytest.mark.parametrize("name", shipped())
def test_a_shipped_graph_prints_its_result(name: str) -> None:
    assert "use: devices.outlets.terminal." in with_parts(shipped()[name].read_text(encoding="utf-8"))
