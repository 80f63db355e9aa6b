"""Volts of muscles beside newtons are refused, be it of two channels."""

from __future__ import annotations

import pytest

from kinegraph.operators.emg.one_kind import refuse_mixed
from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.errors import InputError


def test_two_channels_of_two_kinds_are_refused_and_of_one_are_not() -> None:
    for units in (("mV",), ("mV", "uV"), ("N", "N")):
        refuse_mixed(StreamSpec((2,), rate_hz=1000.0, channels=("TA", "Fz"), units=units))
    with pytest.raises(InputError, match="Fz beside voltages"):
        refuse_mixed(StreamSpec((2,), rate_hz=1000.0, channels=("TA", "Fz"), units=("mV", "N")))
