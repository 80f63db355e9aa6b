"""Impedances that a Cyton measures itself: the command, the formula, the simulated board's electrodes, and the check before a session."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.cyton.protocol import ChannelSetting, CytonDecoder, impedance_ohm, lead_off, uv_per_count
from kinegraph.devices.cyton.simulator import CytonModel, SimulatedCyton
from kinegraph.devices.cyton.source import Cyton
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.operators.emg.commands.electrode_check import check_electrodes
from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.domain.impedance import Impedance, LoneFeed
from kinegraph.stream.errors import DeviceError
from tests.support.command_line import Command
from tests.support.emg_run import stamps

PAIR = ChannelSetting(1, srb2=False)


def settings(pairs: set[int], common: set[int], n: int = 8) -> tuple[ChannelSetting, ...]:
    """Channels with an electrode pair, and with the common reference; the others are switched off."""
    return tuple(ChannelSetting(k, srb2=k in common, power=k in pairs | common) for k in range(1, n + 1))


def measured(
    *, kohm: tuple[float, ...], of: tuple[ChannelSetting, ...], daisy: bool = False, wrong: FaultInjection = GOOD
) -> list[tuple[str, str, float]]:
    with SimulatedCyton(daisy=daisy, impedances_kohm=kohm).serving(wrong) as port:
        reported = Cyton(port, daisy=daisy, settings=of).impedances(LoneFeed())
        return [(each.channel, each.pole, each.ohm / 1000) for each in reported]


def test_the_command_and_its_answers_are_those_of_the_documentation() -> None:
    assert lead_off(4, True, False) == b"z410Z" and lead_off(9, False, True) == b"zQ01Z"
    board = CytonModel()
    assert board.receive(b"z4") == b"" and board.receive(b"10Z") == b"Success: Lead off set for 4$$$"
    assert board.receive(b"z4Z") == b"Failure: too few chars$$$"
    assert board.receive(b"b" + lead_off(4, False, False)) == b"", "while it streams, it confirms nothing"


def test_the_formula_is_that_of_the_boards_makers_and_leaves_hum_and_drift_out() -> None:
    """sqrt(2) * rms / 6 nA - 2200 ohm, as OpenBCI's own program has it, of a board with packets decoded here."""
    board = CytonModel(impedances_kohm=(30.0, 5.0))
    board.receive(PAIR.command + lead_off(1, True, False) + b"b")
    frames = CytonDecoder().feed(b"".join([*board.say(0.0), *board.say(4.001), b"\xa0"]))
    uv = frames.counts[:, 0] * uv_per_count(24)
    number = np.arange(len(uv))
    theirs = np.sqrt(2) * (uv - uv.mean()).std() * 1e-6 / 6e-9 - 2200
    assert theirs == pytest.approx(30e3, rel=0.15), "theirs takes the muscle's activity for impedance, too"
    ours = impedance_ohm(number, uv, averaged=False)
    assert ours == pytest.approx(30e3, rel=0.03)
    disturbed = uv + 100 * np.sin(2 * np.pi * 50 / 250 * number) + 0.3 * number
    assert impedance_ohm(number, disturbed, averaged=False) == pytest.approx(ours, abs=20)


def test_both_poles_of_a_pair_and_the_free_pole_of_a_common_reference() -> None:
    found = measured(kohm=(3.0, 400.0, 1.0, 60.0), of=settings({1}, {2}))
    assert [(name, pole) for name, pole, _ in found] == [("ch1", "+"), ("ch1", "-"), ("ch2", "-")]
    assert [kohm for *_, kohm in found] == pytest.approx([3.0, 400.0, 60.0], abs=1.0)


def test_an_electrode_that_is_off_is_infinite_and_lost_packets_change_little() -> None:
    found = measured(kohm=(float("inf"), 50.0), of=settings({1}, set()), wrong=FaultInjection(lose=0.05))
    assert found[0][2] == np.inf and found[1][2] == pytest.approx(50.0, rel=0.05)


def test_a_daisys_averages_are_allowed_for() -> None:
    poles = (20.0, 90.0, *14 * [5.0], 40.0, 300.0)
    found = measured(kohm=poles, of=settings({1, 9}, set(), 16), daisy=True)
    assert [kohm for *_, kohm in found] == pytest.approx([20.0, 90.0, 40.0, 300.0], rel=0.05)


def test_a_board_that_falls_silent_is_named_not_waited_for() -> None:
    with SimulatedCyton().serving(FaultInjection(stall_every_s=1.0, stall_s=60.0)) as port:
        reported = Cyton(port, settings=settings({1}, set())).impedances(LoneFeed())
        with pytest.raises(DeviceError, match=r"while impedance was measured|no answer"):
            list(reported)


def test_the_verdict_names_the_impedance_and_leaves_worse_faults_their_names() -> None:
    spec = StreamSpec((3,), rate_hz=1000.0, channels=("TA", "SO", "GM"), units=("uV",))
    x = np.random.default_rng(4).standard_normal((14000, 3)) * np.repeat([2.0, 100.0], [5000, 9000])[:, None]

    def verdicts(**ohm: float) -> list[tuple[str, str]]:
        given = [Impedance(name, "+", value, 31.25) for name, value in ohm.items()]
        found = check_electrodes(spec, stamps(14000), x, (0, 5), (5, 14), given)
        assert all(e.advice for e in found if e.reason)
        return [(e.flag, e.reason) for e in found]

    assert verdicts() == 3 * [("good", "")]
    assert verdicts(TA=49e3, SO=51e3, GM=500e3) == [("good", ""), ("doubtful", "impedance"), ("bad", "impedance")]
    assert verdicts(TA=np.inf)[0] == ("bad", "not connected")
    x[:, 1] = x[:, 0]
    assert verdicts(TA=60e3)[0] == ("bad", "same signal") and verdicts(SO=np.inf)[1] == ("bad", "not connected")


@pytest.mark.nightly
def test_the_check_shows_impedances_before_rest_and_contraction(kinegraph: Command) -> None:
    """The board of two electrode pairs, at its port, through the command that a laboratory calls."""
    graph = (
        "nodes:\n  board: {use: devices.cyton.Cyton, port: %s, channels: [TA, SO, c, d, e, f, g, h], settings: [%s]}\n"
        "  muscles: {use: operators.filters.channels.Select, from: board.emg, channels: [TA, SO]}\nrecord: [muscles]\n"
    )
    rest = ", ".join(f"{{channel: {k}, power: false}}" for k in range(3, 9))
    pairs = "{channel: 1, srb2: false}, {channel: 2, srb2: false}"
    with SimulatedCyton(impedances_kohm=(8.0, 9.0, 12.0, 900.0)).serving() as port:
        Path("g.yaml").write_text(graph % (port, f"{pairs}, {rest}"))
        times = ("--rest", "0-2", "--contraction", "2-5", "--emg", "muscles")
        code, shown, output = kinegraph("emg", "check-electrodes", "g.yaml", *times)
        assert code == 1 and "keep still" in output and "SO impedance" in output, (shown, output)
        assert "impedance (kOhm)" in shown and "8/9" in shown and "12/90" in shown
        code, shown, output = kinegraph("emg", "check-electrodes", "g.yaml", *times, "--no-impedance")
        assert code == 0 and "impedance" not in shown + output, (shown, output)
