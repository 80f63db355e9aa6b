"""`kinegraph dev simulate`: one simulated device on its own, at an address that any software can open."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from inspect import cleandoc
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinegraph.stream.errors import KinegraphError, ParameterError, nearest
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    from kinegraph.devices.simulation.serve import Simulator


def simulate(
    name: Annotated[str, typer.Argument(help="which device; left out: all there are", metavar="[NAME]")] = "",
    settings: Annotated[
        list[str] | None,
        typer.Argument(help="the device's parameters, and what goes wrong", metavar="PARAMETER=VALUE"),
    ] = None,
    at: Annotated[str, typer.Option(help="serve here, tcp://host:port, instead of on a pseudo-terminal")] = "",
    duration_s: Annotated[
        float, typer.Option("--for", metavar="SECONDS", min=0.0, help="end after so long; 0: when stopped")
    ] = 0.0,
) -> None:
    """Run a simulated device on its own; print the address at which it is found.

    It speaks the real device's protocol, so kinegraph or any other software can be pointed at it. Faults are written the same way for
    all: lose=0.01, duplicate=, corrupt= (shares of packets), stall_every_s=, stall_s=, reset_every_s=, unplug_every_s=, unplug_s=; its
    clock is set, jump_every_s=, by jump_s= (below 0: back); from_s= (nothing goes wrong before), seed=. What means nothing to a
    device (a counter reset without a counter) is refused.
    """
    from kinegraph.devices.simulation.catalogue import find, named
    from kinegraph.devices.simulation.fault_injection import FaultInjection
    from kinegraph.stream.params import build

    if not name:
        _list(named())
        return
    kind = find(name)
    own, faults = _split(_read(settings or []), kind, FaultInjection)
    try:
        device, injection = build(kind, own), build(FaultInjection, faults)
        device.check(injection)
    except ParameterError as error:
        raise KinegraphError(f"{name}: {error}") from None
    with _interruptible(), device.serving(injection, at) as address:
        say(address, flush=True)
        say(f"a simulated {name} is there until Ctrl-C", err=True)
        threading.Event().wait(duration_s or None)


@contextmanager
def _interruptible() -> Iterator[None]:
    """Ctrl-C and SIGTERM are how it is meant to end."""
    import signal

    def stop(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    except KeyboardInterrupt:
        pass
    finally:
        signal.signal(signal.SIGTERM, before)


def _read(settings: list[str]) -> dict[str, Any]:
    """{"lose": 0.01} from ["lose=0.01"]; values are read as YAML."""
    from kinegraph.stream.graph.reading.yaml_lines import parse

    found: dict[str, Any] = {}
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not equals or not name:
            raise KinegraphError(f"{setting!r} must be PARAMETER=VALUE, as in 'lose=0.01'")
        found[name] = parse(value, "").plain()
    return found


def _split(given: dict[str, Any], kind: type[Simulator], injection: type[Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """What is the device's and what of its fault injection; `seed` is both's."""
    own = {f.name for f in fields(kind)}  # type: ignore[arg-type]
    wrong = {f.name for f in fields(injection)}
    for name in given:
        if name not in own | wrong:
            raise KinegraphError(f"{kind.__name__} has no parameter {name!r}; {nearest(name, own | wrong)}")
    return {n: v for n, v in given.items() if n in own}, {n: v for n, v in given.items() if n in wrong}


def _list(simulators: dict[str, type[Simulator]]) -> None:
    from rich.table import Table

    from kinegraph.stream.text.screen import Screen

    table = Table("name", "what", "parameters", box=None)
    for name, kind in simulators.items():
        what = cleandoc(kind.__doc__ or "").partition("\n")[0]
        table.add_row(name, what, ", ".join(f.name for f in fields(kind)))  # type: ignore[arg-type]
    Screen().print(table)
