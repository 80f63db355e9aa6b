"""Skeletons of operators and devices: files that work as they stand, with tests that pass, to be changed into what is wanted."""

from __future__ import annotations

import keyword
import re
import sys
from importlib.resources import files
from pathlib import Path
from string import Template

from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.atomic_file import write_complete
from kinegraph.stream.system.names import PACKAGES

FILES = {
    "operator": {"operator": "{}.py", "operator_test": "test_{}.py", "operator_graph": "{}.yaml"},
    "device": {
        "device_protocol": "{}_protocol.py",
        "device": "{}.py",
        "device_simulator": "{}_simulator.py",
        "device_test": "test_{}.py",
        "device_graph": "{}.yaml",
    },
}
"""Of each kind: the skeleton of every file, and what the file is called."""


def is_name(text: str) -> bool:
    """Whether it names what is to be made, rather than a port."""
    return text.isidentifier() and not re.fullmatch(r"COM\d+", text, re.IGNORECASE)


def write_skeleton(kind: str, name: str, folder: Path) -> list[Path]:
    """Write the files of a kind for the module `name` into `folder`; raises KinegraphError where one is there, or the name cannot be."""
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or keyword.iskeyword(name):
        raise KinegraphError(f"{name!r}: must be a module's name, small letters, digits and _, as in 'tiny_board'")
    if name in sys.stdlib_module_names or name in ("kinegraph", *PACKAGES, "numpy"):
        raise KinegraphError(f"{name!r}: is the name of a module that is installed; choose another")
    words = {"name": name, "Name": "".join(part.capitalize() for part in name.split("_"))}
    made = {folder / title.format(name): skeleton for skeleton, title in FILES[kind].items()}
    for path in made:
        if path.exists():
            raise KinegraphError(f"{path}: already exists; choose another name or --out")
    folder.mkdir(parents=True, exist_ok=True)
    for path, skeleton in made.items():
        text = files("kinegraph.devices.commands").joinpath("skeletons", f"{skeleton}.txt").read_text(encoding="utf-8")
        write_complete(path, Template(text).substitute(words))
    return list(made)
