"""`kinegraph dev try`: hold an operator to the laws, before it meets a device."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Annotated

import typer
from rich.progress import Progress

from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph.components import find, import_from
from kinegraph.stream.laws import Broken, Conformance, checks, hold, lags, trials
from kinegraph.stream.operator import Operator
from kinegraph.stream.text.screen import Screen


def try_(
    operator: Annotated[str, typer.Argument(metavar="OPERATOR", help="dotted path to the class: my_ops.Gain")],
    examples: Annotated[
        int, typer.Option(min=1, help="how many random cuttings, gaps and bad samples to try per case")
    ] = 50,
    seed: Annotated[int, typer.Option(help="seed of the random numbers: the same seed repeats the same tests")] = 1,
    as_json: AsJson = False,
) -> None:
    """Try an operator on the laws: cut its case's samples in random ways, snapshot it, give it gaps and NaN, and compare.

    Says which law is broken, where, and what to do; exit code 1. `cases` of the class gives the samples it is tried on.
    """
    import_from(Path())
    cls = find(operator)
    if not issubclass(cls, Operator):
        raise KinegraphError(f"{operator} is a source; the laws are for operators and outlets")
    console = Screen(stderr=as_json)
    cases: list[dict[str, object]] = []
    try:
        made = trials(cls)
        for k, make in enumerate(made):
            begun = perf_counter()
            trial = make()
            _one_case(trial, examples, seed, f"case {k + 1} of {len(made)}", console)
            cases.append({"case": k + 1, "tries": examples, "lags_s": lags(trial)})
            console.print(
                f"case {k + 1} of {len(made)}: every law held, {examples} random tries, {perf_counter() - begun:.1f} s"
            )
            for output, seconds in lags(trial).items():
                console.print(_hint(output, seconds), soft_wrap=True)
    except Broken as broken:
        if as_json:
            print_json({"operator": operator, "cases": cases, "broken": str(broken), "not_checked": cls.exemptions})
        raise LawBroken(operator, broken) from None
    if as_json:
        print_json({"operator": operator, "cases": cases, "broken": None, "not_checked": cls.exemptions})
    for rule, reason in cls.exemptions.items():
        console.print(f"not checked: rule '{rule}' ({reason})", style="dim")


def _hint(output: str, seconds: float) -> str:
    return (
        f"hint: by its stamps, output '{output}' lags its input by {1000 * seconds:.3g} ms; if that is a filter's delay, "
        "subtract it from the stamps and from `until`, and declare it: set_state(state, delay_s=...)"
    )


def _one_case(trial: Conformance, examples: int, seed: int, title: str, console: Screen) -> None:
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(title, total=len(checks(trial)) + examples)

        def done(failed: bool) -> None:
            if failed:
                progress.update(task, description="looking for the simplest case")
            progress.advance(task)

        hold(trial, examples, seed, done)


class LawBroken(KinegraphError):
    """A broken law, with the operator's name before it."""

    exit_code = 1

    def __init__(self, operator: str, broken: Broken) -> None:
        super().__init__(f"{operator} breaks {broken}")
