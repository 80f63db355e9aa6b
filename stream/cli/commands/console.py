"""What a person types while a session runs: words annotate, a digit or the space bar marks at once, `name=value` sets a value."""

from __future__ import annotations

import os
import select
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

import structlog

from kinegraph.stream.errors import KinegraphError

if TYPE_CHECKING:
    from kinegraph.stream.engine.session import Session

AT_ONCE = set("0123456789 ")
HELP = "a word and Enter annotates; a digit or the space bar marks at once; name=number sets a value; Ctrl-C ends"

log = structlog.get_logger(__name__)


class Console:
    """Reads the keyboard (or lines from a pipe) in a thread, until the session ends."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._over = threading.Event()
        self._line = ""
        self._onset = 0

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Within: keys reach the session. The terminal is set back at the end, whatever happens."""
        if not sys.stdin or sys.stdin.closed:
            yield
            return
        with _single_keys():
            thread = threading.Thread(target=self._read, name="console", daemon=True)
            thread.start()
            try:
                yield
            finally:
                self._over.set()
                thread.join(0.5)

    def _read(self) -> None:
        try:
            handle = sys.stdin.fileno()
            while not self._over.is_set():
                if select.select([handle], [], [], 0.1)[0]:
                    typed = os.read(handle, 1024)
                    if not typed:
                        return
                    for key in typed.decode(errors="replace"):
                        self.key(key)
        except (OSError, ValueError) as error:
            log.debug("the keyboard cannot be read", error=str(error))

    def key(self, key: str) -> None:
        """One key was pressed."""
        if not self._line:
            self._onset = self._session.now()
        if key in "\r\n":
            line, self._line = self._line.strip(), ""
            if line:
                self._say(line)
        elif key in "\x7f\b":
            self._line = self._line[:-1]
        elif key in AT_ONCE and not self._line and sys.stdin.isatty():
            self._say("mark" if key == " " else key)
        elif key.isprintable():
            self._line += key

    def _say(self, line: str) -> None:
        name, equals, value = line.partition("=")
        try:
            if equals and all(word.isidentifier() for word in name.strip().split(".")):
                self._session.tell(name.strip(), value.strip())
                log.info("value set", node=name.strip(), value=value.strip())
            else:
                self._session.mark(line, self._onset)
                log.info("annotated", text=line)
        except KinegraphError as error:
            log.warning("not understood", typed=line, error=str(error))


@contextmanager
def _single_keys() -> Iterator[None]:
    """Within: the terminal gives every key at once (where there is a terminal that can)."""
    try:
        import termios
        import tty
    except ImportError:  # Windows has neither
        yield
        return
    try:
        before = termios.tcgetattr(sys.stdin.fileno())
    except (OSError, ValueError, termios.error):
        yield
        return
    tty.setcbreak(sys.stdin.fileno())
    try:
        yield
    finally:
        with suppress(OSError, ValueError, termios.error):  # the terminal may be gone
            termios.tcsetattr(sys.stdin.fileno(), termios.TCSADRAIN, before)
