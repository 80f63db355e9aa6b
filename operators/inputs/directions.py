"""Which axis of an input points up: what its stream declares, or what a parameter says of one that declares nothing."""

from __future__ import annotations

from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.domain.axes import Axes, Up
from kinegraph.stream.errors import InputError, ParameterError

HELP = "the input's axis that points up; left out: as the input declares, else"
TURN = "in other axes: operators.filters.turn_axes.TurnAxes turns them"


def axes_of(spec: StreamSpec, up: str | None, usual: Up) -> Axes:
    """The axes of an input, with `up` from a parameter. Raises ParameterError if it contradicts the stream's declaration."""
    declared = Axes.of(spec)
    if declared and up not in (None, declared.up):
        raise ParameterError("up", up, f"left out: the input declares {declared.describe()}")
    return declared or Axes(up or usual)


def right_handed_up(spec: StreamSpec, up: str | None, usual: Up, allowed: tuple[str, ...]) -> str:
    """The axis that points up, one of those `allowed`, of right-handed points. Raises InputError and ParameterError."""
    axes = axes_of(spec, up, usual)
    if axes.left_handed or axes.up not in allowed:
        raise InputError(
            "in", f"points with {axes.describe()}", f"right-handed, with {' or '.join(allowed)} up; {TURN}"
        )
    return axes.up


def turned_to(wanted: Axes | None, spec: StreamSpec) -> tuple[tuple[int, int, int], tuple[float, float, float]]:
    """By coordinate of the wanted axes: which of the input's it is, and its sign. As they are, where one of both declares no axes."""
    own = Axes.of(spec)
    return own.to(wanted) if own and wanted else ((0, 1, 2), (1.0, 1.0, 1.0))
