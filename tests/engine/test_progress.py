"""The bar of long conversions: on a terminal, and nowhere else."""

from __future__ import annotations

from io import StringIO

import pytest
from rich.console import Console

from kinegraph.stream.text.progress import bar


@pytest.mark.parametrize("terminal", [True, False])
def test_a_bar_is_shown_where_somebody_watches(terminal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = StringIO()
    screen = Console(file=shown, force_terminal=terminal, force_interactive=True, width=100)
    monkeypatch.setattr("kinegraph.stream.text.screen.Screen", lambda **_: screen)
    with bar("reading [marks]") as progress:
        progress(1, 4)
        progress(4, 4)
    assert ("reading [marks]" in shown.getvalue()) == ("100%" in shown.getvalue()) == terminal
