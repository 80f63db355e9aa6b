"""A stream's channels by name, or by number."""

from __future__ import annotations

from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.errors import ParameterError, nearest


def names_of(spec: StreamSpec) -> tuple[str, ...]:
    """A stream's channel names, or its channels' numbers as texts."""
    return spec.channels or tuple(map(str, range(spec.shape[spec.channel_axis])))


def find_channel(spec: StreamSpec, given: str | int, parameter: str) -> int:
    """The place of a channel that a parameter names, or numbers from 0."""
    names = names_of(spec)
    if isinstance(given, int) and str(given) not in names:
        if 0 <= given < len(names):
            return given
        raise ParameterError(parameter, given, f"a channel's name, or a number from 0 to {len(names) - 1}")
    if str(given) not in names:
        raise ParameterError(parameter, given, f"a channel of the input; {nearest(str(given), names)}")
    return names.index(str(given))


def the_channel(spec: StreamSpec, given: str | int | None, parameter: str = "channel") -> int:
    """The place of the one channel that an operator works on, which a parameter must name where there are several."""
    if given is not None:
        return find_channel(spec, given, parameter)
    if spec.shape[0] != 1:
        raise ParameterError(parameter, None, f"one of {', '.join(map(repr, names_of(spec)))}")
    return 0
