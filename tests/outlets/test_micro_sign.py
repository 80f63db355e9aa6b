"""People read µV, in every table, line and message; files and JSON hold uV."""

from __future__ import annotations

import json

import pytest

from kinegraph.devices.page.transfer.catalogue import described
from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.recording.series import Series, write_recording
from kinegraph.stream.text.safe_text import plain_log, say
from kinegraph.stream.text.screen import Screen
from tests.support.command_line import Command, kinegraph  # noqa: F401
from tests.support.emg_run import stamps

SPEC = StreamSpec((2,), rate_hz=1000.0, channels=("TA", "SO"), units=("uV",))


def test_lines_tables_and_log_lines_have_the_micro_sign(capsys: pytest.CaptureFixture[str]) -> None:
    say("noise of 12 uV in emg_uV")
    Screen().print("rest (uV)")
    printed = capsys.readouterr().out
    assert printed == "noise of 12 µV in emg_uV\nrest (µV)\n"
    assert plain_log(None, "", {"event": "10 uV", "n": 3}) == {"event": "10 µV", "n": 3}


def test_the_page_shows_the_micro_sign_and_keeps_units_of_length() -> None:
    info = described("board.emg", SPEC)
    assert info["units"] == ["µV", "µV"] and "µV" in info["describe"]
    assert described("markers", StreamSpec((4, 3), units=("mm",)))["units"] == ["mm"]


def test_info_prints_the_micro_sign_and_its_json_the_units_of_the_file(kinegraph: Command, tmp_path) -> None:  # noqa: F811
    import numpy as np

    write_recording(tmp_path / "emg.mcap", [Series("board.emg", SPEC, stamps(1000), np.ones((1000, 2)))], {})
    _, printed, _ = kinegraph("info", tmp_path / "emg.mcap")
    assert "µV" in printed and "uV" not in printed
    _, printed, _ = kinegraph("info", tmp_path / "emg.mcap", "--json")
    assert "uV" in json.dumps(json.loads(printed))
