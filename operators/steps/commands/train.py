"""`kinegraph motion train steps`: a forest that tells something of people by their steps, with what it is worth."""

from __future__ import annotations

from dataclasses import asdict, replace
from enum import StrEnum
from pathlib import Path as File
from typing import TYPE_CHECKING, Annotated

import typer

from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.extras import optional
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    from kinegraph.operators.steps.commands.enrolment import Enrolment
    from kinegraph.operators.steps.commands.training import StepTraining
    from kinegraph.operators.steps.commands.validation import Trust


class StepTarget(StrEnum):
    """What a forest learns."""

    gender = "gender"
    age = "age"
    height = "height"
    person = "person"


class Site(StrEnum):
    """Where the sensor was worn."""

    lower_back = "lower_back"
    wrist = "wrist"
    pocket = "pocket"
    foot = "foot"
    other = "other"


class SensorAxes(StrEnum):
    """What features are of."""

    gravity = "gravity"
    sensor = "sensor"


class Features(StrEnum):
    """Which features the model takes."""

    acceleration = "acceleration"
    angular_velocity = "angular_velocity"
    both = "both"


def steps(
    labels: Annotated[
        File, typer.Argument(help="a table with columns recording, person, and the target", metavar="LABELS.csv")
    ],
    recordings: Annotated[
        list[File],
        typer.Argument(help="recordings of an inertial sensor, or results of `kinegraph batch`", metavar="RECORDING"),
    ],
    target: Annotated[StepTarget, typer.Option(help="the column that is learned; person: re-identification")],
    output: Annotated[File, typer.Option("-o", "--out", help="the model to be made")] = File("steps.npz"),
    site: Annotated[Site, typer.Option(help="where the sensor was worn")] = Site.lower_back,
    axes: Annotated[SensorAxes, typer.Option(help="axes by gravity, or the sensor's own")] = SensorAxes.gravity,
    features: Annotated[Features, typer.Option(help="the features that the model takes")] = Features.both,
    stream: Annotated[str, typer.Option(help="the sensor's signal [default: the only one that it can be]")] = "",
    alike: Annotated[
        bool,
        typer.Option("--alike", help="every class counts as much, and in it every person, however many their steps"),
    ] = False,
    trees: Annotated[int, typer.Option(min=5, max=1000)] = 60,
    shuffles: Annotated[int, typer.Option(min=19, max=9999, help="of the permutation test")] = 19,
    sure: Annotated[
        float,
        typer.Option(
            min=0.5, max=0.999, help="a step is classified where left-out people's were right at least this often"
        ),
    ] = 0.8,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace a model that exists")] = False,
    as_json: AsJson = False,
) -> None:
    """Train a random forest on walking steps, and say what it is worth: with steps at random, and with people left out.

    Only the second says how it does with people it has never seen. Needs scikit-learn: pip install 'kinegraph[train]'.
    """
    optional("sklearn", "training", "pip install 'kinegraph[train]'")
    from kinegraph.operators.steps.commands.recordings import labelled, read_labels, read_walk
    from kinegraph.operators.steps.commands.training import learned
    from kinegraph.operators.steps.steps import Steps
    from kinegraph.stream.batch.sessions import sessions_at

    if output.exists() and not overwrite:
        raise KinegraphError(f"{output} exists; --overwrite replaces it, --out names another file")
    finder = Steps(site=site.value, axes=axes.value)
    walks = [read_walk(path, finder, stream) for path in sessions_at(recordings)]
    given = labelled(walks, read_labels(labels, target.value))
    if features is not Features.acceleration and not walks[0].meta["angular_velocity"]:
        raise KinegraphError(
            f"--features {features.value} needs angular velocity; the recordings have acceleration alone"
        )
    if alike and target is StepTarget.person:
        raise KinegraphError("--alike weighs the people of a class; with --target person each is a class of their own")
    made = learned(replace(given, alike=alike), walks[0].meta, target.value, features.value, trees, shuffles, sure)
    made.model.write(output)
    header = made.model.header
    if as_json:
        tried = [{**asdict(t), "probability": None, "verdict": t.verdict} for t in made.tried]
        print_json({"file": output, "model": header, "tried": tried, "enrolled": made.enrolled})
        return
    show(made, f"{target.value}, {site.value}", sure)
    say(f"{output}: {header['steps']} steps of {header['subjects']} people; classes {', '.join(made.model.classes)}")


def show(made: StepTraining, title: str, sure: float) -> None:
    """What a model is worth."""
    if made.enrolled is not None:
        show_enrolment(made.enrolled, made.model.header["subjects"])
        return
    show_trust(made.tried, title)
    if made.model.header["uncertain_below"] > 1.0:
        text = 'live, this model will say "uncertain" at every step'
        guesses = made.model.header["verdict"] != "better than guessing"
        say(
            f"{text}: {'it is not better than guessing' if guesses else f'left-out steps were never right in {sure:.0%}'}"
        )


def show_trust(found: list[Trust], title: str) -> None:
    from rich.table import Table

    from kinegraph.stream.text.screen import Screen

    table = Table(title=title, box=None, title_justify="left")
    for heading in ("features", "random split", "subject-wise", "majority", "people right", "95 %", "chance", ""):
        table.add_column(heading, justify="left" if heading in ("features", "") else "right")
    for t in found:
        interval = f"{t.low:.2f}-{t.high:.2f}"
        row = (
            f"{t.random:.3f}",
            f"{t.subjects:.3f}",
            f"{t.majority:.3f}",
            f"{t.voted} of {t.people}",
            interval,
            f"{t.chance:.2f}",
        )
        table.add_row(t.features, *row, t.verdict)
    console = Screen()
    console.print(table)
    each = Table(title="with people left out", box=None, title_justify="left")
    for heading in ("features", "class", "sensitivity", "specificity", "predictive value"):
        each.add_column(heading, justify="left" if heading in ("features", "class") else "right")
    for t in found:
        for c in t.per_class:
            each.add_row(t.features, c.name, f"{c.sensitivity:.3f}", f"{c.specificity:.3f}", f"{c.predictive:.3f}")
    console.print(each)


def show_enrolment(found: Enrolment, people: int) -> None:
    say(f"of {found.walks} left-out walks of {people} enrolled people {found.known:.1%} had the right name")
    say(
        f"with a threshold of {found.threshold:.3f}: strangers taken for somebody {found.false_accept:.1%} of {found.strangers} walks, "
        f"enrolled people taken for a stranger or another {found.false_reject:.1%} of {found.walks}"
    )
