"""kinegraph devices and kinegraph record: what is connected, and a recording of it with no graph."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from serial.tools.list_ports_common import ListPortInfo
from usb.backend import libusb1

from kinegraph.devices.commands.devices import devices
from kinegraph.devices.commands.record import with_ports, written
from kinegraph.devices.discovery import finders
from kinegraph.devices.discovery.serial_ports import BLUETOOTH, KNOWN, find
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording


def port(device: str, vid: int | None = None, pid: int | None = None, **given: str) -> ListPortInfo:
    info = ListPortInfo(device)
    info.vid, info.pid = vid, pid
    for name, value in given.items():
        setattr(info, name, value)
    return info


@pytest.fixture
def ports(monkeypatch: pytest.MonkeyPatch) -> None:
    there = [
        port("/dev/ttyUSB1", 0x1A86, 0x7523, description="USB Serial"),
        port(
            "/dev/ttyUSB0", 0x0403, 0x6015, description="FT231X USB UART", serial_number="DM00Q0QM", manufacturer="FTDI"
        ),
        port("/dev/ttyACM0", 0x2341, 0x0043, description="Arduino Uno"),
        port("/dev/ttyACM1", 0x1234, 0x5678, description="Something new"),
        port("/dev/ttyS0"),
        port("/dev/rfcomm0"),
    ]
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: there)


def test_serial_ports_say_what_may_hang_on_them(ports: None) -> None:
    rows = {row.address: row for row in find()}
    assert list(rows) == ["/dev/rfcomm0", "/dev/ttyACM0", "/dev/ttyACM1", "/dev/ttyUSB0", "/dev/ttyUSB1"], (
        "a port without anything is left out"
    )
    assert "OpenBCI Cyton" in rows["/dev/ttyUSB0"].what and "DM00Q0QM" in rows["/dev/ttyUSB0"].what
    assert rows["/dev/ttyUSB0"].yaml == "use: devices.cyton.Cyton\nport: /dev/ttyUSB0"
    assert "Arduino" in rows["/dev/ttyACM0"].what and "AsciiLines" in rows["/dev/ttyACM0"].yaml
    assert rows["/dev/ttyACM1"].what == "Something new"


def test_the_yaml_that_is_shown_can_be_used() -> None:
    for known in [*KNOWN.values(), BLUETOOTH]:
        if known.yaml and "..." not in known.yaml:
            node = "\n".join(f"    {line}" for line in known.yaml.format(port="/dev/ttyUSB7").splitlines())
            assert load_text(f"nodes:\n  device:\n{node}").nodes["device"].specs


def test_what_is_found_is_printed(
    ports: None, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken() -> list[finders.FoundDevice]:
        raise OSError("no such bus")

    monkeypatch.setattr(finders, "finders", lambda: {"bus": broken, "serial": find})
    devices(None, False)
    printed = capsys.readouterr()
    assert "serial: /dev/ttyUSB0" in printed.out and "      use: devices.cyton.Cyton" in printed.out
    assert "bus: could not be asked: OSError: no such bus" in printed.err
    devices(["serial"], True)
    assert json.loads(capsys.readouterr().out)[3]["address"] == "/dev/ttyUSB0"
    with pytest.raises(KinegraphError, match="did you mean 'serial'"):
        devices(["serail"], False)


def test_every_finder_of_the_house_can_be_asked() -> None:
    known = finders.finders()
    assert "serial" in known
    for name, finder in known.items():
        rows, failed = finders.look(finder)
        if name == "usb" and libusb1.get_backend() is None:
            assert "libusb 1.0 is not there; install it" in failed
            continue
        assert not failed, f"{name}: {failed}"
        assert all(row.kind and row.address and row.what for row in rows)


def test_sources_become_a_graph() -> None:
    text, name = written(["a.b.MyBoard", "port=/dev/x", "rate_hz=5", "a.b.MyBoard", "leg:c.D", "names=[l, r]"])
    assert name == "my_board-my_board2-leg"
    assert "my_board: {port: /dev/x, rate_hz: 5, use: a.b.MyBoard}" in text and "names: [l, r]" in text
    for wrong, reported in (
        (["port=x"], "before any source"),
        (["x:a.B", "x:a.C"], "two sources"),
        (["a.B", "k=[1"], "k="),
    ):
        with pytest.raises(KinegraphError, match=reported):
            written(wrong)


def test_a_simulated_device_needs_no_port() -> None:
    given = [
        "devices.cyton.Cyton",
        "daisy=true",
        "b:devices.mti.Mti",
        "port=/dev/x",
        "devices.oak.Oak",
        "devices.nowhere.No",
    ]
    assert with_ports(given) == [*given[:1], "port=simulated", *given[1:]]


def kinegraph(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "kinegraph", *arguments],
        capture_output=True, text=True, timeout=120, stdin=subprocess.DEVNULL, env={**os.environ, "COLUMNS": "160"},
    )  # fmt: skip


def test_a_recording_with_no_graph_can_be_replayed(tmp_path: Path) -> None:
    out = str(tmp_path / "session")
    done = kinegraph("record", "devices.cyton.Cyton", "--simulate", "--for", "2", "-o", out, "--view", "none")
    assert done.returncode == 0, done.stderr
    info = kinegraph("info", out).stdout
    assert "cyton.emg" in info and "simulated_sources cyton" in info
    graph = tmp_path / "graph.yaml"
    graph.write_text(
        "nodes:\n  cyton: {use: devices.cyton.Cyton, port: none}\n"
        "  low: {use: operators.filters.iir.Lowpass, from: cyton.emg, cutoff_hz: 20}\nrecord: [low]\n"
    )
    done = kinegraph("replay", str(graph), out)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("store", [False, True])
def test_images_are_kept_only_if_it_is_said_in_as_many_words(store: bool, tmp_path: Path) -> None:
    flag = ["--store-frames"] if store else []
    done = kinegraph(
        "record",
        "cam:tests.support.camera_part.Camera",
        "frames=20",
        *flag,
        "-o",
        str(tmp_path / "s"),
        "--view",
        "none",
    )
    assert done.returncode == 0 and ("images of cam.depth are not kept" in done.stderr) is not store, done.stderr
    with Recording.open(tmp_path / "s") as recording:
        assert recording.streams["cam.depth"].samples == 20
        if store:
            assert recording.read("cam.depth")[1][:, 5, 7].tolist() == list(range(1, 21))
        else:
            assert recording.streams["cam.depth"].kept == "outline"


@pytest.mark.parametrize(
    ("arguments", "message", "code"),
    [
        (["devices.cyton.Cyten"], "did you mean 'Cyton'", 2),
        (["devices.cyton.Cyton"], "port is missing", 2),
        (["devices.cyton.Cyton", "port=/dev/ttyNOTTHERE", "deadline_s=1"], "does not exist", 3),
        (["devices.cyton.Cyton", "port=/dev/ttyUSB0", "--store-frames"], "these sources give no images", 2),
        (["devices.cyton.Cyton", "port=/dev/ttyNOTTHERE", "--for", "1"], "--simulate", 3),
        (
            ["devices.cyton.Cyton", "prot=/dev/ttyUSB0"],
            "kinegraph: node 'cyton': Cyton has no parameter 'prot'; did you mean 'port'",
            2,
        ),
    ],
)
def test_what_is_wrong_is_told(arguments: list[str], message: str, code: int, tmp_path: Path) -> None:
    done = kinegraph("record", *arguments, "-o", str(tmp_path / "s"), "--view", "none")
    assert done.returncode == code and message in done.stderr, done.stderr
