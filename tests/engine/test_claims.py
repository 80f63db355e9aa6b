"""What a stream claims is compared with what arrives, and nothing that contradicts it stays silent."""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kinegraph.stream.chunk import NS, Array, Chunk, Specs, StreamSpec, Times, grid
from kinegraph.stream.domain.claims import WRONG_BY_STAMPS, ClaimGate, check_series
from kinegraph.stream.domain.finding import Finding, recorded_findings
from kinegraph.stream.engine.flow.admission import ordered, soundness
from kinegraph.stream.engine.session import Session
from kinegraph.stream.engine.status import Outcome
from kinegraph.stream.errors import DeclarationError
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording
from kinegraph.stream.source import Feed, Source
from tests.support.command_line import Command, kinegraph

__all__ = ["kinegraph"]

ZERO = 1_700_000_000 * NS
SPEC = StreamSpec((2,), rate_hz=250.0, channels=("a", "b"), units=("uV",))


def noise(n: int, size: float = 30.0) -> Array:
    return np.random.default_rng(1).normal(0, size, (n, 2))


def sent(gate: ClaimGate, time: Times, cuts: list[int], lost: dict[int, int] | None = None) -> list[str]:
    """What the gate finds in samples at `time`, cut into chunks as a session gets them, by kind."""
    data, sound = noise(len(time)), soundness(gate.spec, gate)
    ends = sorted({*cuts, *(lost or {}), 0, len(time)} & set(range(len(time) + 1)))
    for start, stop in pairwise(ends):
        part = np.ascontiguousarray(time[start:stop])
        chunk = Chunk(part, data[start:stop], int(part.max()), (lost or {}).get(start, 0))
        if not sound(chunk):
            chunk, dropped = ordered(chunk)
            gate.ran_backwards(dropped, int(part[0]))
            gate.see(chunk)
    return [finding.kind for finding in gate.look(over=True)]


def gate(**facts: Any) -> ClaimGate:
    return ClaimGate("s", StreamSpec((2,), rate_hz=facts.pop("rate_hz", 250.0), units=("uV",)), **facts)


claims = st.fixed_dictionaries(
    {
        "rate": st.sampled_from([25.0, 100.0, 250.0, 500.0]),
        "what": st.sampled_from(["rate", "leap", "repeat", "standstill", "order"]),
        "factor": st.one_of(st.floats(0.4, 0.97), st.floats(1.03, 2.5)),
        "at": st.floats(0.1, 0.9),
        "jitter": st.floats(0.0, 0.2),
        "chunk": st.integers(1, 40),
        "seed": st.integers(0, 2**20),
    }
)


def check_claim(case: dict[str, Any]) -> None:
    """One that does not hold is found, whatever the chunks, and of the right kind."""
    rate, what, rng = case["rate"], case["what"], np.random.default_rng(case["seed"])
    n = round(rate * 24)
    true_hz = rate * case["factor"] if what == "rate" else rate
    time = grid(true_hz, n, ZERO) + (rng.uniform(-0.5, 0.5, n) * case["jitter"] / true_hz * NS).astype(np.int64)
    time = np.maximum.accumulate(time)
    at = round(n * case["at"])
    if what == "leap":
        time[at:] += round(rng.uniform(3, 3e5) * NS)
    elif what == "repeat":
        time = np.sort(np.concatenate([time[::2], time[::2]]))
    elif what == "standstill":
        time[at : at + round(1.5 * max(rate, 20))] = time[at]
        time = np.maximum.accumulate(time)
    elif what == "order":
        time[at - 5 : at], time[at : at + 5] = time[at : at + 5].copy(), time[at - 5 : at].copy()
    whole = [*range(at - 20), at + 20] if what == "order" else list(range(0, n, case["chunk"]))
    found = sent(gate(rate_hz=rate, wrong=WRONG_BY_STAMPS), time, whole)
    assert what in found, (case, found)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(claims)
def test_no_false_claim_is_silent(case: dict[str, Any]) -> None:
    check_claim(case)


