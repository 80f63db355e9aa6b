"""Ground contacts from force, switches, markers and inertial sensors: known contacts, faults, and real recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import structlog

from bench import contacts as bench
from kinegraph.operators.contacts.acceleration import AccelerationContacts
from kinegraph.operators.contacts.contacts import Contacts
from kinegraph.operators.contacts.force import ForceContacts, SwitchContacts
from kinegraph.operators.contacts.inertial import InertialContacts
from kinegraph.operators.contacts.marker import MarkerContacts, walker
from kinegraph.stream.chunk import NS, Array, StreamSpec
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.graph.components import catalogue
from kinegraph.stream.params import build
from tests.gait.contact_runs import START, cycles_of, feed, onsets
from tests.gait.contact_runs import recordings as recordings
from tests.gait.contact_runs import walks as walks
from tests.support.real import needs_data

MARKERS = StreamSpec((2, 3), rate_hz=100.0, channels=("HIP", "ANK"), units=("m",))


def ramps(rate_hz: float = 1000.0) -> tuple[Array, Array, Array]:
    """Force of five contacts of 0.6 s, each rising to 800 N and falling in 0.1 s; and where it crosses 20 N: seconds up and down."""
    n = round(6 * rate_hz)
    phase = (np.arange(n) / rate_hz - 0.5) % 1.1
    force = 800.0 * np.clip(np.minimum(phase, 0.6 - phase) / 0.1, 0.0, 1.0)
    begin = 0.5 + 1.1 * np.arange(5)
    return force[:, None], begin + 0.0025, begin + 0.5975


NEWTON = StreamSpec((1,), rate_hz=1000.0, channels=("Fz",), units=("N",))


def test_force_crosses_twenty_newton_between_samples() -> None:
    force, up, down = ramps()
    operator = ForceContacts(side="right")
    reported = feed(operator, NEWTON, force)
    np.testing.assert_allclose(onsets(reported, "touchdown"), up, atol=1e-6)
    np.testing.assert_allclose(onsets(reported, "liftoff"), down, atol=1e-6)
    specs = operator.unopened().open({"in": NEWTON})
    assert specs["touchdown"].meta["side"] == "right"
    assert specs["liftoff"].dtype.names == ("onset",)
    delays = [(c.time - c.data["onset"]) / NS for chunks in reported.values() for c in chunks]
    assert np.concatenate(delays).max() <= operator.delay_s


@pytest.mark.parametrize(("unit", "factor", "inverted"), [("kN", 0.001, False), ("N", -1.0, True)])
def test_force_in_other_units_and_signs(unit: str, factor: float, inverted: bool) -> None:
    force, up, down = ramps()
    reported = feed(ForceContacts(inverted=inverted), NEWTON.derive(units=(unit,)), force * factor)
    np.testing.assert_allclose(onsets(reported, "touchdown"), up, atol=1e-6)
    np.testing.assert_allclose(onsets(reported, "liftoff"), down, atol=1e-6)


def test_force_cells_are_added_up() -> None:
    force, up, _ = ramps()
    spec = StreamSpec((3,), rate_hz=1000.0, channels=("heel", "toe", "other"), units=("N",))
    cells = np.column_stack([force * 0.25, force * 0.75, np.full_like(force, 500.0)])
    reported = feed(ForceContacts(channels=("heel", "toe")), spec, cells)
    np.testing.assert_allclose(onsets(reported, "touchdown"), up, atol=1e-6)


def test_a_press_is_told_with_the_sample_that_completes_its_time() -> None:
    load = np.repeat([0.0, 20.0, 0.0], [3, 4, 4])[:, None]
    out = feed(ForceContacts(threshold_n=20.0, debounce_s=0.02), StreamSpec((1,), rate_hz=100.0, units=("N",)), load)
    (touchdown,) = np.concatenate([c.time for c in out["touchdown"]])
    (onset,) = np.concatenate([c.data["onset"] for c in out["touchdown"]])
    assert (onset - START, touchdown - START) == (30_000_000, 50_000_000)


def test_force_noise_makes_no_contacts() -> None:
    force, up, _ = ramps()
    noisy = force + np.random.default_rng(3).normal(0.0, 6.0, force.shape)
    noisy[200:210] = 300.0
    noisy[900:905] = 0.0
    reported = feed(ForceContacts(), NEWTON, noisy)
    assert np.abs(onsets(reported, "touchdown") - up).max() < 0.005
    assert len(onsets(reported, "liftoff")) == 5


def test_what_is_there_at_the_start_or_after_a_gap_is_no_contact() -> None:
    force, up, down = ramps()
    seconds = np.arange(len(force)) / 1000.0
    begin, end = 800, 2050
    kept = np.r_[0:begin, end : len(force)]
    reported = feed(
        ForceContacts(), NEWTON, force[kept][700:], seconds=seconds[kept][700:], lost={begin - 700: end - begin}
    )
    np.testing.assert_allclose(onsets(reported, "touchdown"), up[2:], atol=1e-6)
    np.testing.assert_allclose(onsets(reported, "liftoff"), down[1:], atol=1e-6)
    assert [chunk.lost for chunk in reported["touchdown"]] == [0, -1]


def test_short_gaps_and_bad_samples_are_bridged() -> None:
    force, up, down = ramps()
    force[np.random.default_rng(4).random(len(force)) < 0.3] = np.nan
    reported = feed(ForceContacts(), NEWTON, force)
    np.testing.assert_allclose(onsets(reported, "touchdown"), up, atol=0.004)
    np.testing.assert_allclose(onsets(reported, "liftoff"), down, atol=0.004)


@pytest.mark.parametrize("inverted", [False, True])
def test_switches_of_one_foot(inverted: bool) -> None:
    spec = StreamSpec((2,), rate_hz=1000.0, channels=("heel", "toe"), units=("V",))
    level = np.zeros((4000, 2))
    for stride in range(3):
        at = 500 + 1100 * stride
        level[at : at + 350, 0] = level[at + 150 : at + 650, 1] = 3.3
        level[at + 3 : at + 8 : 2, 0] = 0.0
    reported = feed(SwitchContacts(threshold=1.65, inverted=inverted), spec, 3.3 - level if inverted else level)
    np.testing.assert_allclose(onsets(reported, "touchdown"), 0.508 + 1.1 * np.arange(3), atol=0.001)
    np.testing.assert_allclose(onsets(reported, "liftoff"), 1.15 + 1.1 * np.arange(3), atol=0.001)


@pytest.mark.parametrize(
    ("operator", "spec", "says"),
    [
        (ForceContacts(), NEWTON.derive(units=("V",)), "in N or kN"),
        (ForceContacts(channels=("Fx",)), NEWTON, "valid are 'Fz'"),
        (ForceContacts(hysteresis_n=20.0), NEWTON, "below threshold_n, which is 20"),
        (InertialContacts(), NEWTON, "three channels of angular velocity"),
        (InertialContacts(), bench.FOOT.derive(rate_hz=20.0), "at 40 Hz or faster"),
        (MarkerContacts(marker="LANK"), MARKERS, "did you mean 'ANK'"),
        (MarkerContacts(marker="ANK", reference="2"), MARKERS, "valid are 'ANK', 'HIP'"),
        (MarkerContacts(marker="ANK"), MARKERS.derive(units=("V",)), "in m, cm, mm"),
        (MarkerContacts(marker="ANK"), MARKERS.derive(rate_hz=None), "regular"),
        (MarkerContacts(marker="ANK", cutoff_hz=50.0), MARKERS, "below 50"),
    ],
)
def test_what_cannot_be_is_refused(operator: Contacts[Any], spec: StreamSpec, says: str) -> None:
    with pytest.raises((InputError, ParameterError), match=says):
        operator.open({"in": spec})


def foot(rate_hz: float, seed: int = 0) -> tuple[Array, Array, Array]:
    """A foot's pitch over ten strides of 1.1 s about a slanting axis: samples (n, 6), and where it turns forwards and back, in s."""
    rng = np.random.default_rng(seed)
    seconds = np.arange(round(14 * rate_hz)) / rate_hz - 1.0
    phase = np.where((seconds > 0) & (seconds < 11.0), seconds % 1.1, 0.0)
    rate = np.zeros(len(seconds))
    for begin, end, angle in ((0.2, 0.5, 1.2), (0.5, 0.9, -1.5), (0.9, 1.0, 0.3)):
        swing = (phase > begin) & (phase < end)
        rate[swing] += angle * np.pi / 2 / (end - begin) * np.sin(np.pi * (phase[swing] - begin) / (end - begin))
    axis = rng.normal(size=3)
    turning = rate[:, None] * axis / np.linalg.norm(axis) + rng.normal(0.0, 0.03, (len(seconds), 3))
    strides = 1.0 + 1.1 * np.arange(10)
    return np.hstack([rng.normal(0.0, 1.0, (len(seconds), 3)), turning]), strides + 0.5, strides + 0.9


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 128.0, 500.0])
def test_a_foot_is_followed_at_any_rate_and_mounting(rate_hz: float) -> None:
    for seed in range(4):
        samples, forwards, back = foot(rate_hz, seed)
        reported = feed(InertialContacts(), bench.FOOT.derive(rate_hz=rate_hz), samples)
        np.testing.assert_allclose(onsets(reported, "touchdown"), back + 0.026, atol=0.015)
        np.testing.assert_allclose(onsets(reported, "liftoff"), forwards - 0.031, atol=0.015)


