"""A JSON file with one object: a calibration, a reference, whatever a person may want to read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.atomic_file import write_complete


def read_json(path: Path, kind: str, error: type[KinegraphError] = KinegraphError, advice: str = "") -> dict[str, Any]:
    """The object in a file, which must be `kind` ("a calibration"); raises `error` for a file that is missing, broken or no object."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except OSError as failed:
        raise error(f"{path}: cannot be read: {failed.strerror}{advice and '; ' + advice}") from None
    except (ValueError, RecursionError) as failed:
        raise error(f"{path}: is not {kind} (not JSON: {failed})") from None
    if not isinstance(found, dict):
        raise error(f"{path}: is not {kind} (a JSON {type(found).__name__}, not an object)")
    return found


def write_json(path: Path, record: Mapping[str, Any], error: type[KinegraphError] = KinegraphError) -> None:
    """Write an object; the file appears when it is complete. Raises `error` where it cannot be written."""
    text = json.dumps(record, indent=2, allow_nan=False)
    try:
        write_complete(path, text + "\n")
    except OSError as failed:
        raise error(f"{path}: cannot be written: {failed.strerror}") from None
