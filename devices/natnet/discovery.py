"""NatNet servers (OptiTrack Motive) in the local network, with what they stream, and the node that reads it."""

from __future__ import annotations

import json
import select
import socket
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress

from kinegraph.devices.discovery.finders import FoundDevice
from kinegraph.devices.natnet import protocol as protocol
from kinegraph.devices.natnet.names import bodies_of
from kinegraph.devices.natnet.protocol import NatNetError, NatNetModels, ServerInfo

ANSWER_S = 1.0
AT: list[tuple[str, int]] = [("127.0.0.1", protocol.COMMAND_PORT), ("255.255.255.255", protocol.COMMAND_PORT)]
"""Where servers are looked for: on this computer, and by broadcast."""


def find() -> Iterator[FoundDevice]:
    """Every server that answers within a second."""
    servers, models = answering(AT)
    for who, info in servers.items():
        yield described(who, info, models.get(who))


def missing(server: str, port: int) -> str:
    """What to report of a server that does not answer within a second, with those that do; "" where it does."""
    try:
        wanted = socket.gethostbyname(server), port
    except OSError as error:
        return f"NatNet server {server}: {error.strerror}"
    servers, _ = answering([wanted, *AT], wanted)
    if wanted in servers:
        return ""
    others = ", ".join(f"{host}:{at}" for host, at in servers)
    hint = f"there is {others}" if others else "does Motive stream (Settings, Streaming, Enable), on that network card?"
    return f"no NatNet server answers at {server}:{port}; {hint}"


def answering(
    at: Sequence[tuple[str, int]], enough: tuple[str, int] | None = None
) -> tuple[dict[tuple[str, int], ServerInfo], dict[tuple[str, int], NatNetModels]]:
    """The servers that answer within a second, and what they stream; no longer than until `enough` has answered."""
    servers: dict[tuple[str, int], ServerInfo] = {}
    models: dict[tuple[str, int], NatNetModels] = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ask:
        ask.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        for where in at:
            with suppress(OSError):
                ask.sendto(protocol.message(protocol.DISCOVERY, protocol.connect()[4:]), where)
                ask.sendto(protocol.connect(), where)
        deadline = time.monotonic() + ANSWER_S
        while enough not in servers and (left := deadline - time.monotonic()) > 0:
            if not select.select([ask], [], [], left)[0]:
                break
            with suppress(OSError, NatNetError):
                data, who = ask.recvfrom(65536)
                kind, payload = protocol.opened(data)
                if kind == protocol.SERVER_INFO and who not in servers:
                    servers[who] = protocol.server_info(payload)
                    ask.sendto(protocol.message(protocol.REQUEST_MODELS), who)
                elif kind == protocol.MODELS and who in servers:
                    models[who] = protocol.models(payload, servers[who].natnet)
    return servers, models


def described(who: tuple[str, int], info: ServerInfo, models: NatNetModels | None) -> FoundDevice:
    """What a server says of itself."""
    bodies = list(bodies_of(models)) if models else []
    version = f"NatNet {info.natnet[0]}.{info.natnet[1]}"
    way = "unicast" if info.multicast is False else "multicast"
    what = f"{info.application} {'.'.join(map(str, info.version))} ({version}, {way}), {len(bodies)} rigid bodies and bones"
    port = f"\nport: {who[1]}" if who[1] != protocol.COMMAND_PORT else ""
    yaml = f"use: devices.natnet.NatNet\nserver: {who[0]}{port}\nbodies: {json.dumps(bodies)}\nrate_hz: 120   # as set in Motive"
    old = "" if info.natnet >= protocol.OLDEST else "too old: 3.0 or newer is needed"
    return FoundDevice("natnet", f"{who[0]}:{who[1]}", what, yaml, old)
