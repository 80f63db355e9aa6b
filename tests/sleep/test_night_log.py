"""The night's log: epoch by epoch on the disk, over kill -9, a full disk and a restart; nights begin, end and are deleted."""

from __future__ import annotations

import errno
import io
import os
from itertools import chain
from pathlib import Path
from typing import Any

import pytest

from kinegraph.devices.reports.night import archive
from kinegraph.devices.reports.night.numbers import quality, table
from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import InputError, KinegraphError, ParameterError
from kinegraph.stream.system.clock import SessionClock
from tests.support import night_made
from tests.support.command_line import Command
from tests.support.night_made import LATE, SPECS, Night, feed, logged, opened, states


@pytest.mark.parametrize("at", [170, 241, 465])
def test_nothing_is_lost_or_doubled_by_kill_9(tmp_path: Path, at: int) -> None:
    """The checkpoint is ten epochs old when the process is killed; a row is torn by the power cut."""
    night, log = Night(), opened(tmp_path, report=False)
    log.begin()
    feed(log, night.chunks(0, at - 10))
    checkpoint = log.snapshot()
    feed(log, night.chunks(at - 10, at))
    assert log.runtime.writer and log.runtime.writer.night
    folder = log.runtime.writer.night.folder
    before = logged(folder)
    with (folder / archive.EPOCHS).open("a") as file:
        file.write("2026-01-01T0")
    os.close(log.runtime.writer.night.file._handle)
    log.runtime.lock.release()  # type: ignore[union-attr]

    again = opened(tmp_path, report=False)
    again.restore(checkpoint)
    clock = SessionClock()
    clock.utc_ns = night.onset(at + 2)
    again.keep_time(clock)
    again.begin()
    assert logged(folder) == before
    feed(again, night.chunks(at - 10, at))  # what is worked through again
    assert logged(folder) == before
    feed(again, chain(night.chunks(at), night.end()))
    again.close()
    assert logged(folder) == states(night, night.inn)
    facts = archive.Facts.load(folder)
    assert facts.closed and facts.breaks == [[night.onset(at - LATE), night.onset(at + 2)]]


def test_a_restart_without_resume_goes_on_with_the_night(tmp_path: Path) -> None:
    night, log = Night(), opened(tmp_path, report=False)
    log.begin()
    feed(log, night.chunks(0, 200))
    log.close()
    (folder,) = (path for path, _ in archive.nights(tmp_path))
    assert not archive.Facts.load(folder).closed
    again = opened(tmp_path, report=False)
    clock = SessionClock()
    clock.utc_ns = night.onset(220)
    again.keep_time(clock)
    again.begin()
    feed(again, chain(night.chunks(220), night.end()))
    again.close()
    assert len(archive.nights(tmp_path)) == 1
    facts = archive.Facts.load(folder)
    assert facts.breaks == [[night.onset(197), night.onset(220)]]
    assert "kinegraph did not run" in dict(quality(facts, archive.read_epochs(folder)))


def test_a_night_that_is_ahead_of_the_clock_is_left_as_it_is(tmp_path: Path) -> None:
    """A simulated night goes faster than time: the next one has the same hours. It is killed, and goes on, too."""
    night_made.whole(tmp_path, report=False)
    night, log, clock = Night(seed=9), opened(tmp_path, report=False), SessionClock()
    clock.utc_ns = night.onset(0)
    log.keep_time(clock)
    log.begin()
    feed(log, night.chunks(0, 200))
    checkpoint = log.snapshot()
    feed(log, night.chunks(200, 220))
    log.close()
    again = opened(tmp_path, report=False)
    again.restore(checkpoint)
    clock.utc_ns = night.onset(3)  # it goes faster than time
    again.keep_time(clock)
    again.begin()
    feed(again, chain(night.chunks(200), night.end()))
    again.close()
    (first, _), (second, facts) = archive.nights(tmp_path)
    assert logged(first) == states(Night(), night.inn) and logged(second) == states(night, night.inn)
    assert (second.name, facts.closed) == ("2025-12-31-2", True)


def test_what_was_final_is_never_changed(tmp_path: Path) -> None:
    night, log = Night(), opened(tmp_path, report=False)
    log.begin()
    feed(log, night.chunks(0, 200))
    before = (tmp_path / "2025-12-31" / archive.EPOCHS).read_bytes()
    other = Night(seed=9)
    feed(log, other.chunks(0, 200))
    assert (tmp_path / "2025-12-31" / archive.EPOCHS).read_bytes() == before
    log.close()


