"""Whether anything compiled: numba reports every time that it looks for machine code it has not got yet."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import event
from numba.core.dispatcher import Dispatcher


class _Listener(event.Listener):
    def __init__(self) -> None:
        self.met: list[str] = []

    def on_start(self, event: Any) -> None:
        """A kernel was called with types that it had not been called with before; whether it is then compiled or found on disk is luck."""
        frame = sys._getframe()
        while (caller := frame.f_back) is not None:
            frame = caller
            kernel = frame.f_locals.get("self")
            if frame.f_code.co_name == "compile" and isinstance(kernel, Dispatcher):
                types = frame.f_locals.get("args") or frame.f_locals.get("sig")
                text = f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}{types}"
                if text not in self.met:
                    self.met.append(text)

    def on_end(self, event: Any) -> None:
        pass


@contextmanager
def compiling() -> Iterator[list[str]]:
    """The kernels, with the types they met for the first time, while this lasts."""
    listener = _Listener()
    with event.install_listener("numba:compiler_lock", listener):
        yield listener.met
