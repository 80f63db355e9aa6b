"""Simulated devices: the cable that is pulled out, misbehaviour in the stated shares, the command, a whole graph with --simulate."""

from __future__ import annotations

import gc
import re
import signal
import subprocess
import sys
import threading
import tracemalloc
from collections.abc import Iterator
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.cyton.simulator import CytonModel
from kinegraph.devices.cyton.source import Cyton
from kinegraph.devices.simulation.cable import PseudoTerminal, TcpLine, line_at
from kinegraph.devices.simulation.catalogue import find, named
from kinegraph.devices.simulation.fault_injection import FaultInjection, FaultInjector
from kinegraph.devices.simulation.serve import Server
from kinegraph.devices.transport.transport import connect
from kinegraph.stream.errors import DeviceError, KinegraphError
from tests.support.command_line import Command, kinegraph
from tests.support.device_feed import reading, wait_for
from tests.support.pose_model import pose_network_or_skip

__all__ = ["kinegraph"]
HOUSE = Path(__file__).resolve().parents[2]
CONFIGS = HOUSE / "configs"


class Ticking:
    """A device that says a packet of its own number every 2 ms."""

    def __init__(self) -> None:
        self.sent = 0

    def receive(self, data: bytes) -> bytes:
        return data.upper()

    def say(self, seconds: float) -> list[bytes]:
        first, self.sent = self.sent, int(seconds * 500)
        return [f"<{i:06d}>".encode() for i in range(first, self.sent)]

    def restart(self) -> None:
        self.sent = 0


@pytest.mark.parametrize("address", ["", "tcp://127.0.0.1:0"])
def test_both_ends_of_the_cable(address: str) -> None:
    class Quiet(Ticking):
        def say(self, seconds: float) -> list[bytes]:
            return []

    every_byte = bytes(b for b in range(256) if not 97 <= b <= 122)
    with Server(Quiet(), line_at(address)) as server, connect(server.address) as link:
        link.write(every_byte + b"abc")
        came = b""
        while len(came) < len(every_byte) + 3:
            came += link.read(2.0)
    assert came == every_byte + b"ABC"


@pytest.mark.parametrize("patient", [True, False])
def test_what_a_busy_host_does_not_fetch_waits_only_at_a_patient_cable(patient: bool) -> None:
    sent, came = bytes(range(256)) * 200, b""
    line = PseudoTerminal(patient=patient)
    with connect(line.address) as link:
        link.write(b"go")
        assert line.read(2.0) == b"go"
        line.write(sent)
        while more := link.read(0.2):
            came += more
            line.write(b"")
    line.close()
    assert (came == sent) == patient and sent.startswith(came)


@pytest.mark.parametrize("address", ["", "tcp://127.0.0.1:0"])
def test_a_cable_can_be_pulled_out_and_put_in_again(address: str) -> None:
    with Server(Ticking(), line_at(address)) as server:
        for _ in range(3):
            with connect(server.address) as link:
                assert link.read(2.0)
                server.unplug()
                with pytest.raises(DeviceError):
                    while True:
                        link.read(2.0)
            with pytest.raises(DeviceError):
                connect(server.address)
            server.plug()


class Steady(CytonModel):
    """Its packets are all alike, so that no signal is made, of which the most recent parts would be kept."""

    def counts(self, number: int) -> np.ndarray:
        return np.zeros(8)


@pytest.mark.nightly
def test_pulled_out_a_hundred_times_in_mid_packet_nothing_leaks() -> None:
    """In a process of its own: threads, handles and memory of other tests come and go as they like."""
    process = get_context("spawn").Process(target=pull_out_a_hundred_times)
    process.start()
    process.join(280)
    assert process.exitcode == 0


def pull_out_a_hundred_times() -> None:
    """The source raises, lets go of everything and can be opened again; threads, handles and memory stay as they were."""

    def usage() -> tuple[int, int, int]:
        gc.collect()
        return threading.active_count(), len(list(Path("/proc/self/fd").iterdir())), tracemalloc.get_traced_memory()[0]

    before = (0, 0, 0)
    tracemalloc.start()
    with Server(Steady(), line_at()) as server:
        for turn in range(100):
            pull_out(server)
            if turn == 20:
                before = usage()
        after = usage()
    assert after[:2] == before[:2], f"{before} then {after}"
    assert after[2] - before[2] < 100_000, f"{after[2] - before[2]} bytes kept after 79 more times"