@pytest.mark.nightly
@pytest.mark.timeout(1800)
@settings(max_examples=500, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(claims)
def test_no_false_claim_of_many_is_silent(case: dict[str, Any]) -> None:
    check_claim(case)


@settings(max_examples=25, deadline=None)
@given(
    rate=st.floats(1.0, 2000.0),
    drift=st.floats(-0.004, 0.004),
    jitter=st.floats(0, 0.9),
    chunk=st.integers(1, 50),
    pause_s=st.floats(0, 1.5),
    lost=st.integers(0, 40),
)
def test_a_clean_stream_gives_no_finding(
    rate: float, drift: float, jitter: float, chunk: int, pause_s: float, lost: int
) -> None:
    rng = np.random.default_rng(2)
    n = min(round(rate * 60) + 10, 20_000)
    index = np.arange(n) + np.where(np.arange(n) > n // 2, lost, 0)
    time = ZERO + np.round((index / (rate * (1 + drift)) + rng.uniform(0, jitter / rate, n)) * NS).astype(np.int64)
    time[n // 3 :] += round(pause_s * NS)
    marks = {n // 2 + 1: lost} if lost else {}
    if pause_s:
        marks[n // 3] = -1
    assert (
        sent(gate(rate_hz=rate, wrong=WRONG_BY_STAMPS), np.maximum.accumulate(time), list(range(0, n, chunk)), marks)
        == []
    )


def test_findings_do_not_depend_on_how_samples_are_cut() -> None:
    time = grid(200.0, 6000, ZERO)
    several = [gate(), gate(), gate()]
    for one, chunk in zip(several, (1, 7, 6000), strict=True):
        sent(one, time, list(range(0, 6000, chunk)))
    assert several[0].found == several[1].found == several[2].found != []


def test_the_gate_changes_no_sample() -> None:
    time, data = grid(125.0, 3000, ZERO), noise(3000)
    before = time.copy(), data.copy()
    assert check_series(gate(), time, data, None)
    assert (time == before[0]).all() and (data == before[1]).all()


@pytest.mark.parametrize(
    ("unit", "data", "seen"),
    [
        ("uV", noise(4000, 30e-6), "less than any amplifier's noise"),
        ("V", noise(4000, 3e4), "more than any electrode gives"),
        ("uV", noise(4000, 30.0), ""),
        ("mV", noise(4000, 0.03), ""),
        ("V", noise(4000, 30e-6), ""),
    ],
)
def test_a_voltage_in_another_unit_is_found(unit: str, data: Array, seen: str) -> None:
    spec = StreamSpec((2,), rate_hz=250.0, units=(unit,))
    found = check_series(ClaimGate("emg", spec), grid(250.0, len(data), ZERO), data, None)
    assert [f.kind for f in found] == (["unit"] if seen else []) and (not seen or seen in found[0].seen)


@pytest.mark.parametrize(
    ("unit", "gravity", "is_found"), [("g", 9.81, True), ("m/s2", 1.0, True), ("g", 1000.0, True), ("g", 1.0, False), ("m/s2", 9.81, False)]
)  # fmt: skip
def test_gravity_shows_the_unit_of_an_accelerometer(unit: str, gravity: float, is_found: bool) -> None:
    data = np.random.default_rng(3).normal(0, 0.01 * gravity, (4000, 3)) + np.array([0, 0, gravity])
    found = check_series(
        ClaimGate("acc", StreamSpec((3,), rate_hz=100.0, units=(unit,))), grid(100.0, 4000, ZERO), data, None
    )
    assert [f.kind for f in found] == (["unit"] if is_found else [])


@pytest.mark.parametrize(
    ("units", "scale", "seen"),
    [
        (("deg/s",), 150.0, ""),
        (("rad/s",), 3.0, ""),
        (("rad/s",), 150.0, "more than any gyroscope"),
        (("deg/s",), 20_000.0, "more than any gyroscope"),
        (("deg/s",), 0.0003, "less than a gyroscope's noise"),
        (("g",) * 3 + ("rad/s",) * 3, 150.0, "more than any gyroscope"),
        (("degC",), 0.2, ""),
        (("degC",), 310.0, "may be K"),
        (("degC",), 2000.0, "about"),
        (("K",), 30.0, "may be degC"),
    ],
)
def test_gyroscopes_and_thermometers_show_their_unit(units: tuple[str, ...], scale: float, seen: str) -> None:
    rng = np.random.default_rng(7)
    width = len(units) if len(units) > 1 else 3
    data = rng.normal(scale, 0.1, (4000, width)) if units[0] in ("degC", "K") else rng.normal(0, scale, (4000, width))
    if len(units) == 6:
        data[:, :3] = rng.normal(0, 0.6, (4000, 3))
    spec = StreamSpec((width,), rate_hz=100.0, channels=tuple("abcdef"[:width]), units=units)
    found = check_series(ClaimGate("s", spec), grid(100.0, 4000, ZERO), data, None)
    assert [f.kind for f in found] == (["unit"] if seen else []) and (not seen or seen in found[0].seen)


def test_quaternions_that_are_none_are_found() -> None:
    spec = StreamSpec((4,), rate_hz=100.0, channels=("qw", "qx", "qy", "qz"))
    found = check_series(ClaimGate("q", spec), grid(100.0, 4000, ZERO), np.full((4000, 4), 3.0), None)
    assert [f.kind for f in found] == ["rotation"]


def test_a_finding_is_the_same_after_a_recording() -> None:
    [found] = check_series(gate(), grid(125.0, 3000, ZERO), noise(3000), None)
    assert Finding.from_facts(found.facts()) == found
    assert found.text.startswith("'s' claims 250 Hz; seen: 125 Hz from 2023-11-14")


@dataclass(frozen=True, slots=True)
class Liar(Source):
    """Says that it sends 250 Hz, and sends half; `raises`: it finds out itself."""

    raises: bool = False

    def specs(self) -> Specs:
        return {"out": SPEC}

    def read(self, feed: Feed) -> None:
        if self.raises and not feed.again:
            raise DeclarationError("the liar is not as declared")
        time = grid(125.0, 4000, feed.now() - 32 * NS)
        for start in range(0, 4000, 100):
            part = time[start : start + 100]
            feed.emit(Chunk(part, noise(100), int(part[-1])))


HONEST = "  board: {use: devices.people.treadmill.Treadmill, realtime: false, duration_s: 2}\n"


def session(options: str, tmp_path: Path) -> tuple[Outcome, list[str]]:
    graph = load_text(f"nodes:\n{HONEST}  liar: {{use: {__name__}.Liar, {options}}}\n")
    outcome = Session(graph, tmp_path / "s").run()
    with Recording.open(tmp_path / "s") as recording:
        return outcome, [finding.kind for finding in recorded_findings(recording)]


def test_a_session_records_and_shows_what_a_source_claims_wrongly(tmp_path: Path, kinegraph: Command) -> None:
    outcome, kinds = session("required: true", tmp_path)
    assert outcome.error is None and kinds == ["rate"]
    assert "claims 250 Hz; seen: 125 Hz" in outcome.table["liar"]["findings"]
    code, shown, _ = kinegraph("info", tmp_path / "s", "--json")
    assert code == 0 and json.loads(shown)["findings"][0]["seen"] == "125 Hz"
    assert "findings: 1" in kinegraph("info", tmp_path / "s")[1]


def test_a_source_that_must_keep_its_claims_ends_the_session(tmp_path: Path) -> None:
    outcome, kinds = session("claims: refuse", tmp_path)
    assert isinstance(outcome.error, DeclarationError) and "claims: warn" in str(outcome.error) and kinds == ["rate"]


@pytest.mark.parametrize("options", ["required: false, claims: refuse", "required: false, raises: true"])
def test_an_optional_source_that_is_not_as_declared_does_not_end_the_session(options: str, tmp_path: Path) -> None:
    outcome, _ = session(options, tmp_path)
    assert outcome.error is None and outcome.table["board.emg"]["samples"] == 2000
