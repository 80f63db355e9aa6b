"""`kinegraph train`: models learned from recordings, to be named in a graph.

A kind of model is an entry point of the group `kinegraph.trainings`, so that any package may add one.
"""

from __future__ import annotations

import typer

from kinegraph.stream.system.entry_points import usable

train = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False, no_args_is_help=True)


@train.callback()
def group() -> None:
    """Learn a model from recordings."""


for name, function in usable("kinegraph.trainings", "training"):
    train.command(name, context_settings={"help_option_names": ["-h", "--help"]})(function)
