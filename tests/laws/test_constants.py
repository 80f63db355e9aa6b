"""Numbers that a module declares are those that were kept: `python -m tests.constants --write` after a change on purpose."""

from __future__ import annotations

import json

import pytest

from tests.constants import KEPT, declared, modules

HELD = json.loads(KEPT.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", [name for name in modules() if name in HELD])
def test_it_declares_what_it_did(name: str) -> None:
    assert declared(name) == HELD[name], "if that is meant: python -m tests.constants --write"


def test_no_module_is_kept_that_is_gone() -> None:
    assert set(HELD) <= set(modules())