def test_degrees_and_unnamed_units() -> None:
    samples, _, back = foot(100.0)
    gyro = np.degrees(samples[:, 3:])
    degrees = StreamSpec((3,), rate_hz=100.0, channels=("gx", "gy", "gz"), units=("deg/s",))
    bare = degrees.derive(units=("",))
    named = InertialContacts(angular_velocity=("gx", "gy", "gz"), unit="deg/s")
    for operator, spec in ((InertialContacts(), degrees), (named, bare)):
        np.testing.assert_allclose(onsets(feed(operator, spec, gyro), "touchdown"), back + 0.026, atol=0.015)


def test_a_foot_loses_packets() -> None:
    samples, _, back = foot(100.0)
    kept = np.random.default_rng(5).random(len(samples)) > 0.25
    seconds = (np.arange(len(samples)) / 100.0)[kept]
    reported = feed(InertialContacts(), bench.FOOT, samples[kept], seconds=seconds)
    np.testing.assert_allclose(onsets(reported, "touchdown"), back + 0.026, atol=0.03)
    samples[~kept, 4] = np.nan
    spoilt = feed(InertialContacts(), bench.FOOT, samples)
    np.testing.assert_array_equal(onsets(spoilt, "touchdown"), onsets(reported, "touchdown"))


def test_after_a_long_gap_the_next_step_is_known_at_once() -> None:
    samples, _, back = foot(100.0)
    kept = np.r_[0:460, 760 : len(samples)]
    reported = feed(InertialContacts(), bench.FOOT, samples[kept], seconds=kept / 100.0, lost={460: 300})
    expected = np.r_[back[:3], back[6:]] + 0.026
    np.testing.assert_allclose(onsets(reported, "touchdown"), expected, atol=0.015)
    assert [chunk.lost for chunk in reported["touchdown"]] == [0, -1]
    assert [chunk.lost for chunk in reported["liftoff"]] == [0, -1]


