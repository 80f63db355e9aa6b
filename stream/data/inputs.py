"""What an operator declares of its input ports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from kinegraph.stream.errors import KinegraphError

ANY = "*"
"""In `Operator.inputs`, in the place of a name: any number of inputs."""


@dataclass(frozen=True, slots=True)
class Input:
    """An input port.

    rows      numbers come as C-contiguous float64 (n, width), whatever the dtype and shape of a sample was
    finite    numbers come as rows, in which NaN stands for what is not a finite number
    trigger   its samples trigger output: at equal stamps they come after all others; several triggers come in their declared order.
              No answer depends on the order of the other ports (the law "ties"). Where an operator has triggers, empty chunks, which
              say that time has passed, come on these alone until the streams end
    optional  a graph may leave it unconnected
    revises   its events revise earlier reports, and delay nothing: `check` leaves their own delay out
    in_turn   its chunks are cut wherever another input's sample is due, so that samples come in global time order. Off, for operators that
              wait for `until` in any case (joins): each input's own order, and far fewer pieces. Either way a piece's `until` holds for all
              inputs at once
    """

    rows: bool = False
    finite: bool = False
    trigger: bool = False
    optional: bool = False
    revises: bool = False
    in_turn: bool = True


def input_of(inputs: Mapping[str, Input], port: str) -> Input:
    """The declaration of a port, also of one that was named after what it is connected to."""
    if not isinstance(inputs, Mapping):
        raise KinegraphError(f"inputs is {inputs!r}; it must be a mapping of names to Input(), as in {{'in': Input()}}")
    return inputs[port] if port in inputs else inputs[ANY]
