"""`kinegraph dev new`: a declaration for what a port sends, a first graph for a recording, or the skeleton of an operator or a device."""

from __future__ import annotations

import time
from enum import StrEnum
from pathlib import Path as File
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinegraph.stream.errors import DeviceError, KinegraphError
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    from kinegraph.devices.frames.guess import FrameGuess
    from kinegraph.devices.lines.guess import LinesGuess

RATES = (
    1,
    2,
    5,
    10,
    20,
    25,
    30,
    40,
    50,
    60,
    64,
    75,
    80,
    100,
    120,
    125,
    128,
    150,
    200,
    240,
    250,
    256,
    300,
    400,
    500,
    512,
    600,
    800,
)
"""What devices are set to, and ten times as much from 100 on."""
UNITS_NS = {"ns": 1.0, "us": 1e3, "ms": 1e6, "s": 1e9}


class New(StrEnum):
    operator = "operator"
    device = "device"
    graph = "graph"


def new(
    what: Annotated[
        New,
        typer.Argument(
            metavar="WHAT",
            help="operator: a skeleton; device: a skeleton, or a declaration for what a port sends; graph: for a recording",
        ),
    ],
    port: Annotated[
        str,
        typer.Argument(
            help="a name, as in tiny_board; or /dev/serial/by-id/NAME, COM3, tcp://host:port; or the recording",
            metavar="NAME|PORT|RECORDING",
        ),
    ],
    output: Annotated[
        File | None,
        typer.Option(
            "-o",
            "--out",
            help="the graph to be made [default: it is printed]; of a skeleton: the folder [default: here]",
        ),
    ] = None,
    baud: Annotated[int, typer.Option(min=50, help="bits per second of the serial port")] = 115200,
    seconds: Annotated[
        float, typer.Option("--for", min=1.0, max=60.0, metavar="SECONDS", help="how long to listen")
    ] = 5.0,
    start: Annotated[str, typer.Option(metavar="HEX", help="bytes to send first, if it begins on command")] = "",
    stop: Annotated[str, typer.Option(metavar="HEX", help="bytes to send at the end")] = "",
) -> None:
    """Write a first graph for a device or a recording, or a skeleton with tests.

    A device's graph is written from what its port sends, a recording's from what it holds.

    kinegraph dev new operator baseline

    kinegraph dev new device tiny_board

    kinegraph dev new device /dev/ttyACM0 -o board.yaml

    kinegraph dev new graph walk.mcap -o walk.yaml

    A skeleton works as it stands, and its tests pass (`pytest`): a graph, an operator, or a device's protocol, driver and simulator.

    Of a port it proposes frame length, sync bytes, counter, time, checksum and rate, which the bytes show; what the numbers are, their
    types, names and units, must be compared with the device's manual.
    """
    from kinegraph.devices.commands.skeleton import is_name, write_skeleton

    if what is New.operator or (what is New.device and is_name(port)):
        made = write_skeleton(what.value, port, output or File())
        say("\n".join(map(str, made)))
        test = next(path for path in made if path.name.startswith("test_"))
        say(f"`python -m pytest {test}` tries it; `kinegraph check {made[-1]}` shows its graph")
        return
    if output and output.exists():
        raise KinegraphError(f"{output}: already exists; choose another --out")
    if what is New.graph:
        _give(_for_recording(File(port)), output)
        return
    say(f"listening to {port} for {seconds:g} s", err=True)
    _give(_for_port(port, baud, seconds, start, stop), output)


def _for_port(port: str, baud: int, seconds: float, start: str, stop: str) -> str:
    """A graph of what a port sends. Raises DeviceError."""
    from kinegraph.devices.frames import guess as frame_guess
    from kinegraph.devices.lines import guess as lines_guess
    from kinegraph.devices.transport.handshake import shown

    data, passed = _listen(port, baud, seconds, start, stop)
    lines = lines_guess.guess(data)
    frames = None if lines else frame_guess.guess(data)
    if lines:
        return _lines_graph(port, baud, lines, _rate(lines.lines, passed))
    if frames:
        return _frames_graph(port, baud, frames, _rate(frames.frames, passed), start, stop)
    hint = f"; is baud {baud} right? Does it wait for a command (--start)?" if "://" not in port else ""
    raise DeviceError(
        f"{port}: no frames of one length and no lines of numbers in {len(data)} bytes: {shown(data)}{hint}"
    )


def _give(text: str, output: File | None) -> None:
    """Write or print a graph that can be loaded."""
    _check(text)
    if output:
        output.write_text(text, encoding="utf-8")
        say(f"written to {output}; `kinegraph run {output}` reads it")
    else:
        say(text.rstrip())


