"""Units as people read them: files and specs hold "uV", which every program can write; what is shown is "µV"."""

from __future__ import annotations

import re
from difflib import get_close_matches

MICRO = re.compile(r"(?<![^\W\d])u(?=[VST](?!\w))|^u(?=[sm]$)")
"""The u of a unit that stands by itself or behind a number: "uV", "12uV s", "uV/V"; not that of a word or a name."""

SQUARE = re.compile(r"(?<![^\W\d])m/s(?:\^?2)(?!\w)")


def shown(text: object) -> str:
    """A unit, or a text with units, with the micro sign and the square.

    >>> shown("uV s"), shown("us"), shown("3 channels in m/s2"), shown("it tells us of emg_uV")
    ('µV s', 'µs', '3 channels in m/s²', 'it tells us of emg_uV')
    """
    return SQUARE.sub("m/s²", MICRO.sub("µ", str(text)))


WRITTEN = {
    "newton": "N", "volt": "V", "millivolt": "mV", "microvolt": "uV", "metre": "m", "meter": "m", "centimetre": "cm", "centimeter": "cm",
    "millimetre": "mm", "millimeter": "mm", "second": "s", "millisecond": "ms", "microsecond": "us", "nanosecond": "ns", "minute": "min",
    "degree": "deg", "degrees/s": "deg/s", "deg/sec": "deg/s", "dps": "deg/s", "radian": "rad", "radians/s": "rad/s", "hertz": "Hz",
    "kilogram": "kg", "pascal": "Pa", "hectopascal": "hPa", "tesla": "T", "microtesla": "uT", "ampere": "A", "percent": "%",
    "m/s^2": "m/s2", "m/s²": "m/s2", "m/s/s": "m/s2", "beats/min": "bpm", "newton metre": "Nm",
    "newton meter": "Nm", "siemens": "S", "microsiemens": "uS",
}  # fmt: skip
"""Units by their names, and as others write them: what is written here."""
KNOWN = {*WRITTEN.values(), "km/h", "1/min", "m/s", "counts", "mT", "mm2", "px", "nV", "ohm", "kohm"}


def known_unit(unit: str) -> str:
    """The known unit that another spelling of it means; "" for one that is written so, and for one that is not known at all.

    >>> known_unit("newtons"), known_unit("UV"), known_unit("uV"), known_unit("spoons")
    ('N', 'uV', '', '')
    """
    text = unit.strip()
    if not text or unit in KNOWN or unit.replace("µ", "u").replace("μ", "u") in KNOWN:
        return ""
    same = [known for known in KNOWN if known.lower() == text.lower()]
    if same:
        return same[0]
    close = get_close_matches(text.lower(), WRITTEN, n=1, cutoff=0.88) if len(text) > 2 else []
    return WRITTEN[close[0]] if close else ""
