"""`python -m tests.warm_up_kernels OPERATOR`: what its `cases` compile and its `warm_up_cases` do not; in a process of its own."""

from __future__ import annotations

import gc
import sys

from numba.core.dispatcher import Dispatcher

from kinegraph.stream.engine.warmup import run_cases
from kinegraph.stream.graph.components import find
from kinegraph.stream.operator import Operator


def main(use: str) -> None:
    part = find(use)
    assert issubclass(part, Operator)
    run_cases(part)
    before = compiled()
    part.warm_up_cases = part.cases  # type: ignore[method-assign]
    run_cases(part)
    for kernel in sorted(compiled() - before):
        print(kernel)


def compiled() -> set[str]:
    """Every kernel with the types of arguments that it is compiled for."""
    kernels = [found for found in gc.get_objects() if isinstance(found, Dispatcher)]
    return {f"{kernel.__module__}.{kernel.__name__}{types}" for kernel in kernels for types in kernel.signatures}


if __name__ == "__main__":
    main(sys.argv[1])
