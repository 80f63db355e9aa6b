"""Who may do what at the server, what leaves the bed, and which clock counts."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.nats import StreamInlet, StreamOutlet
from kinegraph.devices.nats.clock import ClockMapping, offset
from kinegraph.devices.nats.link import Link, make_streams
from kinegraph.devices.nats.local_server import CENTRE, Account, LocalServer, configuration
from kinegraph.devices.nats.server import NatsServer
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.errors import DeclarationError, InputError, ParameterError
from tests.support.mosquitto import eventually, free_port
from tests.support.nats_site import SPEC, folders, numbers, receiving, samples, sending, server

__all__ = ["folders", "server"]


@pytest.fixture(scope="module")
def guarded(server: LocalServer, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalServer]:
    """A server with accounts for the centre and two beds."""
    folder = tmp_path_factory.mktemp("guarded")
    accounts = [Account(name, f"secret of {name}") for name in (CENTRE, "bed1", "bed2")]
    made = LocalServer(folder, free_port(), accounts).start()
    for one in accounts:
        (folder / one.name).write_text(one.password)
    with linked(made, CENTRE) as link:
        assert link.wait(100)
        link.call(make_streams(link))
    yield made
    made.stop()


class linked:
    """A connection with an account."""

    def __init__(self, server: LocalServer, name: str) -> None:
        account = NatsServer(server.url, name, str(server.folder / name)) if name else NatsServer(server.url)
        self.link = Link(account, name, f"_INBOX_{name}" if name.startswith("bed") else "_INBOX")

    def __enter__(self) -> Link:
        return self.link

    def __exit__(self, *_: object) -> None:
        self.link.close()


def test_no_client_connects_without_an_account(guarded: LocalServer) -> None:
    with linked(guarded, "") as link:
        eventually(lambda: "uthorization" in link.error)
        assert not link.there


def test_a_bed_writes_its_own_subjects_and_no_others(guarded: LocalServer) -> None:
    with linked(guarded, "bed1") as link, linked(guarded, CENTRE) as centre:
        assert link.wait(100) and centre.wait(100)

        async def publish(subject: str) -> Any:
            return await link.stream.publish(subject, b"x", timeout=0.3)

        assert link.call(publish("kinegraph.bed1.data.x"))
        for subject in ("kinegraph.bed2.data.x", "kinegraph.bed2.facts.x", "kinegraph.bed1.ask.clock"):
            with pytest.raises(OSError):
                link.call(publish(subject))
            eventually(lambda: "ermissions" in link.error)
        with pytest.raises(OSError):  # nor does it read what others send, or change the server's streams
            link.call(link.stream.get_last_msg("kinegraph-data", "kinegraph.bed1.data.x"), 1.0)
        info = centre.call(centre.stream.stream_info("kinegraph-data", subjects_filter=">"))
        assert set(info.state.subjects) == {"kinegraph.bed1.data.x"}


def test_a_bed_with_its_rights_sends_and_answers_for_its_clock(guarded: LocalServer) -> None:
    account = {"user": "bed2", "password_file": str(guarded.folder / "bed2")}
    centre = NatsServer(guarded.url, CENTRE, str(guarded.folder / CENTRE))
    with (
        sending("bed2", guarded, account=account, clock_ahead_ns=3 * NS) as bed,
        receiving("bed2", guarded, account=centre) as feed,
    ):
        bed.process("x", samples(0, 10))
        eventually(lambda: len(numbers(feed)) == 10 and bool(feed.clocks))
    assert feed.clocks[-1]["offset_s"] == pytest.approx(-3.0, abs=0.5)
    assert 0 < feed.clocks[-1]["uncertainty_s"] < 0.5
    assert feed.data("clock")["offset"][-1] == round(feed.clocks[-1]["offset_s"] * NS)


def test_an_nkey_opens_the_server_instead_of_a_password(server: LocalServer, tmp_path: Path) -> None:
    nkeys = pytest.importorskip("nkeys")
    seed = nkeys.encode_seed(bytes(range(32)), nkeys.PREFIX_BYTE_USER)
    public = nkeys.from_seed(bytearray(seed)).public_key.decode()
    (tmp_path / "key").write_bytes(seed)
    made = LocalServer(tmp_path / "site", free_port(), [Account(CENTRE, nkey=public)]).start()
    try:
        link = Link(NatsServer(made.url, nkey_file=str(tmp_path / "key")), "test")
        assert link.wait(100)
        link.close()
    finally:
        made.stop()


def test_a_server_is_checked_before_the_start(tmp_path: Path) -> None:
    for wrong in (
        NatsServer("nats://me:secret@host"),
        NatsServer(user="me"),
        NatsServer(password_file=str(tmp_path / "absent"), user="me"),
    ):
        with pytest.raises(ParameterError) as raised:
            StreamOutlet(bed="b", server=wrong).open({"x": SPEC})
        assert "secret" not in str(raised.value)
    with pytest.raises(ParameterError, match="bed"):
        StreamOutlet(bed="a.b").open({"x": SPEC})
    with pytest.raises(InputError, match="960 KiB"):
        StreamOutlet(bed="b").open({"x": StreamSpec((1000, 1000), np.uint16)})
    assert "user" not in configuration(1, tmp_path, [])


def test_a_stream_that_is_not_as_the_graph_was_checked_is_refused_with_the_difference(server: LocalServer) -> None:
    with sending("other", server) as bed:
        bed.process("x", samples(0, 10))
        with (
            pytest.raises(DeclarationError, match=r"units is \('g',\), not \('mV',\)"),
            receiving("other", server, declared=SPEC.derive(units=("mV",))) as feed,
        ):
            eventually(lambda: feed.error is not None)


TEXTS = StreamSpec((), np.dtype([("subject", "U12"), ("text", "U20")]))


def test_identifiers_are_replaced_before_they_leave_the_bed(server: LocalServer) -> None:
    with sending("private", server, specs={"x": TEXTS}, identifiers={"subject": "S07"}) as bed:
        data = np.array([("Ada Lovelace", "turned")], TEXTS.dtype)
        with receiving("private", server, declared=TEXTS) as feed:
            bed.process("x", Chunk(samples(0, 1).time, data, samples(0, 1).until))
            eventually(lambda: feed.count("out") == 1)
        assert feed.data("out").tolist() == [("S07", "turned")]
        assert "Ada" not in json.dumps(bed.runtime.news["x"].row)


def test_stamps_moved_to_the_centres_clock_keep_their_order_and_their_pace() -> None:
    assert offset(10, 1000, 20).ns == -985 and offset(10, 1000, 20).uncertainty_ns == 5
    mapping, time = ClockMapping(), samples(0, 1000).time
    moved = []
    for k, chunk in enumerate(np.split(time, 100)):
        moved.append(mapping.stamps(chunk, (-985, 50_000_000, -2_000_000)[k // 40], int(chunk[0])))
    found = np.concatenate(moved)
    assert (found[:400] - time[:400] == -985).all()
    steps = np.diff(found)
    assert steps.min() >= 0.89 * NS / 100 and steps.max() <= 1.11 * NS / 100
    assert StreamInlet(bed="b", stream="x", stamps="centre").stamps == "centre"
