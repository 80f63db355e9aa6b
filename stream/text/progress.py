"""The progress bar of long conversions; on standard error, and only where somebody watches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from kinegraph.stream.text.safe_text import say


class FirstAndLast:
    """Prints the first and the last of many reports of something that is under way; for what is no terminal."""

    def __init__(self, print_line: Callable[[str], None] = lambda text: say(text, err=True)) -> None:
        self._print, self._begun = print_line, False

    def __call__(self, text: str, over: bool) -> None:
        """Take a report; `over`: the last."""
        if over or not self._begun:
            self._print(text)
        self._begun = not over


@contextmanager
def one_line_report() -> Iterator[Callable[[str, bool], None]]:
    """Within: reports stand on one line of the terminal, each in place of the one before; elsewhere the first and the last are printed."""
    from kinegraph.stream.text.screen import Screen

    console = Screen(stderr=True)
    if not console.is_terminal:
        yield FirstAndLast()
        return
    with console.status("") as shown:
        yield lambda text, over: shown.update(text)


@contextmanager
def bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """Within: call (done, total) every now and then."""
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    from kinegraph.stream.text.screen import Screen

    console = Screen(stderr=True)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as shown:
        task = shown.add_task(title, total=None)

        def progress(done: int, total: int) -> None:
            shown.update(task, completed=done, total=total)

        yield progress
