"""What stands in for NI's driver and for LabJack's library: their C functions, in Python, behind the makers' own Python packages."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

OVERFLOW = -200279


class CFunction:
    """A function of a C library as ctypes gives it: it may be given argument types."""

    def __init__(self, work: Callable[..., int]) -> None:
        self._work, self.argtypes, self.arg_lock = work, None, threading.Lock()

    def __call__(self, *arguments: Any) -> int:
        return self._work(*arguments) or 0


class NiDriver:
    """One device: input k of sample i gives k + (i % 1000) / 1000 V. `overflow`: so many blocks on, the buffer has run over."""

    def __init__(self, overflow: int = -1) -> None:
        self.calls: list[str] = []
        self.channels: list[tuple[str, float, float]] = []
        self.rate, self.at, self.began = 0.0, 0, 0.0
        self.overflow, self.blocks = overflow, 0

    def __getattr__(self, name: str) -> CFunction:
        if not name.startswith("DAQmx"):
            raise AttributeError(name)

        def work(*arguments: Any) -> int:
            self.calls.append(name)
            known = getattr(self, f"_{name}", None) if f"_{name}" in dir(type(self)) else None
            return int(known(*arguments) or 0) if known else 0

        function = CFunction(work)
        setattr(self, name, function)
        return function

    def _DAQmxCreateTask(self, name: Any, handle: Any) -> None:
        handle._obj.value = 7

    def _DAQmxCreateAIVoltageChan(
        self, task: Any, channel: Any, name: Any, wiring: int, low: float, high: float, *_: Any
    ) -> None:
        self.channels.append((channel if isinstance(channel, str) else channel.decode(), low, high))

    def _DAQmxCfgSampClkTiming(self, task: Any, source: Any, rate: float, *_: Any) -> None:
        self.rate = rate

    def _DAQmxStartTask(self, task: Any) -> None:
        self.began = time.monotonic()

    def _DAQmxGetReadAttribute(self, task: Any, attribute: Any, value: Any, *_: Any) -> None:
        if hasattr(value, "_obj"):
            value._obj.value = len(self.channels)

    def _DAQmxGetTaskAttribute(self, task: Any, attribute: Any, value: Any, *more: Any) -> int:
        names = ", ".join(name for name, _, _ in self.channels).encode() + b"\0"
        if value is None or (more and not getattr(more[0], "value", more[0])):
            return len(names)
        if hasattr(value, "_obj"):
            value._obj.value = len(self.channels)
        elif hasattr(value, "value"):
            value.value = names[:-1]
        return 0

    def _DAQmxReadAnalogF64(
        self, task: Any, n: int, timeout: float, fill: int, block: Any, size: int, read: Any, _: Any
    ) -> int:
        self.blocks += 1
        if self.blocks == self.overflow:
            return OVERFLOW
        due = self.began + (self.at + n) / self.rate
        time.sleep(max(0.0, due - time.monotonic()))
        index = np.arange(self.at, self.at + n)
        block[:] = np.stack([k + index % 1000 / 1000 for k in range(len(self.channels))]).reshape(block.shape)
        self.at += n
        read._obj.value = n
        return 0


class LjmLibrary:
    """One T7: input k of scan i gives k + (i % 1000) / 1000 V; every `lose`-th scan is lost."""

    def __init__(self, true_rate: float = 0.0, lose: int = 0) -> None:
        self.true_rate, self.lose = true_rate, lose
        self.rate, self.at, self.began, self.n, self.inputs = 0.0, 0, 0.0, 0, 0
        self.stopped = False

    def LJM_OpenS(self, kind: bytes, way: bytes, which: bytes, handle: Any) -> int:
        handle._obj.value = 3
        return 0

    def LJM_eWriteName(self, *_: Any) -> int:
        return 0

    def LJM_NamesToAddresses(self, n: Any, names: Any, addresses: Any, types: Any) -> int:
        return 0

    def LJM_eStreamStart(self, handle: Any, n: Any, inputs: Any, addresses: Any, rate: Any) -> int:
        self.n, self.inputs, self.rate = n.value, inputs.value, self.true_rate or rate._obj.value
        rate._obj.value = self.rate
        self.began = time.monotonic()
        return 0

    def LJM_eStreamRead(self, handle: Any, data: Any, *_: Any) -> int:
        due = self.began + (self.at + self.n) / self.rate
        time.sleep(max(0.0, due - time.monotonic()))
        index = np.arange(self.at, self.at + self.n)
        rows = np.stack([k + index % 1000 / 1000 for k in range(self.inputs)], axis=1)
        if self.lose:
            rows[index % self.lose == 0] = -9999.0
        data._obj[:] = rows.ravel().tolist()
        self.at += self.n
        return 0

    def LJM_eStreamStop(self, *_: Any) -> int:
        self.stopped = True
        return 0

    def LJM_Close(self, *_: Any) -> int:
        return 0

    def LJM_ErrorToString(self, code: Any, text: Any) -> None: ...
