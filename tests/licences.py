"""`python -m tests.licences`: under which licence each installed package is, as it says itself or as its licence file shows."""

from __future__ import annotations

import re
from importlib.metadata import Distribution, distributions

WORDS = {
    "MIT": r"MIT License|Permission is hereby granted, free of charge",
    "Apache-2.0": r"Apache License\s+Version 2\.0",
    "BSD-3-Clause": r"Redistribution and use in source and binary forms[\s\S]*endorse or promote",
    "BSD-2-Clause": r"Redistribution and use in source and binary forms",
    "ISC": r"ISC License|Permission to use, copy, modify, and(/or)? distribute this software",
    "Unlicense": r"free and unencumbered software released into the public domain",
    "PSF-2.0": r"Python Software Foundation License|License agreement for matplotlib",
    "MPL-2.0": r"Mozilla Public License,? (Version|v\.) 2\.0",
}
"""Words by which a licence's own text is known; the first that is found counts."""


def licence(package: Distribution) -> str:
    """In the package's own words; by its licence file; '' where neither says."""
    reported = package.metadata
    words = next(filter(None, (reported.get(key, "").strip() for key in ("License-Expression", "License"))), "")
    classified = [
        line.rpartition(" :: ")[2] for line in reported.get_all("Classifier", []) if line.startswith("License ::")
    ]
    if words and words.upper() != "UNKNOWN":
        return by_text(words) or (words if "\n" not in words else ", ".join(classified))
    return ", ".join(classified) or next(filter(None, map(by_text, files(package))), "")


def files(package: Distribution) -> list[str]:
    named = [path for path in package.files or [] if re.search(r"licen[cs]e|copying", path.name, re.IGNORECASE)]
    return [path.read_text(encoding="utf-8") for path in named if path.suffix in ("", ".txt", ".md", ".rst")]


def by_text(text: str) -> str:
    return next((name for name, pattern in WORDS.items() if re.search(pattern, text, re.IGNORECASE)), "")


def main() -> None:
    found = {package.name: package for package in distributions()}
    for name, package in sorted(found.items(), key=lambda item: item[0].lower()):
        print(f"{name} {package.version}: {licence(package) or 'not stated'}")


if __name__ == "__main__":
    main()
