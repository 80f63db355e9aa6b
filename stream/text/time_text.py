"""Durations, rates and clock times as people read them. Each rounds first and is split afterwards: no "1:60.0 min"."""

from __future__ import annotations

from datetime import UTC, datetime, tzinfo
from math import isfinite

NS = 1_000_000_000
YEAR_NS = 366 * 86_400 * NS
NOT_KNOWN = "–"


def duration(seconds: float) -> str:
    """How long something is.

    >>> duration(59.994), duration(59.996), duration(119.96), duration(3599.97), duration(3661.0)
    ('59.99 s', '1:00.0 min', '2:00.0 min', '1:00:00.0 h', '1:01:01.0 h')
    """
    if not isfinite(seconds):
        return NOT_KNOWN
    if round(seconds, 2) < 60:
        return f"{seconds:.2f} s"
    minutes, tenths = divmod(round(10 * seconds), 600)
    hours, minutes = divmod(minutes, 60)
    rest = f"{tenths // 10:02d}.{tenths % 10}"
    return f"{hours}:{minutes:02d}:{rest} h" if hours else f"{minutes}:{rest} min"


def delay(seconds: float) -> str:
    """How late something is, to four digits.

    >>> delay(0.024), delay(9.9994), delay(9.9996), delay(12345.6)
    ('24 ms', '9999 ms', '10 s', '12346 s')
    """
    if not isfinite(seconds):
        return NOT_KNOWN
    if seconds < 9.9995:
        return f"{seconds * 1e3:.4g} ms"
    return f"{seconds:.4g} s" if seconds < 9999.5 else f"{seconds:.0f} s"


def about(seconds: float) -> str:
    """About how long a stretch lasts: whole seconds, or minutes to three digits.

    >>> about(89.4), about(90.0), about(59970.0)
    ('89 s', '1.5 min', '1000 min')
    """
    if round(seconds) < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.3g} min" if seconds < 999.5 * 60 else f"{seconds / 60:.0f} min"


def elapsed(seconds: float, *, hours: bool = True) -> str:
    """What a clock shows that counts up: whole seconds that have passed, with or without `hours`.

    >>> elapsed(59.99), elapsed(3599.99), elapsed(3600.0), elapsed(3600.0, hours=False)
    ('0:59', '59:59', '1:00:00', '60:00')
    """
    if not isfinite(seconds):
        return NOT_KNOWN
    minutes, rest = divmod(int(seconds), 60)
    if hours and minutes >= 60:
        return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"
    return f"{minutes}:{rest:02d}"


def in_hours(minutes: float | None) -> str:
    """The length of a night.

    >>> in_hours(59.6), in_hours(419.5), in_hours(None)
    ('1 h 00 min', '7 h 00 min', '–')
    """
    if minutes is None or not isfinite(minutes):
        return NOT_KNOWN
    whole = round(minutes)
    return f"{whole // 60} h {whole % 60:02d} min"


def hour_of_day(hours_after_noon: float) -> str:
    """A time of day.

    >>> hour_of_day(10.5), hour_of_day(11.9999), hour_of_day(12.0)
    ('22:30', '00:00', '00:00')
    """
    if not isfinite(hours_after_noon):
        return NOT_KNOWN
    minutes = round(60 * hours_after_noon)
    return f"{(minutes // 60 + 12) % 24:02d}:{minutes % 60:02d}"


def moment(stamp: int, decimals: int = 3) -> str:
    """A stamp (ns) in UTC, as far as it has passed; one near 1970 is that of a file without a date, and is shown in seconds.

    >>> moment(1_700_000_000_999_999_999), moment(1_700_000_000_999_999_999, 0), moment(1_500_000_000)
    ('2023-11-14 22:13:20.999 UTC', '2023-11-14 22:13:20 UTC', '1.500 s')
    """
    if not 0 <= stamp < 1 << 62 and abs(stamp) >= YEAR_NS:
        return "the end of time" if stamp > 0 else "before time"
    if abs(stamp) < YEAR_NS:
        return f"{stamp / NS:.{decimals}f} s"
    whole, rest = divmod(stamp, NS)
    fraction = f".{rest:09d}"[: decimals + 1] if decimals else ""
    return f"{datetime.fromtimestamp(whole, UTC):%Y-%m-%d %H:%M:%S}{fraction} UTC"


def minute(stamp: int) -> str:
    """A stamp (ns) to the minute: "2026-11-21 01:02 UTC"."""
    return f"{datetime.fromtimestamp(stamp // NS, UTC):%Y-%m-%d %H:%M} UTC"


def now() -> str:
    """This minute, for "made at"."""
    return f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"


def for_names() -> str:
    """This second, as the names of files and folders have it: "20261121T010203Z"."""
    return f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}"


def time_of_day(stamp: int, zone: tzinfo = UTC) -> str:
    """A stamp (ns) as a time of day: "01:02:03 UTC"."""
    return f"{datetime.fromtimestamp(stamp // NS, zone):%H:%M:%S %Z}"


def rate(hz: float | None, decimals: int | None = None) -> str:
    """Samples per second, to six digits, or to `decimals` decimals; never in powers of ten.

    >>> rate(1000.0), rate(999.99996), rate(33.333333), rate(2_000_000.0), rate(999.996, 2), rate(None)
    ('1000', '1000', '33.3333', '2000000', '1000.00', '')
    """
    if hz is None or not isfinite(hz):
        return ""
    if decimals is not None:
        return f"{hz:.{decimals}f}"
    text = f"{hz:g}"
    return f"{float(text):.0f}" if "e+" in text else text
