"""The Lab Streaming Layer's library and its settings, which are one for the whole process and made before its first use."""

from __future__ import annotations

import os
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from kinegraph.stream.errors import DeviceError
from kinegraph.stream.params import param

VARIABLE = "KINEGRAPH_LSL"
"""Settings for nodes without their own: "machine", or "machine:SESSION"."""
QUIET = "[log]\nlevel = -3\n"
"""We report what goes wrong; the library itself prints only what ends the process."""
LOOPBACK = """[ports]
IPv6 = disable
[multicast]
ResolveScope = machine
AddressesOverride = {127.0.0.1}
ListenAddress = 127.0.0.1
"""

Scope = Literal["", "machine", "link", "site", "organization", "global"]


@dataclass(frozen=True, slots=True)
class Network:
    """How far LSL looks and is seen. All LSL nodes of a process share it; a node that states nothing takes what another states.

    scope     "machine": this computer alone, over 127.0.0.1 and never through a network card. The others are LSL's own, from the wire up.
              Left out: the lab's lsl_api.cfg, wherever LSL looks for it, or LSL's own defaults
    session   streams of another session are not seen, nor are these by those; left out: LSL's "default"
    peers     addresses of computers that are asked directly, where the network does not pass on multicasts
    """

    scope: Scope = param("", help="machine: this computer alone; left out: as the lab's lsl_api.cfg says")
    session: str = param("", help="streams of other sessions are not seen")
    peers: tuple[str, ...] = param((), help="computers that are asked directly, where multicasts do not pass")

    def text(self) -> str:
        """The settings as LSL reads them (an lsl_api.cfg)."""
        peers = (*(("127.0.0.1",) if self.scope == "machine" else ()), *self.peers)
        lab = f"KnownPeers = {{{', '.join(peers)}}}\n" if peers else ""
        lab += f"SessionID = {self.session}\n" if self.session else ""
        reach = f"[multicast]\nResolveScope = {self.scope}\n" if self.scope else ""
        return (LOOPBACK if self.scope == "machine" else reach) + (f"[lab]\n{lab}" if lab else "") + QUIET


ANY = Network()
"""Nothing is stated."""
MACHINE = Network(scope="machine")

_lock = threading.Lock()
_text: str | None = None


def library(network: Network = ANY) -> Any:
    """pylsl, with these settings made. Raises DeviceError where it does not load, or other settings are in force already."""
    global _text
    wanted = _wanted(network)
    with _lock:
        if _text is None:
            lsl = _load()
            _text = wanted or ("" if _labs_own() else QUIET)
            if _text:
                lsl.set_config_content(_text)
            return lsl
        if wanted and wanted != _text:
            raise DeviceError(
                f"network: LSL's settings are one for the whole process, and others are in force; asked for {wanted!r},"
                f" but {_text!r} came first. Give every LSL node the same `network`, or only one of them"
            )
    return _load()


def unsettled() -> bool:
    """Whether the network has not been configured yet."""
    return _text is None and VARIABLE not in os.environ


def _wanted(network: Network) -> str:
    """The text of the requested settings, or ""."""
    if network != ANY:
        return network.text()
    scope, _, session = os.environ.get(VARIABLE, "").partition(":")
    if scope not in ("", *Scope.__args__):  # type: ignore[attr-defined]
        raise DeviceError(f"{VARIABLE} is {scope!r}; it must be machine, or machine:SESSION")
    asked = Network(scope=scope, session=session)  # type: ignore[arg-type]
    return "" if asked == ANY else asked.text()


def _labs_own() -> bool:
    """Whether LSL will find a settings file, which is then in force alone."""
    places = [os.environ.get("LSLAPICFG", ""), "lsl_api.cfg", "~/lsl_api/lsl_api.cfg", "/etc/lsl_api/lsl_api.cfg"]
    return any(place and Path(place).expanduser().is_file() for place in places)


def _load() -> Any:
    try:
        import pylsl
    except (ImportError, RuntimeError, OSError) as error:
        reason = str(error).strip().partition("\n")[0]
        raise DeviceError(
            f"the Lab Streaming Layer's library does not load: {reason}. pylsl brings it for Linux on x86-64, Windows and macOS;"
            " elsewhere install liblsl (conda install -c conda-forge liblsl) and set PYLSL_LIB to its file"
        ) from None
    return pylsl
