"""A network's archive for an OAK camera (Luxonis' NNArchive): whether it is one, and which key points of a body it gives.

It is read without depthai, so that its errors are reported before a camera is opened.
"""

from __future__ import annotations

import json
import lzma
import tarfile
import zlib
from pathlib import Path
from typing import Any, NamedTuple

from kinegraph.devices.oak.keypoint_sets import SETS
from kinegraph.stream.errors import ParameterError

CONFIG = "config.json"
MAX_BYTES = 1 << 20
"""No config is larger."""
PARSER = "YOLO"
"""The kind of head that depthai itself decodes into detections with key points."""
KNOWN = ", ".join(f"{n} ({name})" for n, name in sorted((len(s.names), s.title) for s in SETS.values()))


class PoseArchive(NamedTuple):
    """What an archive says: the network's name, and how many key points a person has."""

    name: str
    points: int


def pose_archive(path: str) -> PoseArchive:
    """The archive at `path`. Raises ParameterError, which names the file and what to do about it."""
    config = _config(path)
    model = config.get("model")
    heads = model.get("heads") if isinstance(model, dict) else None
    if not isinstance(model, dict) or not isinstance(heads, list) or not heads:
        raise _wrong(path, "an archive whose config names the network's heads (this one was made without a parser)")
    found = []
    for head in heads:
        facts = head.get("metadata") if isinstance(head, dict) else None
        points = facts.get("n_keypoints") if isinstance(facts, dict) else None
        found.append(f"{head.get('parser') if isinstance(head, dict) else head} with {points or 'no'} key points")
        if isinstance(points, int) and points in SETS and head.get("parser") == PARSER:
            about = model.get("metadata")
            return PoseArchive(str(about.get("name", "")) if isinstance(about, dict) else "", points)
    raise _wrong(
        path,
        f"a pose network with the parser {PARSER} that gives key points of a body, one of {KNOWN}; "
        f"this one is {', '.join(found)}",
    )


def _wrong(path: str, accepts: str) -> ParameterError:
    return ParameterError("network", path, accepts)


def _config(path: str) -> dict[str, Any]:
    """The config in the archive."""
    if not Path(path).is_file():
        raise _wrong(
            path, "the path of a network's archive (NNArchive, .tar.xz) that is on this computer; no such file is there"
        )
    try:
        with tarfile.open(path) as archive:
            named = [m for m in archive.getmembers() if m.isfile() and m.name.removeprefix("./") == CONFIG]
            if not named:
                raise _wrong(path, f"an NNArchive: a tar archive with {CONFIG} in it; this archive lacks it")
            entry = archive.extractfile(named[0]) if named[0].size <= MAX_BYTES else None
            config = json.loads(entry.read()) if entry else None
    except (tarfile.TarError, EOFError, OSError, lzma.LZMAError, zlib.error) as error:
        why = str(error).partition("\n")[0].rstrip(":")
        raise _wrong(path, f"an NNArchive, a tar archive; it cannot be read as one ({why}): fetch it again") from None
    except ValueError as error:
        raise _wrong(path, f"an NNArchive with a readable {CONFIG}; this one is not JSON ({error})") from None
    if not isinstance(config, dict):
        raise _wrong(path, f"an NNArchive with a readable {CONFIG}; this one holds no settings")
    return config