def pull_out(server: Server) -> None:
    """Open the source, pull the cable out in mid-packet, put it in again. What was read (more, where the machine is slow) is forgotten."""
    with reading(Cyton(server.address)) as feed:
        wait_for(lambda: feed.error is not None or feed.count("emg") >= 3, 60.0)
        assert feed.error is None, feed.error
        server.unplug()
        wait_for(lambda: feed.error is not None, 60.0)
    assert isinstance(feed.error, DeviceError) and "gone" in str(feed.error)
    server.plug()


def test_misbehaviour_has_the_stated_shares_and_is_the_same_for_a_seed() -> None:
    packets = [i.to_bytes(4, "big") for i in range(20_000)]
    of = FaultInjection(lose=0.1, duplicate=0.05, corrupt=0.02, seed=3)
    injector = FaultInjector(of)
    sent = injector.spoil(packets, 1.0)
    assert sent == FaultInjector(of).spoil(packets, 1.0)
    assert sent != FaultInjector(FaultInjection(lose=0.1, duplicate=0.05, corrupt=0.02, seed=4)).spoil(packets, 1.0)
    assert injector.lost == pytest.approx(2000, abs=200)
    assert injector.duplicated == pytest.approx(900, abs=120)
    assert injector.corrupted == pytest.approx(360, abs=70)
    assert len(sent) == len(packets) - injector.lost + injector.duplicated
    assert FaultInjector(FaultInjection()).spoil(packets, 1.0) == packets
    assert FaultInjector(FaultInjection(lose=1.0, from_s=2.0)).spoil(packets, 1.9) == packets


def test_stalls_and_pulled_cables_come_when_they_are_due() -> None:
    injector = FaultInjector(
        FaultInjection(stall_every_s=2.0, stall_s=0.5, unplug_every_s=3.0, unplug_s=1.0, reset_every_s=4.0, from_s=1.0)
    )
    seconds = np.arange(0, 9, 0.25)
    assert [s for s in seconds if injector.stalled(s)] == [3.0, 3.25, 5.0, 5.25, 7.0, 7.25]
    assert [s for s in seconds if injector.unplugged(s)] == [4.0, 4.25, 4.5, 4.75, 7.0, 7.25, 7.5, 7.75]
    assert [injector.resets(s) for s in (0.0, 4.9, 5.0, 9.0)] == [0, 0, 1, 2]


def test_a_cable_that_is_pulled_out_by_itself_comes_back() -> None:
    wrong = FaultInjection(unplug_every_s=0.5, unplug_s=0.2)
    with Server(CytonModel(), line_at(), wrong) as server:
        for _ in range(2):
            with reading(_when_there(server)) as feed:
                wait_for(lambda feed=feed: feed.error is not None)


def _when_there(server: Server) -> Cyton:
    wait_for(lambda: Path(server.address).exists())
    return Cyton(server.address)


def test_nobody_reading_does_not_hold_a_device_up() -> None:
    brain = Ticking()
    with Server(brain, PseudoTerminal()):
        wait_for(lambda: brain.sent > 300)
    line = TcpLine()
    line.write(b"unread")
    line.close()


def test_an_address_that_cannot_be_served() -> None:
    with pytest.raises(DeviceError, match="write tcp://host:port"):
        line_at("127.0.0.1")
    with Server(Ticking(), TcpLine()) as server, pytest.raises(DeviceError, match="cannot be served"):
        line_at(server.address)


def test_simulators_are_found_by_name() -> None:
    assert find("cyton") is named()["cyton"] is find("devices.cyton.simulator.SimulatedCyton")
    with pytest.raises(KinegraphError, match="did you mean 'cyton'"):
        find("cyten")
    with pytest.raises(KinegraphError, match="cannot be imported"):
        find("no_such_lab.Board")
    for name, kind in named().items():
        assert kind.__doc__, name


def test_the_command_prints_an_address_that_can_be_opened() -> None:
    command = [sys.executable, "-m", "kinegraph", "dev", "simulate", "cyton", "daisy=true", "lose=0.1", "seed=2"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout
        address = process.stdout.readline().strip()
        try:
            with reading(Cyton(address, daisy=True)) as feed:
                wait_for(lambda: feed.count("emg") >= 50)
        finally:
            process.send_signal(signal.SIGINT)
        assert process.wait(100) == 0
    assert feed.lost("emg") and not Path(address).exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["cyten"], "did you mean 'cyton'"),
        (["cyton", "loose=1"], "did you mean 'lose'"),
        (["cyton", "lose=2"], "lose is 2; it must be at least 0 and at most 1"),
        (["cyton", "daisy"], "PARAMETER=VALUE"),
        (["cyton", "--at", "here"], "write tcp://host:port"),
        (["trigno", "reset_every_s=5"], "reset_every_s is 5; it must be 0, as its samples have no counter"),
        (["lsl", "corrupt=0.1"], "TCP, which lets no changed byte pass"),
        (["lines", "columns=[emg]", "reset_every_s=5"], "neither a time nor a counter"),
    ],
)
def test_the_command_tells_what_is_wrong(kinegraph: Command, arguments: list[str], message: str) -> None:
    code, _, complaint = kinegraph("dev", "simulate", *arguments)
    assert code in (2, 3) and message in " ".join(complaint.split())


