"""The notebooks of the docs run from their first cell to their last, in a kernel of their own."""

from __future__ import annotations

import os
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.nightly

NOTEBOOKS = sorted((Path(__file__).resolve().parents[2] / "docs" / "notebooks").glob("*.ipynb"))


@pytest.mark.timeout(300)
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed (extra `test`)")
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed (extra `test`)")
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    shutil.copy(path, tmp_path)
    book = nbformat.read(tmp_path / path.name, as_version=4)
    assert [cell for cell in book.cells if cell.get("outputs")], "notebooks are kept with their outputs"
    client = nbclient.NotebookClient(book, timeout=240, resources={"metadata": {"path": str(tmp_path)}})
    client.execute()  # raises where a cell fails
    shown = [
        output for cell in book.cells for output in cell.get("outputs", ()) if output["output_type"] == "execute_result"
    ]
    assert shown, "nothing was shown"


def test_there_are_notebooks() -> None:
    assert len(NOTEBOOKS) >= 5


def test_a_long_replay_shows_its_progress_and_the_time_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed (extra `test`)")
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed (extra `test`)")
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    code = [
        "import kinegraph as kg",
        "from kinegraph.stream.api import notebook_bar",
        "graph = kg.load('board.yaml')",
        "kg.run(graph, 'session')",
        "notebook_bar.AFTER_S = notebook_bar.EVERY_S = 0.0",
        "made = kg.replay(graph, 'session')",
    ]
    (tmp_path / "board.yaml").write_text(
        "nodes:\n  board: {use: devices.people.treadmill.Treadmill, realtime: false, duration_s: 60}\n"
        "  smooth: {use: operators.filters.iir.Lowpass, from: board.emg, cutoff_hz: 6}\nrecord: [smooth]\n"
    )
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("\n".join(code))])
    client = nbclient.NotebookClient(book, timeout=240, resources={"metadata": {"path": str(tmp_path)}})
    rows: list[str] = []
    process = client.process_message

    def seen(message: dict[str, Any], cell: object, at: int) -> object:
        rows.append(str(message["content"].get("data", {}).get("text/plain", "")))
        return process(message, cell, at)

    monkeypatch.setattr(client, "process_message", seen)
    client.execute()
    bars = [text for text in rows if re.fullmatch(r"replay: \d+ of 60 s, \d+ s left", text)]
    assert bars and "Traceback" not in str(book), rows
