"""Images that show another moment than their stamps say are found out by what moves, and left alone; others are not."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.people.rendered_performer import EMPTY_S, RenderedPerformer, camera_of
from kinegraph.operators.body.background import Background
from kinegraph.operators.body.network.operator import FIGURE, PoseNetwork
from kinegraph.operators.body.persons import Persons
from kinegraph.stream.chunk import Array, Chunk, StreamSpec
from kinegraph.stream.operator import grid

WIDTH, HEIGHT, RATE = 160, 120, 30.0
CAMERA = dict(zip(("fx", "fy", "cx", "cy"), camera_of(WIDTH, HEIGHT), strict=True))
DEPTH = StreamSpec((HEIGHT, WIDTH), np.dtype(np.uint16), rate_hz=RATE, units=("mm",), meta={"camera": CAMERA})
GREY = StreamSpec((HEIGHT, WIDTH), np.dtype(np.uint8), rate_hz=RATE)
FIRST, N = round(EMPTY_S * RATE), 480
"""Somebody is there from frame 60 on, and moves from 120 on."""


@cache
def seen() -> tuple[list[Array], list[Array]]:
    """The person's depth, and the images."""
    performer, background, persons = RenderedPerformer(WIDTH, HEIGHT), Background(), Persons()
    persons.open({"in": background.open({"in": DEPTH})["out"]})
    depths, images = [], []
    for k, time in enumerate(grid(RATE, N).tolist()):
        chunk = Chunk(np.array([time]), performer.frame(k, k / RATE)[None], time)
        depths.append(dict(persons.process("in", dict(background.process("in", chunk))["out"]))["out"].data[0])
        images.append(performer.image(k, k / RATE))
    return depths, images


def presence(late_by: Any, shown: Any = lambda image: image, every: int = 1) -> Array:
    """How sure the network is of every frame; image k shows what was to be seen `late_by(k)` frames earlier."""
    network = PoseNetwork(FIGURE)
    depths, images = seen()
    grey = GREY if shown(images[0]).ndim == 2 else GREY.derive(shape=(HEIGHT, WIDTH, 3))
    network.open({"image": grey, "person": DEPTH})
    made = []
    for k, time in list(enumerate(grid(RATE, N).tolist()))[::every]:
        at = np.array([time])
        network.process("image", Chunk(at, shown(images[min(N - 1, max(0, k - late_by(k)))])[None], time))
        made.append(dict(network.process("person", Chunk(at, depths[k][None], time)))["out"].data[0]["presence"])
    return np.array(made)


@pytest.mark.parametrize("late", [3, -3])
def test_images_of_another_moment_are_left_alone_until_they_are_in_step_again(late: int, capsys: Any) -> None:
    sure = presence(lambda k: late if 200 <= k < 330 else 0)
    assert np.isfinite(sure[FIRST + 1 : 200]).all()
    assert np.isnan(sure[290:330]).all(), "90 frames are enough to find out"
    assert np.isfinite(sure[430:]).all(), "and 100 that they are in step again"
    output = capsys.readouterr().out
    assert f"100 {'earlier' if late > 0 else 'later'}" in output and "in step with the depth again" in output
    assert output.count("out of step") == 1


def test_images_that_never_were_in_step_are_found_out() -> None:
    assert np.isnan(presence(lambda k: 3)[200:]).all()


def test_colour_images_are_watched_as_well() -> None:
    assert np.isnan(presence(lambda k: 3, lambda image: np.stack([image] * 3, axis=-1))[200:]).all()


def test_at_ten_frames_a_second_a_lag_of_one_is_found() -> None:
    assert np.isnan(presence(lambda k: 3, every=3)[-10:]).all()


@pytest.mark.parametrize(
    "shown",
    [
        lambda image: image,
        np.zeros_like,
        lambda image: np.random.default_rng(int(image.sum())).integers(0, 255, image.shape).astype(np.uint8),
        lambda image: (
            (image * 0.2 + np.random.default_rng(int(image.sum())).normal(20, 6, image.shape))
            .clip(0, 255)
            .astype(np.uint8)
        ),
    ],
    ids=["in step", "black", "noise", "dim and grainy"],
)
def test_images_in_step_or_without_a_person_are_not_accused(shown: Any, capsys: Any) -> None:
    assert np.isfinite(presence(lambda k: 0, shown)[FIRST + 1 :]).all()
    assert "out of step" not in capsys.readouterr().out


def test_a_lag_of_one_frame_is_no_fault() -> None:
    assert np.isfinite(presence(lambda k: 1)[FIRST + 1 :]).all()
