"""The command line: `kinegraph COMMAND ...`. Each command is loaded when it is called, so that help and short commands are quick."""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial, wraps
from importlib.metadata import version
from io import TextIOWrapper
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn

from kinegraph.stream.cli.registry import command_in, function_of, group_in, overview, unknown
from kinegraph.stream.compiler.llvm_guard import later, within_llvm
from kinegraph.stream.errors import Interrupted, KinegraphError, Terminated
from kinegraph.stream.system.atomic_file import be_private
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    import typer

STARTING = 50_000
"""Objects until Python collects garbage: a start makes a million that stay, and looked at them a hundred times, for a tenth of its time."""


def main() -> None:
    """The entry point: errors that a user can act on are printed without a traceback; the exit code tells what kind they were."""
    try:
        arguments = sys.argv[1:]
        gc.set_threshold(STARTING)
        _make_sure_of_outputs()
        be_private()
        with _terminable() as terminated:
            try:
                _main(arguments)
            except SystemExit as end:
                if end.code == 130 and (
                    terminated or _by_termination(end)
                ):  # which is what click makes of any interruption
                    raise Terminated from None
                raise
    except KeyboardInterrupt as end:  # also before a command has begun, while it is being imported
        _stop(end)


def _by_termination(end: BaseException) -> bool:
    """Whether it was SIGTERM that led to this, whoever heard it."""
    before = end.__cause__ or end.__context__
    return before is not None and (isinstance(before, Terminated) or _by_termination(before))


def _stop(end: KeyboardInterrupt) -> NoReturn:
    say("kinegraph: stopped", err=True)
    sys.exit(143 if isinstance(end, Terminated) else 130)


def _main(arguments: list[str]) -> None:
    try:
        if arguments and arguments[0] in ("-V", "--version"):
            say(f"kinegraph {version('kinegraph')}")
            return
        if name := command_in(arguments):
            call(name, arguments[len(name.split()) :])
            return
        group = group_in(arguments)
        rest = arguments[len(group.split()) :]
        if rest and rest[0] not in ("-h", "--help", "help"):
            raise unknown(arguments)
        say(overview(group), err=not rest)
        sys.exit(0 if rest else 2)
    except KinegraphError as error:
        say(f"kinegraph: {error}", err=True)
        sys.exit(error.exit_code)
    except BrokenPipeError:
        _forget_output()
        sys.exit(141)
    except OSError as error:
        say(f"kinegraph: {f'{error.filename}: ' if error.filename else ''}{error.strerror or error}", err=True)
        sys.exit(2)


def _make_sure_of_outputs() -> None:
    """Replace a closed output by a null device, and characters that a terminal lacks by question marks."""
    sys.stdout = sys.stdout or open(os.devnull, "w")  # noqa: SIM115, PTH123 - for as long as the program runs
    sys.stderr = sys.stderr or open(os.devnull, "w")  # noqa: SIM115, PTH123
    for output in (sys.stdout, sys.stderr):
        if isinstance(output, TextIOWrapper) and output.encoding.lower().replace("-", "") != "utf8":
            output.reconfigure(errors="replace")


@contextmanager
def _terminable() -> Iterator[list[int]]:
    """Within: SIGTERM ends the program in order, so that drafts are removed and locks given back. (A session has its own, cleaner end.)

    Gives a list that holds the signal once it has come.
    """
    came: list[int] = []

    def end(number: int, frame: FrameType | None) -> None:
        if within_llvm(frame):
            later(partial(signal.raise_signal, number))
            return
        came.append(number)
        raise Terminated

    if threading.current_thread() is not threading.main_thread():
        yield came
        return
    before = {signal.SIGTERM: signal.signal(signal.SIGTERM, end)}
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        before[signal.SIGINT] = signal.signal(signal.SIGINT, _interrupt)
    try:
        yield came
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _interrupt(number: int, frame: FrameType | None) -> None:
    if within_llvm(frame):
        later(partial(signal.raise_signal, number))
        return
    raise Interrupted  # which no operator can be taken for that raises KeyboardInterrupt by itself


def _forget_output() -> None:
    """Standard output was closed: drop what is buffered, so that the interpreter does not complain at exit."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def call(name: str, arguments: list[str]) -> None:
    """Run one command (a function, or a package's Typer app); raises KinegraphError for wrong arguments.

    `name` includes the command's group: `emg calibrate`.
    """

    try:
        code = app_of(name, arguments)(arguments, prog_name=f"kinegraph {name}", standalone_mode=False)
    except Exception as error:
        message = getattr(
            error, "format_message", None
        )  # an error of click, which Typer brings under a name of its own
        if message is None:
            raise
        text = message().strip()
        raise KinegraphError(
            f"{text[:1].lower()}{text[1:].rstrip('.')}; `kinegraph {name} --help` describes it"
        ) from None
    if isinstance(code, int) and code:
        sys.exit(code)


def app_of(name: str, arguments: Sequence[str] = ()) -> typer.Typer:
    """A command as Typer takes it; its help describes the graph that `arguments` name."""
    import typer

    found = function_of(name)
    if isinstance(found, typer.Typer):
        app = found
        for command in app.registered_commands:
            command.callback = _interruptible(command.callback)
    else:
        app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
        app.command(
            name.split()[-1],
            context_settings={"help_option_names": ["-h", "--help"]},
            epilog=_settings_of(name, arguments),
        )(_interruptible(found))
    return app


def _settings_of(name: str, arguments: Sequence[str]) -> str | None:
    """What the help of a command says of the graph that it is called with."""
    if not {"-h", "--help"} & set(arguments):
        return None
    from kinegraph.stream.cli.commands.graph_help import settings_help

    text = settings_help(name, arguments)
    return f"\b\n{text}" if text else None


def _interruptible(function: Any) -> Any:
    """The command. Ctrl-C ends it with 130, SIGTERM with 143, a reader that left with 141; click would hide these, and any EOFError."""

    @wraps(function)
    def command(*args: Any, **options: Any) -> Any:
        try:
            return function(*args, **options)
        except KeyboardInterrupt as end:
            _stop(end)
        except BrokenPipeError:  # click would end with 1, which says that a comparison found a difference
            _forget_output()
            sys.exit(141)
        except EOFError as error:
            raise RuntimeError("a file ended too early") from error

    return command
