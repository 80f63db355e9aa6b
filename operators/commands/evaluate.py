"""`kinegraph evaluate`: what the operators find against what is known to be true.

A kind of evaluation is an entry point of the group `kinegraph.evaluations`, so that any package may add one.
"""

from __future__ import annotations

import typer

from kinegraph.stream.system.entry_points import usable

evaluate = typer.Typer(
    add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False, no_args_is_help=True
)


@evaluate.callback()
def group() -> None:
    """Compare results with a reference."""


for name, function in usable("kinegraph.evaluations", "evaluation"):
    evaluate.command(name, context_settings={"help_option_names": ["-h", "--help"]})(function)
