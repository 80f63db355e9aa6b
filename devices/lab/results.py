"""The result of a session in one line: what its answer panel shows at the end, from its recording."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.stream.chunk import Array, Times
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph.reading.load import load_page
from kinegraph.stream.recording import Recording
from kinegraph.stream.text.units import shown as micro

SENTENCE = re.compile(r'<p class="sentence">(.*?)</p>', re.DOTALL)
MAX_SENTENCE = 300


def result_of(folder: Path) -> str:
    """The last answer ("104 cycles, 108 steps/min, 62 % stance"); "" where nothing of it was recorded."""
    try:
        with Recording.open(folder) as recording:
            streams = recording.streams
            options = load_page(str(recording.header.get("graph", "")), streams).options
            items = [item for panel in options.panels if panel["kind"] == "answer" for item in panel.get("show", ())]
            return ", ".join(_words(recording, items)) or _of_report(folder)
    except (KinegraphError, OSError):
        return _of_report(folder)


def _of_report(folder: Path) -> str:
    """The sentence under the title of a session's report: of a night that was not recorded, all there is."""
    for page in sorted(folder.rglob("*.html")):
        if found := SENTENCE.search(page.read_text(encoding="utf-8", errors="replace")):
            return " ".join(unescape(re.sub(r"<[^>]*>", "", found[1])).split())[:MAX_SENTENCE]
    return ""


def _words(recording: Recording, items: list[Mapping[str, Any]]) -> Iterator[str]:
    for item in items:
        stream = recording.streams.get(str(item.get("of", "")))
        if stream is None or stream.first is None:
            continue
        if not stream.spec.is_event:
            continue  # a signal's last sample is no result of a session
        time, data = recording.read(str(item["of"]))
        text = shown(item, time, data)
        if text:
            unit = item.get("unit") or (micro(stream.spec.unit_of(item["field"])) if item.get("field") else "")
            label = str(item.get("label", ""))
            yield " ".join(filter(None, [text, str(unit), label] if text[-1].isdigit() else [label, text])) + _limits(
                item, data
            )


def _limits(item: Mapping[str, Any], data: Array) -> str:
    factor, decimals = float(item.get("factor", 1)), int(item.get("decimals", 0))
    found = [f"{data[name][-1] * factor:.{decimals}f}" for name in item.get("between", ()) if len(data)]
    return f" ({' to '.join(found)})" if found else ""


def shown(item: Mapping[str, Any], time: Times, data: Array) -> str:
    """What an item of an answer shows of a stream's events: the newest that fits, or how many there are."""
    keep = np.ones(len(time), bool)
    for name, wanted in dict(item.get("where") or {}).items():
        keep &= np.isin(data[name], wanted if isinstance(wanted, list) else [wanted])
    data = data[keep]
    if item.get("count"):
        return str(len(data))
    field = item.get("field")
    if not len(data) or not field:
        return ""
    value = data[field][-1]
    if data.dtype[field].kind in "iub" and not item.get("values"):
        return str(int(value))
    if data.dtype[field].kind == "f":
        factor = float(item.get("factor", 1))
        return f"{float(value) * factor:.{int(item.get('decimals', 0))}f}" if np.isfinite(value) else ""
    return str(dict(item.get("values") or {}).get(str(value), value))