def test_the_command_lists_what_there_is(kinegraph: Command) -> None:
    assert "cyton" in kinegraph("dev", "simulate")[1]


def inputs_of(info: str) -> dict[str, list[str]]:
    """The rows of the inputs that `kinegraph info` prints, by their names."""
    return {line.split()[0]: line.split() for line in info.splitlines() if " input " in line}


def test_a_whole_session_outlives_a_pulled_cable(
    kinegraph: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The graph goes on, the source is opened again, and what is missing is marked in the recording and counted."""
    out, brain = tmp_path / "session", CytonModel()
    with Server(brain, line_at(name="ttyCYTON")) as server:
        command = [
            sys.executable,
            "-m",
            "kinegraph",
            "run",
            str(CONFIGS / "cyton_emg.yaml"),
            "--set",
            f"board.port={server.address}",
        ]
        command += ["--for", "9", "-o", str(out), "--view", "none"]
        with subprocess.Popen(command, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True) as process:
            wait_for(lambda: brain._number > 500, 120.0)
            server.unplug()
            wait_for(lambda: not Path(server.address).exists())
            server.plug()
            _, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    assert "source failed" in errors and "is gone" in errors and "source reopened" in errors
    monkeypatch.setenv("COLUMNS", "160")
    rows = inputs_of(kinegraph("info", out)[1])
    assert int(rows["board.emg"][2]) > 700 and int(rows["board.emg"][6]) == 1, "one gap"


IDENTIFIED = {
    "cyton_emg": "device board: OpenBCI Cyton, port ",
    "bitalino_emg": "firmware BITalino_v5.2, battery_v 3.9",
    "imu_steps": "serial 03700001, firmware 1.8.2",
    "shimmer_emg": "device shimmer: Shimmer3, port ",
    "trigno_emg": "device trigno: Delsys Trigno, port ",
    "lsl_emg": "LSL stream, name ",
    "depth_view": "device camera: OAK",
    "body_markers": "device camera: OAK",
    "avatar": "device camera: OAK",
    "dualsense": "device controller: USB device, usb 054c:0ce6",
}
"""What `kinegraph info` says of the device, by the configuration that it was recorded with."""


def simulated() -> Iterator[Any]:
    """Configurations that run without hardware; nightly those of which others use every device."""
    texts = {path: path.read_text(encoding="utf-8") for path in sorted(CONFIGS.glob("*.yaml"))}
    used = set[str]()
    for path in sorted(texts, key=lambda path: (path.stem not in IDENTIFIED, path)):
        if "--simulate" in texts[path]:
            devices = set(re.findall(r"use: (devices\.[\w.]+)", texts[path]))
            is_new = path.stem in IDENTIFIED or not devices <= used
            used |= devices
            yield pytest.param(path, id=path.stem, marks=[] if is_new else pytest.mark.nightly)


@pytest.mark.parametrize("config", list(simulated()))
def test_a_config_runs_without_hardware(
    config: Path, kinegraph: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Through the real transport; every source's first output has brought samples, and nothing was lost."""
    if "devices.oak" in config.read_text(encoding="utf-8") and find_spec("depthai") is None:
        pytest.skip("depthai is not installed (pip install 'kinegraph[oak]')")
    if "pose_network" in config.read_text(encoding="utf-8") and "needed: false" not in config.read_text(
        encoding="utf-8"
    ):
        pose_network_or_skip()
    monkeypatch.setenv("COLUMNS", "160")
    keep = ("--set", "recording.rolling=false")
    for seconds in (2, 30):  # where nothing has come in two seconds: a busy machine takes longer to open a camera
        words = ("--simulate", "--for", seconds, "-o", f"session{seconds}", "--view", "none", *keep)
        code, _, complaint = kinegraph("run", config, *words)
        no_broker = (
            "not delivered: home: the MQTT broker" in complaint
        )  # there is none, and a first state may fall into the two seconds
        assert code == (5 if no_broker else 0), complaint
        info = kinegraph("info", f"session{seconds}")[1]
        assert "simulated_sources" in info
        rows = inputs_of(info)
        if has_samples := any(int(row[2]) > 0 for name, row in rows.items() if name != "annotations"):
            break
    assert has_samples, info
    if config.stem in IDENTIFIED:
        assert IDENTIFIED[config.stem] in info
