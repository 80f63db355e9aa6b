"""Dotted names of classes, as graphs write them."""

from __future__ import annotations

import sys

ROOT = "kinegraph."
PACKAGES = ("stream", "devices", "operators")
"""What graphs name without `kinegraph.` before it."""


def module_of(use: str) -> str:
    """The module that Python imports for a graph's dotted name: ours lie within kinegraph, all others are as they are written."""
    return ROOT + use if use.partition(".")[0] in PACKAGES else use


def use_of(cls: type) -> str:
    """The shortest dotted path of a class, as a graph writes it: "operators.emg.Envelope"."""
    module = cls.__module__
    while (above := module.rpartition(".")[0]) and vars(sys.modules[above]).get(cls.__name__) is cls:
        module = above
    return f"{module}.{cls.__qualname__}".removeprefix(ROOT)


def is_ours(module: str) -> bool:
    """Whether a module comes with kinegraph."""
    return module.partition(".")[0] + "." == ROOT