@pytest.mark.parametrize("belt", [False, True])
@pytest.mark.parametrize("reference", ["", "HIP"])
@pytest.mark.parametrize("heading", [0.0, 0.5, 2.5, 4.0])
def test_a_walker_on_any_heading(belt: bool, reference: str, heading: float) -> None:
    path = walker(1500, 100.0, speed_m_s=1.3, cadence_hz=1.0, belt=belt)
    c, s = np.cos(heading), np.sin(heading)
    path = path @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    reported = feed(MarkerContacts(marker="ANK", reference=reference), MARKERS, path)
    truth = turning_back(1.3)
    found = onsets(reported, "touchdown")
    settled = 0.0 if reference else 2.5
    np.testing.assert_allclose(found[found > settled], truth[(truth > settled) & (truth < 14.8)], atol=0.03)
    assert len(onsets(reported, "liftoff")) >= 12


def turning_back(speed_m_s: float) -> Array:
    """Where `walker`'s ankle, swinging for 0.4 s of each second, stops gaining on the hip: its speed falls to the hip's."""
    swing = np.linspace(0.5, 1.0, 10001)
    forwards = speed_m_s / 0.4 * (1.0 - np.cos(2 * np.pi * swing))
    turn = swing[np.argmin(np.abs(forwards - speed_m_s))]
    return np.arange(15) + 0.6 + 0.4 * float(turn)


