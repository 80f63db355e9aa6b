"""The hash of what a function depends on: of an installed package's own modules too, and of no other library."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import pytest

from kinegraph.stream.compiler.fingerprint import fingerprint


def taken(root: Path, help_of: str, *, where: str) -> str:
    """The fingerprint of a function of the package `plugin`, with a helper in the package `where`: both installed in a new folder."""
    folder = root / str(len(list(root.iterdir()))) / "site-packages"
    for package in {"plugin", where}:
        (folder / package).mkdir(parents=True)
        (folder / package / "__init__.py").touch()
    (folder / where / "helper.py").write_text(f"def helped():\n    return {help_of}\n")
    (folder / "plugin" / "work.py").write_text(
        f"from {where}.helper import helped\n\n\ndef work():\n    return helped()\n"
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        try:
            return fingerprint(import_module("plugin.work").work)
        finally:
            for name in [n for n in sys.modules if n.partition(".")[0] in ("plugin", where)]:
                del sys.modules[name]


def test_an_installed_packages_own_modules_count(tmp_path: Path) -> None:
    first = taken(tmp_path, "1 + 1", where="plugin")
    assert first == taken(tmp_path, "1 + 1", where="plugin") != taken(tmp_path, "1 + 2", where="plugin")


def test_another_installed_package_does_not(tmp_path: Path) -> None:
    assert taken(tmp_path, "1 + 1", where="elsewhere") == taken(tmp_path, "1 + 2", where="elsewhere")
