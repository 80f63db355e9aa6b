"""How a session is asked to end: Ctrl-C, SIGTERM, a terminal that is closed; and what happens where the graph does not come back."""

from __future__ import annotations

import _thread
import faulthandler
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack, suppress
from types import FrameType
from typing import TYPE_CHECKING, Any, Self

import structlog

from kinegraph.stream.chunk import NS, utc
from kinegraph.stream.compiler.llvm_guard import later, within_llvm
from kinegraph.stream.errors import Interrupted, RunError, Terminated

if TYPE_CHECKING:
    from kinegraph.stream.engine.session import Session
    from kinegraph.stream.engine.status import Outcome
    from kinegraph.stream.engine.workers import Call

HANG_UP: signal.Signals | None = getattr(signal, "SIGHUP", None)
"""What a terminal that is closed says to those in it; Windows has no such thing."""
LOOK_S = 5.0
"""How often to check that the session goes on; a node's call that takes longer is reported."""
STUCK_S = 1.0
"""A call that has taken so long is not waited for at the second signal."""
CLOSING_S = 20.0
"""The process ends at the latest so long after it was broken off, whatever else does not come back."""

log = structlog.get_logger(__name__)


class Ending:
    """Within: the first Ctrl-C or SIGTERM, and a closed terminal (unless under `nohup`), end the session cleanly.

    A second one breaks it off. Where a node's call does not come back, no thread can end it: the recording is then closed without the
    graph, the node named, and the process left at once, with exit code 4. Signals reach a thread of their own, for the main one may be
    in such a call.

    shown   what shows the session, to be closed before the process is left
    """

    def __init__(self, session: Session, tell: Callable[[Outcome], None]) -> None:
        self.shown = ExitStack()
        self._session, self._report = session, tell
        self._terminals = [file for file in (0, 1, 2) if os.isatty(file)]
        self._asked = 0
        self._interrupts = self._ours = False
        self._raises: type[Interrupted] = Interrupted
        self._table: object = None
        self._told: int | None = None
        self._thread = threading.Thread(target=self._listen, name="signals", daemon=True)

    def __enter__(self) -> Self:
        self._ear, self._mouth = socket.socketpair()
        self._ear.settimeout(LOOK_S)
        self._mouth.setblocking(False)
        heard = [signal.SIGINT, signal.SIGTERM]
        if HANG_UP is not None and signal.getsignal(HANG_UP) is not signal.SIG_IGN:
            heard.append(HANG_UP)
        self._before: dict[int, Any] = {number: signal.signal(number, self._in_main) for number in heard}
        self._wakeup = signal.set_wakeup_fd(self._mouth.fileno(), warn_on_full_buffer=False)
        if hasattr(faulthandler, "register"):  # Ctrl-\ says where every thread is, even where one lets no other run
            faulthandler.register(signal.SIGQUIT, file=2, chain=True)
        self._thread.start()
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        signal.set_wakeup_fd(self._wakeup)
        for number, handler in self._before.items():
            signal.signal(number, handler)
        if hasattr(faulthandler, "unregister"):
            faulthandler.unregister(signal.SIGQUIT)
        self._mouth.close()
        self._thread.join()  # which ends the process itself, where the session was broken off
        self._ear.close()
        if (
            self._raises is Terminated and type(error) is Interrupted
        ):  # the warm-up has seen by itself that it is to stop
            raise Terminated from error

    def _in_main(self, _number: int, frame: FrameType | None) -> None:
        if not self._interrupts:
            return
        self._interrupts = False
        if within_llvm(frame):
            later(self._interrupt)
            return
        raise self._raises

    # the thread that hears signals -----------------------------------------------------------------------------------

    def _listen(self) -> None:
        while True:
            try:
                numbers = self._ear.recv(16)
            except TimeoutError:
                self._look()
                continue
            if not numbers:
                return
            for number in numbers:
                self._hear(number)

    def _hear(self, number: int) -> None:
        if number == HANG_UP:  # a shell that is closed may well say it twice
            _forget(self._terminals)
            self._session.stop(signal.Signals(number).name)
        elif number == signal.SIGINT and self._ours:
            self._ours = False
        elif number in self._before:
            self._asked += 1
            if self._asked == 1:
                self._table = self._session.table
                self._session.in_hand()  # what it finds now, and at the second signal still, is stuck
                self._raises = Terminated if number == signal.SIGTERM else Interrupted
                self._session.stop(signal.Signals(number).name)
                if self._session.warming:  # nothing is open yet that would have to be closed in order
                    self._interrupt()
            elif (call := self._session.in_hand()) and call.lasts_s >= STUCK_S:
                self._break_off(call)
            else:
                self._interrupt()

    def _interrupt(self) -> None:
        """Nothing is stuck, so that the main thread itself can end what it does: by a signal of ours, which is heard here, too."""
        self._interrupts = self._ours = True
        main = threading.main_thread().ident
        if hasattr(signal, "pthread_kill") and main:
            signal.pthread_kill(main, signal.SIGINT)
        else:
            _thread.interrupt_main()

    def _look(self) -> None:
        """Tell, once, of a call that does not come back: while one lasts, the metrics stand still."""
        session = self._session
        if session.table is not self._table:
            self._table = session.table
            session.in_hand()
            return
        call = session.in_hand()
        if call is None or call.lasts_s < LOOK_S / 2 or self._told == call.since:
            return
        self._told = call.since
        if not call.where:  # it was given no data: an outlet writes what it leaves, or a state is saved
            if (stage := session.pipeline.stages[call.node]).node.is_outlet:
                file = getattr(stage.operator, "file", "")
                log.info(
                    "writing the report" if file.endswith(".html") else "an outlet writes what is left",
                    node=call.node,
                    file=file,
                )
            return
        now = session.clock.now()
        session.log.report(
            "node does not return", node=call.node, since=utc(now - int(call.lasts_s * NS)), given=call.where.strip(),
            hint=f"{'another' if self._asked else 'a second'} Ctrl-C or SIGTERM ends the session without it",
        )  # fmt: skip

    def _break_off(self, call: Call) -> None:
        """Close everything without the graph, and leave the process at once: a thread that does not come back cannot be ended."""
        too_late = threading.Timer(CLOSING_S, os._exit, (RunError.exit_code,))
        too_late.daemon = True
        too_late.start()
        try:
            outcome = self._session.break_off(call.broken_off(), call.node)
            self.shown.close()
            self._report(outcome)
        except Exception:
            log.exception("not everything could be closed")
        for output in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                output.flush()
        os._exit(RunError.exit_code)


def _forget(terminals: list[int]) -> None:
    """Read and write nowhere from now on: a terminal that is gone answers with errors."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for file in terminals:
        os.dup2(nowhere, file)
    os.close(nowhere)
