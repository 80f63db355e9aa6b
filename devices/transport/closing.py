"""What is closed where a `with` statement ends."""

from __future__ import annotations

from typing import Self


class ClosesAtExit:
    """A connection, or a server, that its `close` lets go of."""

    def close(self) -> None:
        """Let go of it; never raises."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