def test_rows_wait_while_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    night, log = Night(), opened(tmp_path, report=False)
    log.begin()
    feed(log, night.chunks(0, 100))
    write, full = os.pwrite, True

    def pwrite(handle: int, data: bytes, offset: int) -> int:
        if full:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(handle, data, offset)

    monkeypatch.setattr(os, "pwrite", pwrite)
    feed(log, night.chunks(100, 250))
    folder = tmp_path / "2025-12-31"
    assert len(logged(folder)) == 100 - LATE - night.inn
    full = False
    assert log.runtime.writer and log.runtime.writer.night
    log.runtime.writer.night.file._retry_at = 0.0
    feed(log, chain(night.chunks(250), night.end()))
    log.close()
    assert logged(folder) == states(night, night.inn)


def test_a_night_that_ends_while_the_disk_is_full_gets_its_numbers_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    night, log = Night(), opened(tmp_path, report=False)
    log.begin()
    feed(log, night.chunks(0, 400))
    save, full = archive.Facts.save, True

    def saved(facts: archive.Facts, folder: Path) -> None:
        if full:
            raise OSError(errno.ENOSPC, "No space left on device")
        save(facts, folder)

    monkeypatch.setattr(archive.Facts, "save", saved)
    feed(log, chain(night.chunks(400), night.end()))
    ((_, facts),) = archive.nights(tmp_path)
    assert not facts.closed and not facts.numbers
    full = False
    log.process("epochs", night.final(night.n - 1, night.onset(night.n + 1)))  # known already, but time goes on
    log.process("epochs", night_made.event(night_made.EPOCH, night.onset(night.n), night.onset(night.n), night.onset(night.n + 1),
                                           "wake", 0.2, 0.0, True, False))  # fmt: skip
    log.close()
    ((_, facts),) = archive.nights(tmp_path)
    assert facts.closed and facts.numbers["awakenings"] == 11


def test_a_night_that_is_deleted_while_it_goes_on_goes_on_in_another_folder(tmp_path: Path) -> None:
    night, log = Night(), opened(tmp_path)
    log.begin()
    feed(log, night.chunks(0, 300))
    archive.remove(tmp_path / "2025-12-31")
    feed(log, chain(night.chunks(300), night.end()))
    log.close()
    ((folder, facts),) = archive.nights(tmp_path)
    assert logged(folder) == states(night, 300 - LATE) and facts.begun == night.onset(300 - LATE)
    assert facts.closed and not facts.numbers  # they would tell of what was deleted
    assert "broken off" in (folder / "report.html").read_text()


def test_nights_are_separated_and_old_ones_deleted(tmp_path: Path) -> None:
    log = opened(tmp_path, report=False, keep_days=2.0)
    log.begin()
    (tmp_path / "mine").mkdir()
    for day in range(4):
        night = Night(n=160, out=140)
        for port, chunk in chain(night.chunks(), night.end()):
            shift = day * 86_400 * NS
            chunk.time = chunk.time + shift
            if chunk.data.dtype.names:
                for name in {"onset", "end"} & set(chunk.data.dtype.names):
                    chunk.data[name] += shift
            log.process(port, chunk)
    log.close()
    assert [path.name for path, _ in archive.nights(tmp_path)] == ["2026-01-02", "2026-01-03"]
    assert (tmp_path / "mine").is_dir()
    (first, _), (second, _) = archive.nights(tmp_path)
    assert logged(first) == logged(second)


def test_an_empty_bed_is_no_night(tmp_path: Path) -> None:
    night, log = Night(), opened(tmp_path, report=False)
    night.bed[:] = "out"
    log.begin()
    feed(log, night.chunks())
    log.close()
    assert archive.nights(tmp_path) == []


def test_two_short_times_in_bed_far_apart_are_two_nights(tmp_path: Path) -> None:
    night, log = Night(n=700), opened(tmp_path, report=False)
    night.bed[:] = "out"
    night.bed[50:60] = night.bed[600:690] = "in"
    log.begin()
    feed(log, night.chunks())
    log.close()
    assert [path.name for path, _ in archive.nights(tmp_path)] == ["2025-12-31", "2025-12-31-2"]


