"""GENEActiv: .bin files, text with pages of 300 samples in hexadecimal. Source: the operating instructions, "Decoding .bin files"."""

from __future__ import annotations

import re
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.import_result import Asked, RateMissing, Understood
from kinegraph.devices.formats.lab.text_lines import TextLines, is_number
from kinegraph.devices.formats.wearables import UNTRIED
from kinegraph.stream.chunk import Samples

PAGE = "Recorded Data"
SAMPLE = 12
"""Hexadecimal digits of a sample: x, y, z of 12 bits, light of 10, the button, one bit of nothing."""


def knows(head: str) -> bool:
    return head.startswith("Device Identity") and ("GENEActiv" in head or "GENEA" in head)


def read_bin(path: Path, asked: Asked) -> Understood:
    """.acc (g), .light (lux), .temperature (a page's), .markers where the button was pressed. Raises RecordingError."""
    made, text = Understood(path, "GENEActiv", doubts=[UNTRIED]), TextLines.read(path)
    begin = next((k for k, line in enumerate(text.lines) if line.strip() == PAGE), len(text.lines))
    facts = _facts(text.lines[:begin])
    rate = _number(facts, "measurement frequency") or asked.rate_hz
    if not rate:
        raise RateMissing(f"{path}: its header states no measurement frequency; give --rate HZ")
    pages, warmth, times = list[Samples](), list[float](), list[datetime]()
    at = begin
    while at < len(text.lines):
        end = next((k for k in range(at + 1, len(text.lines)) if text.lines[k].strip() == PAGE), len(text.lines))
        own = _facts(text.lines[at:end])
        digits = text.lines[end - 1].strip()
        if not re.fullmatch(r"[0-9A-Fa-f]+", digits) or len(digits) < SAMPLE:
            made.doubt(f"line {end}: a page without samples, left out; was the file cut off?")
        else:
            pages.append(_samples(digits))
            warmth.append(_number(own, "temperature") or np.nan)
            times.append(_moment(text, at, own.get("page time", "")))
        at = end
    if not pages:
        raise text.wrong(max(0, begin - 1), "there are no pages of samples in it")
    lost = np.zeros(sum(map(len, pages)), np.int64)
    where = 0
    for k, page in enumerate(pages):
        if k:
            lost[where] = max(0, round((times[k] - times[k - 1]).total_seconds() * rate) - len(pages[k - 1]))
        where += len(page)
    rows = np.concatenate(pages)
    gain = np.array([_number(facts, f"{axis} gain") or 1.0 for axis in "xyz"])
    offset = np.array([_number(facts, f"{axis} offset") or 0.0 for axis in "xyz"])
    made.add("acc", (rows[:, :3] * 100.0 - offset) / gain, rate, channels=("x", "y", "z"), units=("g",), lost=lost)
    lux = (_number(facts, "lux") or 1.0) / (_number(facts, "volts") or 1.0)
    made.add("light", rows[:, 3:4] * lux, rate, channels=("light",), units=("lux",), lost=lost)
    if len(pages) > 1 and not lost.any():
        made.add(
            "temperature", np.array(warmth)[:, None], rate / len(pages[0]), channels=("temperature",), units=("degC",)
        )
    index = np.arange(len(rows)) + np.cumsum(lost)
    pressed = np.flatnonzero((rows[:, 4] > 0) & ~(np.roll(rows[:, 4], 1) > 0))
    if len(pressed):
        made.add_events("markers", (index[pressed] / rate).tolist())
    if serial := facts.get("device unique serial code"):
        made.facts["device"] = f"GENEActiv {serial}"
    made.local_time(times[0].replace(tzinfo=_zone(facts.get("time zone", ""))))
    return made


def _facts(lines: list[str]) -> dict[str, str]:
    pairs = (line.partition(":") for line in lines if ":" in line)
    return {key.strip().lower(): value.strip() for key, _, value in pairs}


def _number(facts: dict[str, str], key: str) -> float:
    """The number that a value begins with; 0.0: there is no such value."""
    text = (facts.get(key, "").split() or [""])[0]
    return float(text.replace(",", ".")) if is_number(text) else 0.0


def _samples(digits: str) -> Samples:
    """x, y, z, light and button (n, 5), in counts."""
    count = len(digits) // SAMPLE
    octets = np.frombuffer(bytes.fromhex(digits[: count * SAMPLE]), np.uint8).reshape(count, 6).astype(np.int64)
    whole = octets @ (1 << np.arange(40, -1, -8, dtype=np.int64))
    axes = np.stack([whole >> 36 & 4095, whole >> 24 & 4095, whole >> 12 & 4095], axis=1)
    axes = np.where(axes > 2047, axes - 4096, axes)
    return np.column_stack([axes, whole >> 2 & 1023, whole >> 1 & 1]).astype(np.float64)


def _moment(text: TextLines, at: int, written: str) -> datetime:
    """2012-05-23 16:47:50:000."""
    found = re.match(r"(\d{4}-\d{2}-\d{2})[ T](\d{2}:\d{2}:\d{2})(?:[:.,](\d{1,3}))?", written)
    if not found:
        raise text.wrong(at, f"the page below has no time: {written!r}")
    return datetime.fromisoformat(f"{found[1]}T{found[2]}") + timedelta(milliseconds=int(found[3] or 0))


def _zone(text: str) -> timezone | None:
    found = re.search(r"GMT\s*([+-])\s*(\d{1,2}):(\d{2})", text)
    if not found:
        return None
    offset = timedelta(hours=int(found[2]), minutes=int(found[3]))
    return timezone(-offset if found[1] == "-" else offset)
