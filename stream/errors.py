"""Errors for the person who can fix them: what was given, where, and what would be accepted."""

from __future__ import annotations

import signal
import sysconfig
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

_NOT_THE_USERS = (sysconfig.get_paths()["stdlib"], str(Path(__file__).resolve().parent), "<")


MAX = 300
"""Letters of a message that are shown; numba's go on for pages."""


class KinegraphError(Exception):
    """An error that a user can act on: the command line prints its text, without a traceback, and exits with `exit_code`."""

    exit_code = 2


class Interrupted(KeyboardInterrupt):
    """A person, or the system, asked the program to end at once: what our own handlers of signals raise."""


class Terminated(Interrupted):
    """SIGTERM came. No SystemExit, for that would be taken for one of the operator at work, which must not end the program."""


def asked_to_end(error: BaseException) -> bool:
    """Whether a signal raised this, and not an operator's own code, in which `raise KeyboardInterrupt` is a fault like any other."""
    if not isinstance(error, KeyboardInterrupt) or threading.current_thread() is not threading.main_thread():
        return False
    return isinstance(error, Interrupted) or signal.getsignal(signal.SIGINT) is signal.default_int_handler


def interruption(error: BaseException) -> Interrupted | None:
    """What asked the program to end, where a library has made another error of it."""
    at: BaseException | None = error
    while at is not None and not isinstance(at, Interrupted):
        at = at.__cause__ or at.__context__
    return at


class ParameterError(KinegraphError):
    """A parameter that cannot be: raised by `open`, completed with the node's name and line by the graph."""

    def __init__(self, parameter: str, given: object, accepts: str) -> None:
        """`accepts` completes the sentence "it must be ..."."""
        super().__init__(f"{parameter} is {'empty' if given is None else repr(given)}; it must be {accepts}")
        self.parameter = parameter


class InputError(KinegraphError):
    """A stream that an operator's input cannot take: wrong shape, rate, unit or channels."""

    def __init__(self, port: str, given: str, accepts: str) -> None:
        """`given` describes what is connected, `accepts` completes the sentence "it must be ..."."""
        super().__init__(f"input '{port}' is {given}; it must be {accepts}")
        self.port = port


class GraphError(KinegraphError):
    """A graph that cannot run, with the file and line of what is wrong; `text` says it without these."""

    def __init__(self, text: str, *, path: str = "", line: int | None = None, node: str = "") -> None:
        where = f"{path}:{line}: " if path and line else f"{path}: " if path else ""
        self.text = f"node {node!r}: {text}" if node else text
        super().__init__(where + self.text)
        self.line, self.node = line, node


class RecordingError(KinegraphError):
    """A recording that cannot be read, or is not what was asked for."""


class NothingRecorded(RecordingError):
    """A file of a recording that was begun, and in which nothing was recorded before the session ended."""


class DeviceError(KinegraphError):
    """A device that cannot be opened or stopped answering: says what was expected and what came."""

    exit_code = 3


class RunError(KinegraphError):
    """A graph that stopped while running: names the node and the sample's time."""

    exit_code = 4


class DeclarationError(RunError):
    """A device that is not as its node declares it (its rate, its unit of time, its counter): it ends the session at its start."""

    exit_code = DeviceError.exit_code


class MemoryExceeded(RunError):
    """A session that took more memory than it may: it was ended before the system does that, with its recording closed."""

    exit_code = 7


def nearest(name: str, valid: Iterable[str]) -> str:
    """A sentence that names what `name` may have been meant to be: "did you mean 'cutoff_hz'?", else all valid names."""
    names = sorted(valid)
    close = get_close_matches(name, names, n=1, cutoff=0.6)
    if close:
        return f"did you mean {close[0]!r}?"
    return f"valid are {', '.join(repr(n) for n in names)}" if names else "there is nothing to choose from"


def explain(error: BaseException) -> str:
    """An exception on one line, with the last file and line on its way that is not Python's own, an installed package's or the engine's."""
    if isinstance(error, SyntaxError):
        return f"SyntaxError: {error.msg} ({error.filename}, line {error.lineno})"
    frames = traceback.extract_tb(error.__traceback__)
    own = [f for f in frames if not f.filename.startswith(_NOT_THE_USERS) and "site-packages" not in f.filename]
    where = "".join(f" ({at.filename}, line {at.lineno})" for at in own[-1:])
    try:
        text = " ".join(str(error).split())
    except BaseException as mute:
        if asked_to_end(mute):
            raise
        text = "it cannot say what it is"
    return f"{type(error).__name__}: {text if len(text) <= MAX else text[:MAX] + ' ...'}{where}"


@contextmanager
def blaming(node: str, call: str) -> Iterator[None]:
    """Within: a part's code is called, beside `process`. What it raises that is no error of ours becomes one that names node and call."""
    try:
        yield
    except BaseException as error:
        if isinstance(error, KinegraphError) or asked_to_end(error):
            raise
        kind = MemoryExceeded if isinstance(error, MemoryError) else RunError
        raise kind(f"node {node!r}: {call} failed: {explain(error)}") from error