def test_actigraphy_alone_makes_a_night(tmp_path: Path) -> None:
    log = opened(tmp_path, ("epochs", "nights", "lights"), report=False)
    night = Night(n=200, out=180)
    log.begin()
    feed(log, chain(night.chunks(), night.end()))
    log.close()
    (folder,) = (path for path, _ in archive.nights(tmp_path))
    assert logged(folder) == states(night) and archive.Facts.load(folder).closed


def test_the_command_lists_draws_and_deletes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from kinegraph.stream.cli.main import call

    def run(*words: str, code: int = 0) -> str:
        ended = 0
        try:
            call("sleep nights", [*words, "--path", str(tmp_path)])
        except SystemExit as end:
            ended = int(end.code or 0)
        assert ended == code
        return capsys.readouterr().out

    night_made.whole(tmp_path, report=False, ports=("epochs", "nights"))
    assert "2025-12-31" in run() and "1 night in" in run("list")
    assert "report.html" in run("report", "last")
    with pytest.raises(KinegraphError, match="2025-12-31"):
        call("sleep nights", ["delete", "2025-12-30", "--path", str(tmp_path)])
    with pytest.raises(KinegraphError, match="name the night"):
        call("sleep nights", ["delete", "--path", str(tmp_path)])
    monkeypatch.setattr("sys.stdin", io.StringIO())
    with pytest.raises(KinegraphError, match="no terminal to ask for confirmation, so 2025-12-31 stays; --yes"):
        call("sleep nights", ["delete", "last", "--path", str(tmp_path)])
    assert (tmp_path / "2025-12-31").is_dir()
    run("delete", "last", "--yes")
    assert not (tmp_path / "2025-12-31").exists()


def test_a_night_that_cannot_be_read_can_be_deleted_and_is_forgotten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from kinegraph.devices.commands.nights import Action, nights

    for name, file in (("2025-01-01", archive.FACTS), ("2025-01-02", archive.EPOCHS), ("2025-01-03", archive.EPOCHS)):
        (tmp_path / name).mkdir()
        (tmp_path / name / file).write_text("onset,en")
    nights(path=tmp_path)
    assert "2025-01-01: cannot be read" in capsys.readouterr().out
    nights(Action.delete, ["2025-01-01"], tmp_path, True)
    os.utime(tmp_path / "2025-01-02", (1, 1))
    night, log = Night(n=160, out=140), opened(tmp_path, report=False, keep_days=2.0)
    log.begin()
    feed(log, chain(night.chunks(), night.end()))
    log.close()
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_dir()) == ["2025-01-03", "2025-12-31"]


def test_an_old_night_that_cannot_be_deleted_ends_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    night, log = Night(n=160, out=140), opened(tmp_path, report=False, keep_days=0.01)

    def refused(folder: Path) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(archive.shutil, "rmtree", refused)
    log.begin()
    feed(log, chain(night.chunks(), night.end()))
    log.close()
    ((_, facts),) = archive.nights(tmp_path)
    assert facts.closed and facts.numbers


