"""`kinegraph ward`: all beds of a site on one page; accounts, the agent at a bed, rollouts, nights."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinegraph.stream.cli.commands.page_options import NoToken, PageFor

if TYPE_CHECKING:
    from kinegraph.devices.ward.alarms import MqttAlarms
    from kinegraph.devices.ward.centre import Centre
    from kinegraph.devices.ward.site import WardSite


class WardAction(StrEnum):
    """What `kinegraph ward` does."""

    serve = "serve"
    add = "add"
    agent = "agent"
    spec = "spec"
    nights = "nights"


def ward(
    action: Annotated[
        WardAction,
        typer.Argument(
            metavar="[ACTION]",
            help="serve the page; add beds; agent: run a graph at a bed; spec: a stream's spec as a file; nights of all beds",
        ),
    ] = WardAction.serve,
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]", help="add: beds; agent: GRAPH; spec: BED STREAM")
    ] = None,
    home: Annotated[Path, typer.Option(help="the ward's folder; of the agent, its own")] = Path("ward"),
    host: Annotated[
        str, typer.Option(help="add, serve: how beds reach this machine; other than 127.0.0.1: encrypted")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="of the NATS server")] = 4223,
    server: Annotated[
        str, typer.Option(metavar="FILE", help="a server.yaml: the account at a server that is there already")
    ] = "",
    at: Annotated[str, typer.Option(metavar="HOST:PORT", help="serve the page there")] = "",
    webhook: Annotated[list[str] | None, typer.Option(metavar="URL", help="post alarms there")] = None,
    mqtt: Annotated[str, typer.Option(metavar="HOST[:PORT]", help="publish alarms by this MQTT broker")] = "",
    no_token: NoToken = False,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="open it in a browser")] = True,
    duration_s: PageFor = 0.0,
    install: Annotated[str, typer.Option(help="agent: the command that installs a version, which is appended")] = "",
) -> None:
    """Show all beds of a site on one page, those that need attention first.

    Without --server it starts a nats-server of its own (Debian: nats-server). kinegraph ward add bed1 makes an account and the folder that
    is copied to the bed; kinegraph ward agent GRAPH runs a graph there. Beds go on when the ward ends.
    """
    from kinegraph.stream.cli.commands import logs
    from kinegraph.stream.errors import KinegraphError

    logs.set_up()
    given = names or []
    if action is WardAction.add:
        _add(home, host, port, given)
    elif action is WardAction.agent:
        if len(given) != 1 or not server:
            raise KinegraphError(
                "an agent needs a graph and its account: kinegraph ward agent GRAPH --server server.yaml"
            )
        _agent(Path(given[0]), home, Path(server), install)
    elif action is WardAction.spec:
        if len(given) != 2:
            raise KinegraphError("name the bed and the stream: kinegraph ward spec BED STREAM")
        _spec(home, server, *given)
    elif action is WardAction.nights:
        _nights(home)
    else:
        _serve(home, host, port, server, at, webhook or [], mqtt, no_token, browser, duration_s)


def _add(home: Path, host: str, port: int, beds: list[str]) -> None:
    from kinegraph.devices.ward.site import WardSite
    from kinegraph.stream.errors import KinegraphError
    from kinegraph.stream.text.safe_text import say

    if not beds:
        raise KinegraphError("name the beds to add: kinegraph ward add bed1 bed2")
    site = WardSite(home, host, port)
    _tell_moved(site)
    for bed in beds:
        say(f"{site.add(bed)}: copy this folder to {bed}")
    site.local_server()
    say("a ward that runs takes new beds over when it is started again")


def _tell_moved(site: WardSite) -> None:
    from kinegraph.stream.text.safe_text import say

    if site.moved:
        say(
            f"beds reach the ward at {site.host}:{site.port} now: copy the folders below {site.home / 'beds'} to them again",
            err=True,
        )


def _serve(
    home: Path,
    host: str,
    port: int,
    server: str,
    at: str,
    webhooks: list[str],
    mqtt: str,
    no_token: bool,
    browser: bool,
    duration_s: float,
) -> None:
    import asyncio

    from kinegraph.devices.nats.server import account_of
    from kinegraph.devices.page.address import parsed
    from kinegraph.devices.page.serving import refuse_unbuilt
    from kinegraph.devices.ward.alarms import Deliveries, webhook
    from kinegraph.devices.ward.app import serve
    from kinegraph.devices.ward.centre import Centre
    from kinegraph.devices.ward.site import WardSite

    refuse_unbuilt()
    home = home.resolve()
    address = parsed(at or f":{DEFAULT_PORT}", no_token=no_token)
    site = None if server else WardSite(home, host, port)
    if site:
        _tell_moved(site)
    local = site.local_server().start() if site else None
    try:
        centre = Centre(home, site.server if site else account_of(Path(server))[1], beds=site.beds if site else ())
        receivers = {url: webhook(url) for url in webhooks}
        broker = _broker(mqtt, centre) if mqtt else None
        if broker:
            receivers["mqtt"] = broker.deliver
        reachable = {"mqtt": broker.is_connected} if broker else {}
        centre.deliveries = Deliveries(centre.book, receivers, reachable=reachable) if receivers else None
        centre.start()
        try:
            asyncio.run(serve(centre, address, duration_s=duration_s, browser=browser))
        finally:
            centre.stop()
            if broker:
                broker.stop()
    finally:
        if local:
            local.stop()


def _broker(mqtt: str, centre: Centre) -> MqttAlarms:
    import time

    from kinegraph.devices.mqtt.link import Broker
    from kinegraph.devices.ward.alarms import MqttAlarms

    name, _, number = mqtt.partition(":")
    broker = Broker(name, int(number) if number.isdigit() else 1883)
    broker.check()
    return MqttAlarms(broker, lambda id: centre.book.acknowledge(id, "mqtt", time.time()))


def _agent(graph: Path, home: Path, account: Path, install: str) -> None:
    import shlex
    import signal

    from kinegraph.devices.nats.server import account_of
    from kinegraph.devices.ward.agent import Agent

    bed, server = account_of(account)
    agent = Agent(bed, home.absolute(), server, install=shlex.split(install))
    agent.adopt(account)
    agent.use(graph)
    signal.signal(signal.SIGTERM, lambda *_: agent.stop())
    signal.signal(signal.SIGINT, lambda *_: agent.stop())
    agent.serve()


def _spec(home: Path, server: str, bed: str, stream: str) -> None:
    from kinegraph.devices.nats import link as links
    from kinegraph.devices.nats.server import account_of, check_bed
    from kinegraph.devices.ward.site import WardSite
    from kinegraph.stream.errors import KinegraphError
    from kinegraph.stream.system.atomic_file import write_complete
    from kinegraph.stream.text.safe_text import say

    check_bed(bed)
    link = links.Link(account_of(Path(server))[1] if server else WardSite(home).server, "kinegraph ward spec")
    try:
        if not link.wait(5.0):
            raise KinegraphError(f"the NATS server does not answer ({link.error or 'no reason'}); is the ward running?")
        found = link.call(links.fact(link, f"{bed}.facts.spec.{stream}"))
    except OSError as error:
        raise KinegraphError(str(error)) from None
    finally:
        link.close()
    if not found:
        raise KinegraphError(f"bed {bed!r} has published no stream {stream!r}")
    file = Path(f"{bed}.{stream}.json")
    write_complete(file, found)
    say(file)


def _nights(home: Path) -> None:
    from kinegraph.devices.commands.nights import nights
    from kinegraph.devices.ward.beds import natural
    from kinegraph.stream.errors import KinegraphError
    from kinegraph.stream.text.safe_text import say

    folders = sorted((home / "nights").glob("*"), key=lambda folder: natural(folder.name))
    if not folders:
        raise KinegraphError(f"{home} holds no nights yet; `nights` of a bed's StreamOutlet names its night log")
    for folder in folders:
        say(f"\n{folder.name}")
        nights(path=folder)


DEFAULT_PORT = 7770
