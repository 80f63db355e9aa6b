"""Any board that BrainFlow knows, as one source; extra `boards`."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from kinegraph.devices.clocks import line_below
from kinegraph.devices.clocks.clock_log import ClockLog
from kinegraph.devices.clocks.device_clock import ClockState
from kinegraph.devices.clocks.pace import DevicePace
from kinegraph.devices.clocks.packet_clock import PacketClock
from kinegraph.devices.clocks.stamps import chunks
from kinegraph.devices.clocks.timing import timing_chunk, timing_spec
from kinegraph.stream.chunk import Array, Chunk, Specs, StreamSpec, Times
from kinegraph.stream.errors import DeviceError, ParameterError, nearest
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source, outputs_by_parameters
from kinegraph.stream.system.extras import optional

POLL_S = 0.01
PRESETS = {"default": 0, "auxiliary": 1, "ancillary": 2}
KINDS = ("eeg", "emg", "ecg", "eog", "eda", "ppg", "accel", "gyro", "magnetometer", "rotation", "optical", "temperature", "resistance", "analog", "other")  # fmt: skip  # noqa: E501
MICROVOLTS = {"eeg", "emg", "ecg", "eog"}
"""What BrainFlow gives in uV on every board; of all else it does not say the unit."""
COUNTED = {-1: 8, 0: 8}
"""Boards with a package number that counts rows, and its bits: the synthetic one, the Cyton. Of all others rows are counted."""


def library() -> Any:
    """brainflow.board_shim; raises DeviceError that says how to install it."""
    return optional("brainflow.board_shim", "a board of BrainFlow's", "pip install 'kinegraph[boards]'", DeviceError)


@dataclass(frozen=True, slots=True)
class BrainflowBoard(Source):
    """A board through BrainFlow: OpenBCI, Muse, g.tec, BrainBit, ANT, and its synthetic and playback boards. A preset is a node.

    out       (c,) float64 at the board's rate: the channels of `kinds`, in the order of BrainFlow's rows; eeg, emg, ecg, eog in uV,
              all else in units that BrainFlow does not state
    markers   (1,) float64, irregular: what `insert_marker` of another program or the board itself marked
    timing    an event per read: the last row's number, the device's time by it, arrival, stamp

    BrainFlow hands over rows in bursts, with the time of their arrival; stamps come from counting rows, or from the package number where
    it counts them (Cyton, synthetic), which also tells losses. A playback does not repeat the markers of its file.
    """

    board: str = param(help="BrainFlow's name of the board (CYTON_BOARD, MUSE_2_BOARD, SYNTHETIC_BOARD) or its number")
    kinds: tuple[str, ...] = param((), help="kinds of channel: eeg, emg, accel, ...; left out: all that the board has")
    preset: Literal["default", "auxiliary", "ancillary"] = param("default", help="which of the board's streams")
    serial_port: str = param("", help="of the board or its dongle")
    mac_address: str = param("", help="of a Bluetooth board")
    ip_address: str = param("", help="of a network board")
    ip_port: int = param(0, least=0, most=65535, help="of a network board")
    serial_number: str = param("", help="which board, where several are in reach")
    other_info: str = param("", help="what else BrainFlow needs to know of this board")
    file: Path | None = param(None, help="the recording that PLAYBACK_FILE_BOARD plays")
    master_board: str = param("", help="the board that made the recording, or that streams")
    config: str = param("", help="sent to the board before it streams, as BrainFlow's config_board")
    latency_s: float = param(
        0.0, least=0, most=1, help="the constant delay from the measurement to BrainFlow, if you know it"
    )

    @outputs_by_parameters("out", "markers", "timing")
    def outputs(self) -> tuple[str, ...]:
        return ("out", "markers", "timing") if self.preset == "default" else ("out", "timing")

    def number(self, name: str, parameter: str) -> int:
        """A board's number; raises ParameterError."""
        if name.lstrip("-").isdigit():
            return int(name)
        boards = library().BoardIds.__members__
        if name not in boards:
            raise ParameterError(parameter, name, f"one of BrainFlow's boards; {nearest(name, boards)}")
        return int(boards[name].value)

    def description(self) -> dict[str, Any]:
        """What BrainFlow says of the board; raises ParameterError."""
        shim = library()
        number = self.number(self.master_board or self.board, "master_board" if self.master_board else "board")
        try:
            found: dict[str, Any] = shim.BoardShim.get_board_descr(number, PRESETS[self.preset])
        except shim.BrainFlowError as error:
            raise ParameterError("preset", self.preset, f"one that {self.board} has ({error})") from None
        return found

    def rows(self, described: dict[str, Any]) -> list[tuple[int, str, str]]:
        """The chosen rows: place, name, unit. One that is of several kinds is named after the first."""
        chosen: dict[int, tuple[str, str]] = {}
        has = [kind for kind in KINDS if described.get(f"{kind}_channels")]
        for kind in self.kinds or has:
            if kind not in has:
                raise ParameterError("kinds", kind, f"kinds that {self.board} has: {', '.join(has)}")
            places = described[f"{kind}_channels"]
            names = str(described.get("eeg_names", "")).split(",") if kind == "eeg" else []
            for i, place in enumerate(places):
                name = names[i] if len(names) == len(places) else f"{kind}{i + 1}"
                chosen.setdefault(int(place), (name, "uV" if kind in MICROVOLTS else ""))
        return [(place, *chosen[place]) for place in sorted(chosen)]

    def specs(self) -> Specs:
        described = self.description()
        _, names, units = zip(*self.rows(described), strict=True)
        rate = float(described["sampling_rate"])
        specs = {"out": StreamSpec((len(names),), rate_hz=rate, channels=names, units=units), "timing": timing_spec()}
        if self.preset == "default":
            specs["markers"] = StreamSpec((1,), channels=("marker",))
        return specs

    def missing(self) -> str:
        library()
        return ""

    def prepare(self) -> None:
        line_below.prepare()
        library()

    def read(self, feed: Feed) -> None:
        shim, described = library(), self.description()
        shim.BoardShim.disable_board_logger()
        board = shim.BoardShim(self.number(self.board, "board"), self._how(shim))
        try:
            board.prepare_session()
        except shim.BrainFlowError as error:
            raise DeviceError(
                f"{self.board} cannot be opened by BrainFlow: {error}; are its port or address right, and is it on?"
            ) from None
        try:
            if self.config:
                board.config_board(self.config)
            board.start_stream()
            feed.identify(
                "BrainFlow board",
                board=self.board,
                name=str(described.get("name", "")),
                brainflow=shim.BoardShim.get_version(),
            )
            feed.ready()
            reading = BoardReading(self, described)
            clock_log = ClockLog(self.board, feed, lambda: reading.clock)
            while not feed.wait(POLL_S):
                reading.take(board.get_board_data(preset=PRESETS[self.preset]), feed)
                clock_log.tell()
        except shim.BrainFlowError as error:
            raise DeviceError(f"{self.board}: {error}") from None
        finally:
            with suppress(shim.BrainFlowError):
                board.stop_stream()
            with suppress(shim.BrainFlowError):
                board.release_session()

    def _how(self, shim: Any) -> Any:
        made = shim.BrainFlowInputParams()
        for name in ("serial_port", "mac_address", "ip_address", "ip_port", "serial_number", "other_info"):
            setattr(made, name, getattr(self, name))
        if self.file:
            made.file = str(self.file)
        if self.master_board:
            made.master_board = self.number(self.master_board, "master_board")
        return made


