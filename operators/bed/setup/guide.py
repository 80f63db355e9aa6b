"""`kinegraph sleep setup`: from a camera to the first night, step by step, in the terminal."""

from __future__ import annotations

import re
import shutil
from functools import partial
from pathlib import Path
from threading import Event
from typing import Annotated, Any

import typer

from kinegraph.operators.bed.setup.command import looked
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.text.safe_text import say

FILE, PASSWORD = Path("bedside.yaml"), "mqtt.password"
HINT = re.compile(r"try regions: (\[\[.*\]\])")
ANSWERS_S = 5.0
"""How long a broker may take to accept a user."""


def setup(
    config: Annotated[Path, typer.Argument(help="the graph that is made, or set up further", metavar="CONFIG")] = FILE,
    of: Annotated[str, typer.Option("--graph", help="the shipped graph that a new one begins as")] = "bedside_sleep",
    out_s: Annotated[float, typer.Option("--out", min=10.0, help="how long to stay out of bed, in s")] = 60.0,
    between_s: Annotated[float, typer.Option("--between", min=0.0, help="how long lying down may take, in s")] = 30.0,
    in_s: Annotated[float, typer.Option("--in", min=10.0, help="how long to lie still, in s")] = 60.0,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="a simulated camera in the place of the real one")
    ] = False,
) -> None:
    """Set up a bedside monitor step by step: camera, bed, breath, broker, service.

    It makes bedside.yaml in the current folder, looks at the empty bed and at somebody in it, corrects the region if you agree, asks for
    the broker, and shows how the service is installed. It changes no other file, and can be called again.
    """
    from kinegraph.stream.cli.commands import logs

    logs.set_up(json=False, verbose=False)
    say("1. The graph")
    _begin(config, of)
    say("\n2. Camera and bed")
    well = _look(config, out_s, between_s, in_s, simulate=simulate)
    say("\n3. Home Assistant, or another MQTT client")
    _broker(config)
    say("\n4. The first night")
    if not well:
        raise KinegraphError(f"the night would not be recorded properly; correct this: kinegraph sleep setup {config}")
    say(f"try it:      kinegraph run {config}")
    say(f"as service:  sudo install -o kinegraph {config} /var/lib/kinegraph/bedside.yaml")
    if (config.parent / PASSWORD).exists():
        say(f"             sudo install -m 600 -o kinegraph {config.parent / PASSWORD} /var/lib/kinegraph/{PASSWORD}")
    say("             sudo systemctl enable --now kinegraph-bedside    (its unit: docs/use/bedside.md, The evening)")


def _begin(config: Path, of: str) -> None:
    """The graph is there, or is copied from the shipped one."""
    from kinegraph.stream.errors import nearest
    from kinegraph.stream.graph.shipped import shipped

    if config.exists():
        say(f"{config} is there; it is set up further")
        return
    there = shipped()
    if of not in there:
        raise KinegraphError(f"there is no shipped graph {of!r}; {nearest(of, there)}")
    config.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(there[of], config)
    say(f"{config} is made from {of}")


def _look(config: Path, out_s: float, between_s: float, in_s: float, *, simulate: bool) -> bool:
    """Look until all is well, or it is to be left as it is; whether all is well."""
    from kinegraph.operators.bed.setup.graph import small

    while True:
        made = small(config, [])
        if not typer.confirm("Is the bed empty, and are you ready?", default=True):
            say("the bed was not looked at")
            return False
        findings = looked(made, out_s, between_s, in_s, simulate=simulate)
        if all(finding.well for finding in findings):
            return True
        hints = [found[1] for finding in findings if not finding.well and (found := HINT.search(finding.text))]
        if hints and typer.confirm(f"Set the region to {hints[0]}?", default=True):
            _write(config, partial(_set_regions, hints[0]))
        if not typer.confirm("Look once more?", default=True):
            return False


def _set_regions(regions: str, nodes: Any) -> None:
    """Where the bed is, in the part that finds it, or in the operator itself."""
    import json

    for node in nodes.values():
        if str(node.get("use", "")).endswith(("parts/bedside.yaml", "bed.BedRegion")):
            node["regions"] = json.loads(regions)
            return
    raise KinegraphError("no node of the graph takes regions; write them by hand")


def _broker(config: Path) -> None:
    """Ask where the broker is, try it, and write it into every node that has one."""
    from kinegraph.operators.bed.setup.command import broker_note
    from kinegraph.stream.graph.reading.load import load

    named = [name for name, node in load(config).nodes.items() if getattr(node.part, "broker", None) is not None]
    if not named:
        say("this graph publishes nothing")
        return
    host = str(typer.prompt("The broker's host (- for no broker)", default="localhost")).strip()
    if host == "-":
        _write(config, lambda nodes: [nodes[name].update(broker={"host": ""}) for name in named])
        say("no live states; reports and nights are written all the same")
        return
    port = int(typer.prompt("Its port", default=1883, type=int))
    user = str(typer.prompt("User (- for no user)", default="-")).strip()
    given: dict[str, Any] = {"host": host, "port": port}
    password = ""
    if user != "-":
        password = str(typer.prompt("Password", hide_input=True))
        given |= {"username": user, "password_file": _keep(config.parent, password)}
    _write(config, lambda nodes: [nodes[name].update(broker=given) for name in named])
    say(accepted(host, port, user if user != "-" else "", password) or broker_note(host, port))


def _keep(folder: Path, password: str) -> str:
    """The password's file, which only its owner can read."""
    from kinegraph.stream.system.atomic_file import write_complete

    path = folder / PASSWORD
    write_complete(path, password + "\n")
    path.chmod(0o600)
    return PASSWORD if folder == Path() else str(path.absolute())


def accepted(host: str, port: int, user: str, password: str) -> str:
    """Whether the broker takes this user, in words; "" where it does not answer."""
    from paho.mqtt.client import Client
    from paho.mqtt.enums import CallbackAPIVersion

    client, answered, codes = Client(CallbackAPIVersion.VERSION2), Event(), []

    def joined(_client: Any, _data: Any, _flags: Any, code: Any, _properties: Any) -> None:
        codes.append(code)
        answered.set()

    client.on_connect = joined
    client.username_pw_set(user or None, password or None)
    try:
        client.connect(host, port)
    except OSError:
        return ""
    client.loop_start()
    answered.wait(ANSWERS_S)
    client.disconnect()
    client.loop_stop()
    if not codes:
        return ""
    if codes[0].is_failure:
        return f"NOT WELL: the broker at {host}:{port} refuses: {codes[0]}"
    return f"well: the broker at {host}:{port} accepts {user or 'everybody'}"


def _write(config: Path, change: Any) -> None:
    """Change the graph's nodes in its file, whose comments stay."""
    from io import StringIO

    from ruamel.yaml import YAML

    from kinegraph.stream.system.atomic_file import write_complete

    yaml = YAML()
    yaml.width = 200
    yaml.preserve_quotes = True
    graph = yaml.load(config.read_text(encoding="utf-8"))
    change(graph["nodes"])
    text = StringIO()
    yaml.dump(graph, text)
    write_complete(config, text.getvalue())
