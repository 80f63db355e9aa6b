"""Every package that comes with kinegraph says under which licence it is."""

from __future__ import annotations

import re
from importlib.metadata import distribution, requires

import pytest

from tests.licences import by_text, licence


def named(requirement: str) -> str:
    return re.split(r"[^A-Za-z0-9._-]", requirement)[0]


@pytest.mark.parametrize(
    "name",
    sorted({named(one) for one in requires("kinegraph") or [] if "extra ==" not in one}),
)
def test_what_is_installed_with_kinegraph_states_its_licence(name: str) -> None:
    reported = licence(distribution(name))
    assert reported and "\n" not in reported and "GPL" not in reported.replace("LGPL", "")


def test_a_licence_is_known_by_its_text() -> None:
    assert by_text("Copyright (c) 2018 X\n\nPermission is hereby granted, free of charge, to any person") == "MIT"
    assert by_text("Redistribution and use in source and binary forms, with or without") == "BSD-2-Clause"
    assert by_text("All rights reserved.") == ""
