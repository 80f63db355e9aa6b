"""`python -m tests.compile_kernels`: run every operator once on its own cases, so that tests find all kernels compiled; tells the time.

Compile time is so told apart from the tests' own, and two test processes do not compile the same thing at once.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import time
from typing import Any

import operators
from stream.engine.warmup import _run_cases
from stream.operator import Operator


def main() -> None:
    began = time.perf_counter()
    parts: set[type[Operator[Any]]] = set()
    for found in pkgutil.walk_packages(operators.__path__, "operators."):
        module = importlib.import_module(found.name)
        parts |= {
            part
            for _, part in inspect.getmembers(module, inspect.isclass)
            if issubclass(part, Operator) and part.__module__ == found.name
        }
    for part in sorted(parts, key=lambda p: p.__qualname__):
        if cases := part.cases():
            _run_cases(cases[0].operator)
    print(f"compiled the kernels of {len(parts)} operators in {time.perf_counter() - began:.1f} s")


if __name__ == "__main__":
    main()
