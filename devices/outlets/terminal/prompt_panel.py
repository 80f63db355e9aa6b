"""What is asked of the person, on the terminal: to step into view, to stand still."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

from rich.text import Text

from kinegraph.devices.outlets.terminal.view import TerminalView
from kinegraph.stream.chunk import Chunk, Specs
from kinegraph.stream.errors import InputError
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.text.safe_text import one_line, say


@dataclass(slots=True)
class PromptState:
    """The newest text."""

    text: str


@dataclass(frozen=True, slots=True)
class PromptPanel(Outlet[PromptState, None]):
    """Events with a `text` (operators.pose.footing.Footing's `prompt`): shown in the live view; else every one is a line."""

    def open(self, specs: Specs) -> Specs:
        if "text" not in (specs["in"].dtype.names or ()):
            raise InputError("in", specs["in"].describe(), "events with the field text")
        self.set_state(PromptState(""), None)
        return {}

    def process(self, port: str, chunk: Chunk) -> None:
        for event in chunk.data:
            text = one_line(str(event["text"]))
            if text == self.state.text:
                continue
            self.state.text = text
            if TerminalView.current is not None:
                TerminalView.current.hang_out("prompt", Text(text, style="bold yellow"), text)
            else:
                with suppress(BrokenPipeError):
                    say(text, flush=True)
