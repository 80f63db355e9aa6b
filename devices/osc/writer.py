"""Open Sound Control 1.0, sent: numbers under addresses, gathered into bundles. No socket."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Sequence

from kinegraph.devices.osc.vmc_protocol import BUNDLE, SAFE_BYTES, message


def floats(address: str, values: Sequence[float]) -> bytes:
    """An element of a bundle: float32 under an address."""
    return message(address, "f" * len(values), struct.pack(f">{len(values)}f", *values))


def bundles(elements: Iterable[bytes], most: int = SAFE_BYTES) -> Iterator[bytes]:
    """Bundles of these elements, in their order, at most `most` bytes long unless a single element is longer."""
    waiting, size = [BUNDLE], len(BUNDLE)
    for element in elements:
        if len(waiting) > 1 and size + len(element) > most:
            yield b"".join(waiting)
            waiting, size = [BUNDLE], len(BUNDLE)
        waiting.append(element)
        size += len(element)
    if len(waiting) > 1:
        yield b"".join(waiting)
