"""Names and texts from outside: on no screen do they move the cursor, in no table are they a formula, nowhere are they markup."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
import pytest
import structlog

from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.data.csv_writer import Sheet
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.operator import grid
from kinegraph.stream.recording import Recorder
from kinegraph.stream.text.safe_text import HARMFUL
from kinegraph.stream.text.screen import Screen
from tests.support.command_line import QUIET, Command

HOSTILE = (
    "[/red]",
    "[bold]x[/bold]",
    "\x1b[2J\x1b]0;owned\x07",
    "a\rb",
    "\u202eevil",
    "\x9b31m",
    "=1+1",
    "<script>x</script>",
)


@pytest.fixture
def hostile(tmp_path: Path) -> Path:
    """A recording with such a text in every place that takes one."""
    session = {text: text for text in HOSTILE}
    header = {"graph": HOSTILE[2], "name": HOSTILE[2], "session": session, "versions": session}
    times = grid(100.0, 30, 1_700_000_000 * NS)
    path = tmp_path / "hostile.mcap"
    with Recorder(path, header, RecordingOptions(), wait=True) as recorder:
        fields = np.dtype([("onset", "<i8"), ("text", "<U64")])
        marks = np.array([(int(t), text) for t, text in zip(times, HOSTILE, strict=False)], fields)
        number = recorder.add_stream("annotations", StreamSpec((), fields), "input")
        recorder.write(number, Chunk(times[: len(marks)], marks, int(times[-1])), int(times[-1]), 0)
        for i, text in enumerate(HOSTILE, 1):
            spec = StreamSpec((1,), rate_hz=100.0, channels=(text,), units=(text,))
            number = recorder.add_stream(text, spec, "input")
            recorder.write(number, Chunk(times, np.zeros((30, 1)), int(times[-1])), int(times[-1]), i)
            recorder.log("device", int(times[0]), node=text, device=text, serial=text)
            recorder.log(text, int(times[0]), **{text: text})
    return path


@pytest.mark.parametrize(
    "arguments",
    [
        ("info",),
        ("info", "--json"),
        ("info", "--all"),
        ("files", "export", "-o", "out.xdf"),
        ("recover",),
        ("recover", "-o", "\x1b[31m"),
    ],
)
def test_what_is_printed_holds_no_control_characters(
    kinegraph: Command, hostile: Path, arguments: tuple[str, ...]
) -> None:
    command = 2 if arguments[0] == "files" else 1
    code, out, err = kinegraph(*arguments[:command], hostile, *arguments[command:])
    assert code == 0, err
    assert not HARMFUL.search(out + err)
    if arguments == ("info",):
        assert "[/red]" in out and "\\x1b[2J" in out and "[bold]x[/bold]" in out


@pytest.mark.parametrize("text", ["no\u202ede", '"\\e[2J"', '"a\\rb"'])
def test_a_graph_is_refused_in_plain_words(kinegraph: Command, tmp_path: Path, text: str) -> None:
    (tmp_path / "graph.yaml").write_text(f"nodes:\n  {text}: {{use: {text}}}\n{text}: 1\nname: {text}\n")
    for command in (("check",), ("draw",), ("run", *QUIET)):
        code, out, err = kinegraph(command[0], "graph.yaml", *command[1:])
        assert code == 2 and not HARMFUL.search(out + err), err


def test_log_lines_are_plain(capsys: pytest.CaptureFixture[str]) -> None:
    from kinegraph.stream.cli.commands import logs

    logs.set_up()
    try:
        structlog.get_logger("x").warning(
            "device \x1b[2J says", text=HOSTILE[2], facts={HOSTILE[2]: [HOSTILE[4], "a\nb"]}
        )
    finally:
        structlog.reset_defaults()
    stderr = capsys.readouterr().err
    assert not HARMFUL.search(stderr) and stderr.count("\n") == 1 and "\\x1b" in stderr


def test_a_panel_shows_texts_as_they_are() -> None:
    file = io.StringIO()
    Screen(file=file).print("[red]x[/red]", "\x1b[2J\x9b1m", "[/nothing]")
    assert file.getvalue().strip() == "[red]x[/red] \\x1b[2J\\x9b1m [/nothing]"


@pytest.mark.parametrize("text", ["=1+1", "+cmd", "-2+3", "@sum(a)", "\t=1", "\n=1", "＝1"])
def test_no_text_is_a_formula(tmp_path: Path, text: str) -> None:
    file = io.StringIO()
    Sheet(file).writerow([text, "plain", "-1.5", -1.5, "+3e-7"])
    (row,) = csv.reader(io.StringIO(file.getvalue(), newline=""))
    assert row == [f"'{text}", "plain", "-1.5", "-1.5", "+3e-7"]


def test_exported_tables_hold_no_formula(kinegraph: Command, hostile: Path, tmp_path: Path) -> None:
    assert kinegraph("files", "export", hostile, "-o", "tables", "--stream", "annotations", "--stream", "=1+1")[0] == 0
    for table in (tmp_path / "tables").iterdir():
        for row in csv.reader(table.read_text().splitlines()):
            assert not [cell for cell in row if cell.startswith("=")]