def test_markers_as_columns_in_millimetres() -> None:
    path = walker(1200, 100.0, speed_m_s=1.2, cadence_hz=0.9)
    expected = feed(MarkerContacts(marker="ANK", reference="HIP"), MARKERS, path)
    names = tuple(f"{marker}_{axis}" for marker in ("HIP", "ANK") for axis in "xyz")
    flat = StreamSpec((6,), rate_hz=100.0, channels=names, units=("mm",))
    reported = feed(MarkerContacts(marker="ANK", reference="HIP"), flat, 1000.0 * path.reshape(-1, 6))
    np.testing.assert_allclose(onsets(reported, "touchdown"), onsets(expected, "touchdown"), atol=1e-6)
    turned = path[:, :, [1, 2, 0]]
    reported = feed(MarkerContacts(marker="1", reference="0", up="y"), MARKERS.derive(channels=()), turned)
    np.testing.assert_allclose(onsets(reported, "touchdown"), onsets(expected, "touchdown"), atol=1e-6)


@pytest.mark.parametrize(
    ("unit", "factor", "reference", "warned"),
    [
        *(("m", 1.0, "HIP", False), ("m", 1.0, "", False), ("m", 1000.0, "HIP", True), ("m", 1000.0, "", True)),
        *(("m", 100.0, "HIP", True), ("mm", 1.0, "HIP", True), ("cm", 1.0, "HIP", True), ("cm", 1000.0, "HIP", True)),
    ],
)
def test_positions_in_another_unit_than_they_say_are_warned_of_once(
    unit: str, factor: float, reference: str, warned: bool
) -> None:
    path = factor * walker(1200, 100.0, speed_m_s=1.2, cadence_hz=0.9)
    operator = MarkerContacts(marker="ANK", reference=reference)
    with structlog.testing.capture_logs() as warnings:
        reported = feed(operator, MARKERS.derive(units=(unit,)), path, lost=dict.fromkeys(range(100, 1200, 100), 0))
    assert [entry["taken_for"] for entry in warnings] == [unit] * warned
    assert warned or len(onsets(reported, "touchdown")) > 8


def test_lost_markers_are_filled_up_to_the_limit() -> None:
    path = walker(1200, 100.0, speed_m_s=1.2, cadence_hz=0.9)
    expected = onsets(feed(MarkerContacts(marker="ANK", reference="HIP"), MARKERS, path), "touchdown")
    for lost in (np.nan, 0.0):
        holes = path.copy()
        for begin in range(30, 1150, 90):
            holes[begin : begin + 8, 1] = lost
        reported = feed(MarkerContacts(marker="ANK", reference="HIP"), MARKERS, holes)
        assert np.abs(onsets(reported, "touchdown") - expected).max() < 0.04
    holes[300:700] = np.nan
    strict = onsets(feed(MarkerContacts(marker="ANK", reference="HIP"), MARKERS, holes), "touchdown")
    assert not ((strict > 3.0) & (strict < 7.0)).any()
    assert len(strict) >= len(expected) - 5


