"""A run that delivers less than it was offered ends with exit code 5, whatever lost it, and says what is missing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
import pytest

from kinegraph.devices.mqtt.message_queue import MessageQueue, MessageQueueState
from kinegraph.devices.mqtt.outlet import MqttOutlet
from kinegraph.devices.outlets.csv_file import CsvFile
from kinegraph.devices.outlets.trigger.outlet import TriggerOutlet
from kinegraph.stream.batch.manifest import JobEntry
from kinegraph.stream.batch.study import BatchState
from kinegraph.stream.chunk import Chunk, Specs, StreamSpec
from kinegraph.stream.engine.flow.queues import BoundedQueue
from kinegraph.stream.engine.session import exit_code
from kinegraph.stream.engine.shortfall import INCOMPLETE, shortfalls
from kinegraph.stream.engine.workers import Workers
from kinegraph.stream.errors import DeviceError, RunError
from kinegraph.stream.graph import Edge
from kinegraph.stream.graph.backpressure import Policy
from kinegraph.stream.graph.components import catalogue
from kinegraph.stream.graph.model import NodeOptions
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.recording import RecorderStatus

SPEC = StreamSpec((1,), rate_hz=1000.0)
OUTLETS = [use for use, part in catalogue(("devices",))[0].items() if issubclass(part, Outlet)]


@dataclass(frozen=True, slots=True)
class Quiet(Outlet[None]):
    """An outlet by itself lacks nothing."""

    def open(self, specs: Specs) -> Specs:
        self.set_state(None)
        return {}


def stage_of(operator: Outlet[Any], name: str = "csv", policy: Policy | None = None, failed: str = "") -> Any:
    """What the rule sees of an outlet in a session."""
    node = SimpleNamespace(name=name, is_outlet=True, options=NodeOptions(queue=4, policy=policy))
    return SimpleNamespace(node=node, operator=operator, worker="outlets", slot=None, failed=failed, limits=[])


def sample(k: int) -> Chunk:
    return Chunk(np.array([k]), np.zeros((1, 1)), k)


@pytest.mark.parametrize("policy", [None, *get_args(Policy)])
@pytest.mark.parametrize("use", OUTLETS)
def test_whatever_the_queue_of_an_outlet_drops_is_missing(use: str, policy: Policy | None) -> None:
    """Left open, the policy of every outlet of a live session is to drop; one that blocks or fails loses nothing."""
    workers, stage = (
        Workers(SimpleQueue(), False, lambda error: None, lambda **facts: None),
        stage_of(Quiet(), use, policy),
    )
    put = workers.bridge(stage, "in", Edge("board", "emg"), lambda chunk, start: start)
    for k in range(4):
        put(sample(k), 0)
    assert shortfalls([stage], workers.queues) == {}
    if policy == "block":
        return
    if policy == "fail":
        with pytest.raises(RunError):
            put(sample(4), 0)
        return
    put(sample(4), 0)
    put(sample(5), 0)
    missing = shortfalls([stage], workers.queues)
    assert missing == {use: "2 samples dropped: it was too slow for what came"}
    assert exit_code(None, False, missing) == INCOMPLETE


def test_what_a_sources_queue_drops_is_missing_and_what_an_operators_drops_is_in_the_recording() -> None:
    queue = BoundedQueue("board.emg", SimpleQueue(), 1, "drop_oldest")
    for k in range(3):
        queue.put(sample(k))
    assert shortfalls(inputs=[SimpleNamespace(queue=queue)]) == {
        "board.emg": "2 samples dropped: it was too slow for what came"
    }
    assert shortfalls([stage_of(Quiet())], {"board.emg -> network.in": queue}) == {}


def test_an_outlet_that_was_switched_off_is_missing() -> None:
    assert shortfalls([stage_of(Quiet(), failed="the network is down")]) == {"csv": "the network is down"}


@pytest.mark.parametrize(
    ("status", "missing"),
    [
        (RecorderStatus(9, 0.0, {}, ""), {}),
        (RecorderStatus(9, 0.0, {"board": 3}, ""), {"recording": "not recorded: 3 chunks of board"}),
        (RecorderStatus(9, 2.0, {}, "No space left on device"), {"recording": "No space left on device"}),
        (RecorderStatus(9, 0.0, {}, "", "missing: 5 samples before its first file"),
         {"recording": "missing: 5 samples before its first file"}),
    ],
)  # fmt: skip
def test_what_a_recording_lacks_is_missing(status: RecorderStatus, missing: dict[str, str]) -> None:
    assert shortfalls(recording=status) == missing


def test_a_history_that_the_broker_did_not_get_is_missing() -> None:
    outlet = MqttOutlet(entities={})
    outlet.open({"epochs": SPEC})
    assert shortfalls([stage_of(outlet, "home")]) == {}
    outlet.runtime.messages = MessageQueue(MessageQueueState("s"), lambda topic, text, retain: None)
    outlet.runtime.messages.post("history", 1, "{}")
    assert "did not get 1 events of the history" in shortfalls([stage_of(outlet, "home")])["home"]


def test_trigger_pulses_that_were_not_given_are_missing() -> None:
    outlet = TriggerOutlet(serial_port="/dev/ttyUSB0")
    outlet.open({"in": SPEC})
    outlet.runtime.lost = 2
    assert shortfalls([stage_of(outlet)]) == {
        "csv": "2 trigger pulses were not given: the serial port /dev/ttyUSB0 is gone"
    }


def test_a_table_that_was_deleted_while_it_was_written_fails(tmp_path: Path) -> None:
    outlet = CsvFile(path=str(tmp_path / "t.csv"))
    outlet.open({"in": SPEC})
    outlet.begin()
    outlet.process("in", sample(1))
    (tmp_path / "t.csv").unlink()
    with pytest.raises(DeviceError, match=r"t\.csv was deleted or moved while it was written"):
        outlet.close()


def test_outputs_that_a_batch_leaves_out_of_its_tables_are_missing() -> None:
    tally = BatchState(1)
    tally.add(JobEntry("k", "s1", {}, "done", "", left_out={"scaled": "samples do not fit into a table"}), True)
    assert tally.left_out == {"scaled": "samples do not fit into a table"}


@pytest.mark.parametrize(("error", "down", "code"), [(RunError("x"), True, 4), (None, True, 3), (None, False, 5)])
def test_an_error_and_a_missing_device_say_more_than_what_is_missing(
    error: Exception | None, down: bool, code: int
) -> None:
    assert exit_code(error, down, {"csv": "2 samples dropped"}) == code