def _for_recording(path: File) -> str:
    """A first graph of a recording's input streams. Raises KinegraphError."""
    from kinegraph.devices.conversion.first_graph import graph_text
    from kinegraph.stream.data.bounded import reading
    from kinegraph.stream.recording import Recording

    if path.is_file() and path.suffix != ".mcap":
        raise KinegraphError(
            f"{path}: is not a recording; make one of it: kinegraph files import {path} -o {path.stem}.mcap"
        )
    with reading(path, "a recording"), Recording.open(path) as opened:
        specs = {n: s.spec for n, s in opened.streams.items() if s.role == "input" and s.kept != "outline"}
    if not specs:
        raise KinegraphError(f"{path}: holds no stream that a graph could take")
    return graph_text(path, specs)


def _listen(port: str, baud: int, seconds: float, start: str, stop: str) -> tuple[bytes, float]:
    """What comes, and within how many seconds from its first byte to its last."""
    from kinegraph.devices.frames.declared import hex_bytes
    from kinegraph.devices.transport.transport import connect

    data, first, last = b"", 0.0, 0.0
    with connect(port, baud) as link:
        if start:
            link.write(hex_bytes(start, "start"))
        began = time.monotonic()
        while time.monotonic() - began < seconds:
            if more := link.read(0.1):
                last = time.monotonic()
                first = first or last
                data += more
        if stop:
            link.write(hex_bytes(stop, "stop"))
    return data, last - first


def _rate(count: int, passed: float) -> float:
    """The rate that was meant, if one is within 3 %, else what was measured."""
    measured = count / passed if passed else 0.0
    near = min(
        (float(r * k) for r in RATES for k in (1, 10) if k == 1 or r >= 100), key=lambda rate: abs(rate - measured)
    )
    return near if abs(near - measured) < 0.03 * measured else round(measured, 1)


def _unit(step: float, rate: float) -> tuple[str, float]:
    """The unit of a device's time that goes on by `step` from record to record, and the factor to it."""
    ns = 1e9 / rate / step
    unit = min(UNITS_NS, key=lambda name: abs(ns / UNITS_NS[name] - 1))
    return (unit, 1.0) if abs(ns / UNITS_NS[unit] - 1) < 0.1 else ("us", round(ns / 1e3, 6))


def _lines_graph(port: str, baud: int, found: LinesGuess, rate: float) -> str:
    facts: dict[str, Any] = {"delimiter": found.delimiter} if found.delimiter != "," else {}
    facts |= {"counter": found.counter} if found.counter else {}
    facts |= {"time": found.time, "time_unit": _unit(found.step, rate)[0]} if found.time else {}
    return _graph("devices.lines.AsciiLines", port, baud, {"columns": found.columns, **facts, "rate_hz": rate})


def _frames_graph(port: str, baud: int, found: FrameGuess, rate: float, start: str, stop: str) -> str:
    frame: dict[str, Any] = {"name": "out", "sync": found.sync.hex(" ").upper(), "rate_hz": rate}
    frame |= {"endian": found.endian} if found.endian != "little" else {}
    if found.checksum != "none":
        frame |= {"checksum": found.checksum} | ({"checksum_from": found.checksum_from} if found.checksum_from else {})
    frame["fields"] = found.fields
    for one in found.fields:
        if one.get("role") == "time":
            unit, scale = _unit(found.time_step, rate)
            one |= {"unit": unit} | ({"scale": scale} if scale != 1.0 else {})
    facts: dict[str, Any] = {"framing": found.framing} if found.framing != "none" else {}
    facts |= {name: [given] for name, given in (("start", start), ("stop", stop)) if given}
    return _graph("devices.frames.Binary", port, baud, {**facts, "frames": [frame]})


def _graph(use: str, port: str, baud: int, facts: dict[str, Any]) -> str:
    """The graph's text."""
    import io

    from ruamel.yaml import YAML

    node = {"use": use, "port": port, **({} if "://" in port else {"baud": baud}), **facts}
    text, yaml = io.StringIO(), YAML(typ="safe", pure=True)
    yaml.default_flow_style, yaml.sort_base_mapping_type_on_output, yaml.width = None, False, 140  # type: ignore[assignment]
    yaml.dump({"nodes": {"board": node}}, text)
    return f"# Proposed by `kinegraph dev new device` from what came; compare types, names and units with the manual.\n{text.getvalue()}"


def _check(text: str) -> None:
    """What is proposed must be taken."""
    from kinegraph.stream.graph.reading.load import load_text

    load_text(text, "proposal")
