"""Units as people read them: files and specs hold "uV", which every program can write; what is shown is "µV"."""

from __future__ import annotations

import re

MICRO = re.compile(r"(?<![^\W\d])u(?=[VST](?!\w))|^u(?=[sm]$)")
"""The u of a unit that stands by itself or behind a number: "uV", "12uV s", "uV/V"; not that of a word or a name."""


def shown(text: object) -> str:
    """A unit, or a text with units, with the micro sign.

    >>> shown("uV s"), shown("us"), shown("13 channels in uV"), shown("it tells us of emg_uV")
    ('µV s', 'µs', '13 channels in µV', 'it tells us of emg_uV')
    """
    return MICRO.sub("µ", str(text))
