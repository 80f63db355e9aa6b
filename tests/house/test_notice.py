"""NOTICE names everything in the wheel that somebody else wrote, and where each model comes from."""

from __future__ import annotations

import json
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NOTICE = (ROOT / "NOTICE").read_text(encoding="utf-8")


def test_every_package_in_the_pages_bundle_is_named() -> None:
    package = json.loads((ROOT / "devices" / "page" / "web" / "package.json").read_text(encoding="utf-8"))
    named = {"three": "three.js", "uplot": "uPlot", "preact": "Preact"}
    assert all(named.get(name, name) in NOTICE for name in package["dependencies"])


def test_every_shipped_model_has_an_origin() -> None:
    shipped = [
        path
        for folder in ("operators", "devices")
        for end in ("npz", "vrm", "csv")
        for path in (ROOT / folder).rglob(f"*.{end}")
    ]
    assert shipped and all(path.relative_to(ROOT).as_posix() in NOTICE for path in shipped)
