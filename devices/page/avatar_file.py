"""The figure that a page shows: a VRM file."""

from __future__ import annotations

from pathlib import Path

from kinegraph.stream.errors import KinegraphError

AVATAR = Path(__file__).with_name("avatar.vrm")
"""A mannequin: `python -m tests.mannequin` makes it."""
MAX_AVATAR = 128 << 20


def checked_avatar(path: Path | None) -> Path:
    """The avatar that a page shows: this file, or the one that comes with it. Raises KinegraphError for one that cannot be shown."""
    if path is None:
        return AVATAR
    from kinegraph.devices.formats.gltf.vrm_reader import read_vrm  # loads scipy

    if not path.is_file():
        raise KinegraphError(f"avatar {path}: there is no such file; it must be a VRM file")
    if path.stat().st_size > MAX_AVATAR:
        raise KinegraphError(f"avatar {path}: {path.stat().st_size >> 20} MB; at most {MAX_AVATAR >> 20}")
    read_vrm(path)
    return path.resolve()
