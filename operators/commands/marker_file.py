"""YAML files that name markers, for commands that learn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from kinegraph.stream.errors import KinegraphError


def marker_file(path: Path, meaning: str) -> dict[str, Any]:
    """What the file says; `markers` is a mapping, of what says `meaning`. Raises KinegraphError, with the file and what is wrong."""
    from kinegraph.stream.graph.reading.yaml_lines import parse

    try:
        content = parse(path.read_text(encoding="utf-8"), str(path)).plain()
    except OSError as error:
        raise KinegraphError(f"{path}: cannot be read: {error.strerror}") from None
    if not isinstance(content, dict) or not isinstance(content.get("markers"), dict) or not content["markers"]:
        raise KinegraphError(f"{path}: must hold `markers:`, a mapping of {meaning}")
    return content