def test_a_marker_that_jumps_starts_again() -> None:
    path = walker(1200, 100.0, speed_m_s=1.2, cadence_hz=0.9)
    expected = onsets(feed(MarkerContacts(marker="ANK", reference="HIP"), MARKERS, path), "touchdown")
    path[500:, 1, 0] += 4.0
    jumped = onsets(feed(MarkerContacts(marker="ANK", reference="HIP"), MARKERS, path), "touchdown")
    assert len(bench.pair(jumped, expected, 0.02)) >= len(expected) - 1
    assert len(jumped) <= len(expected)


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 400.0])
def test_an_accelerometer_alone(rate_hz: float) -> None:
    seconds = np.arange(round(12 * rate_hz)) / rate_hz
    phase = seconds % 1.2
    size = np.full(len(seconds), 9.81)
    size += np.where((phase >= 0.5) & (phase < 1.0), 3.0, 0.0)
    size += 20.0 * np.exp(-(((phase - 0.6) / 0.03) ** 2)) + 20.0 * ((phase >= 0.9) & (phase < 1.0))
    direction = np.array([0.36, 0.48, -0.8])
    samples = size[:, None] * direction + np.random.default_rng(2).normal(0.0, 0.1, (len(seconds), 3))
    spec = StreamSpec((3,), rate_hz=rate_hz, channels=("x", "y", "z"), units=("g",))
    reported = feed(AccelerationContacts(), spec, samples / 9.80665)
    strides = 1.2 * np.arange(10)
    tolerance = 0.003 + 1.5 / rate_hz
    np.testing.assert_allclose(onsets(reported, "touchdown"), (strides + 0.91)[: len(strides)], atol=tolerance)
    np.testing.assert_allclose(onsets(reported, "liftoff"), strides + 0.58, atol=tolerance)


def test_cycles_begin_at_the_touchdowns() -> None:
    samples, _, _ = foot(100.0)
    operator = InertialContacts(side="left")
    reported = feed(operator, bench.FOOT, samples)
    closed = cycles_of(reported, operator.unopened().open({"in": bench.FOOT}), len(samples) / 100.0)
    assert len(closed) == 9
    begins = (closed["onset"] - START) / NS
    np.testing.assert_allclose(begins, onsets(reported, "touchdown")[:-1], atol=1e-9)


def test_the_nodes_in_the_docs_can_be_built() -> None:
    from ruamel.yaml import YAML

    page = (Path(__file__).resolve().parents[2] / "docs" / "method" / "contacts.md").read_text(encoding="utf-8")
    parts, _ = catalogue(("operators",))
    nodes = YAML(typ="safe").load(page.split("```yaml\n")[1].split("```")[0])
    assert len(nodes) == 7
    for node in nodes.values():
        build(parts[node.pop("use")], {key: value for key, value in node.items() if key != "from"})


def test_the_table_says_what_it_needs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.delenv("KINEGRAPH_DATA", raising=False)
    assert bench.main() == 2
    assert "KINEGRAPH_DATA" in capsys.readouterr().out


@needs_data
def test_the_table_is_printed(
    recordings: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bench, "VARIANTS", {"as recorded": bench.as_recorded})
    monkeypatch.setattr(bench, "people", lambda folder: sorted((folder / "steps").glob("imu_voisard_s*.npz"))[:1])
    assert bench.main() == 0
    assert "ankle and hip" in capsys.readouterr().out


@needs_data
def test_every_cycle_of_a_foot_worn_sensor_knows_its_stance(walks: dict[str, list[bench.Walk]]) -> None:
    """The lift-off is reported with the touch-down that ends its swing: no cycle may lose it."""
    accepted = unknown = 0
    for person in walks.values():
        for walk in person[:2]:
            reported = feed(InertialContacts(), bench.FOOT, walk.samples, seconds=walk.seconds)
            closed = cycles_of(reported, InertialContacts().open({"in": bench.FOOT}), float(walk.seconds[-1]))
            stance = closed["stance_pct"][closed["rejected"] == ""]
            accepted, unknown = accepted + len(stance), unknown + int(np.isnan(stance).sum())
    assert accepted > 400
    assert unknown == 0