def test_only_a_night_is_deleted(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    with pytest.raises(KinegraphError, match="no night"):
        archive.remove(tmp_path / "photos")
    assert (tmp_path / "photos").is_dir()


@pytest.mark.parametrize(
    ("ports", "more", "error"),
    [
        (tuple(SPECS), {"timezone": "Europe/Bonn"}, ParameterError),
        (("epochs", "nights"), {"path": "/dev/null/nights"}, ParameterError),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(
    tmp_path: Path, ports: tuple[str, ...], more: dict[str, Any], error: type[Exception]
) -> None:
    from kinegraph.devices.reports.night import NightLog

    given = {"path": str(tmp_path), **more}
    with pytest.raises(error):
        NightLog(**given).open({port: SPECS[port] for port in ports})
    with pytest.raises(InputError):
        NightLog(path=str(tmp_path)).open({"epochs": SPECS["bed"], "nights": SPECS["nights"]})


def test_the_lights_end_a_night_though_somebody_stays_in_bed(tmp_path: Path) -> None:
    """What follows is no night of its own; the next one begins when the bed was left in between."""
    night, log = Night(n=300, out=280), opened(tmp_path, report=False)
    night.bed[150:280] = "in"
    log.begin()
    feed(log, night.chunks(0, 200))
    log.process("lights", night_made.event(SPECS["lights"].dtype, night.onset(200), True))
    (row,) = (chunk for port, chunk in night.end() if port == "nights")
    row.data["end"], row.data["estimated"], row.data["bed"] = night.onset(190), False, "lights"
    log.process("nights", row)
    feed(log, night.chunks(200))
    ((folder, facts),) = archive.nights(tmp_path)
    assert facts.closed and facts.switched == [[night.onset(200), "lights on"]]
    assert len(logged(folder)) == 200 - LATE - night.inn
    rows = {r.name: r for r in table(facts, archive.read_epochs(folder))}
    assert "Sleep onset latency (SOL)" in rows and rows["Time in bed (TIB)"].meaning == "lights off to lights on"
    later = Night(n=2000, inn=1800, out=1990)
    feed(log, later.chunks(1790, 1900))
    log.close()
    assert len(archive.nights(tmp_path)) == 2


def test_two_sleepers_have_a_night_each_in_one_folder(tmp_path: Path) -> None:
    logs = {name: opened(tmp_path, report=False, sleeper=name) for name in ("left", "right")}
    for log in logs.values():
        log.begin()
    for name, night in (("left", Night(n=120, out=110)), ("right", Night(n=120, inn=60, out=110))):
        for port, chunk in chain(night.chunks(), night.end()):
            if "sleeper" in (chunk.data.dtype.names or ()):
                chunk.data["sleeper"] = name
                for log in logs.values():
                    log.process(port, chunk)
            else:
                logs[name].process(port, chunk)
    for log in logs.values():
        log.close()
    (_, left), (right_folder, right) = archive.nights(tmp_path)
    assert (left.sleeper, right.sleeper) == ("left", "right") and left.begun < right.begun
    assert len(logged(right_folder)) == 40 and right.closed  # not seen before


def test_a_night_that_begins_while_the_disk_is_full_is_written_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    night, log = Night(), opened(tmp_path, report=False)
    log.begin()
    mkdir, full = Path.mkdir, [True]

    def refusing(path: Path, *args: Any, **more: Any) -> None:
        if full[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        mkdir(path, *args, **more)

    monkeypatch.setattr(Path, "mkdir", refusing)
    feed(log, night.chunks(0, 120))
    assert archive.nights(tmp_path) == []
    full[0] = False
    feed(log, chain(night.chunks(120), night.end()))
    log.close()
    assert logged(tmp_path / "2025-12-31") == states(night, night.inn)


def test_one_damaged_night_hides_no_other(kinegraph: Command, tmp_path: Path) -> None:
    """A byte in a table, or in the facts, of one night: the others are listed all the same."""
    for k, (name, damage) in enumerate((("2024-05-01", b""), ("2024-05-02", b"\xff"), ("2024-05-03", b""))):
        folder = tmp_path / "nights" / name
        folder.mkdir(parents=True)
        facts = archive.Facts(name, 1_714_600_000 * NS + k * 86_400 * NS, 30.0)
        facts.save(folder)
        row = b"2024-05-01T22:00:00Z,2024-05-01T22:00:30Z,sleep,sleep,0,0.5,1,in,2,1,,14,0.9\n"
        (folder / archive.EPOCHS).write_bytes((",".join(archive.COLUMNS) + "\n").encode() + damage + row)
    (tmp_path / "nights" / "2024-05-03" / archive.FACTS).write_text(
        '{"version": 1, "name": "x", "begun": "x", "epoch_s": 30}'
    )
    code, out, _ = kinegraph("sleep", "nights")
    assert code == 0 and "2024-05-01" in out and "2024-05-02" in out and "damaged" in out
    assert "2024-05-03: cannot be read" in out


def test_an_epoch_whose_movement_was_withdrawn_says_that_there_was_a_second_body(tmp_path: Path) -> None:
    night, log = Night(), opened(tmp_path, report=False)
    log.begin()
    scored = 100
    feed(log, night.chunks(0, scored + LATE))
    night.state[scored], night.moved[scored] = "unknown", float("nan")
    feed(log, chain(night.chunks(scored + LATE), night.end()))
    log.close()
    ((folder, _),) = archive.nights(tmp_path)
    epochs = archive.read_epochs(folder)
    at = epochs.onset.tolist().index(night.onset(scored))
    why = epochs.texts["why"]
    assert (epochs.texts["state"][at], why[at]) == ("unknown", "body") and (why == "body").sum() == 1