class BoardReading:
    """BrainFlow's rows to chunks."""

    def __init__(self, of: BrainflowBoard, described: dict[str, Any]) -> None:
        rate = float(described["sampling_rate"])
        self._places = [place for place, _, _ in of.rows(described)]
        self._marker, self._package = described.get("marker_channel"), described.get("package_num_channel")
        bits = COUNTED.get(of.number(of.master_board or of.board, "board"), 0)
        self._packets = PacketClock(bits, rate, of.latency_s) if bits and self._package is not None else None
        self._pace = DevicePace(rate, of.latency_s)
        self._marks = of.preset == "default" and self._marker is not None
        self._marked = 0

    @property
    def clock(self) -> ClockState | None:
        return self._packets.state if self._packets else self._pace.state

    def take(self, data: Array, feed: Feed) -> int:
        """`data` (rows, n), as BrainFlow gives it."""
        if not data.shape[1]:
            return 0
        arrival = feed.now()
        if self._packets is not None:
            packets = self._packets.take(data[self._package].astype(np.int64), arrival)
            kept, stamp, lost, number, device = (
                packets.kept,
                packets.stamp,
                packets.lost,
                packets.number,
                packets.device,
            )
            if missing := int(lost.clip(0).sum()):
                feed.problem("lost row", missing)
            if not kept.all():
                feed.problem("repeated row", int((~kept).sum()))
        else:
            counted = self._pace.take(data.shape[1], arrival)
            kept, stamp, number, device = np.ones(data.shape[1], bool), counted.stamp, counted.number, counted.device
            lost = np.zeros(len(stamp), np.int64)
            lost[0] = -1 if counted.astray else 0
            if counted.astray:
                feed.problem("lost count")
        if not len(stamp):
            return 0
        for chunk in chunks(stamp, lost, np.ascontiguousarray(data[self._places].T)[kept]):
            feed.emit(chunk)
        if self._marks:
            self._emit_marks(data[self._marker][kept], stamp, feed)
        feed.emit(timing_chunk(number[-1:], device[-1:], arrival, stamp[-1:]), "timing")
        return len(stamp)

    def _emit_marks(self, marks: Array, stamp: Times, feed: Feed) -> None:
        at = np.flatnonzero(marks)
        if len(at):
            feed.emit(Chunk(stamp[at], marks[at].reshape(-1, 1).astype(np.float64), int(stamp[-1])), "markers")
