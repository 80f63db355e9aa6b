"""The scenes of the bench: their truth is what happens in them, and visitors are laid over frames that are otherwise the tests' own."""

from __future__ import annotations

from dataclasses import replace

import pytest

from bench.scenes import PLAIN, SCENES, Visited, VisitedRenderer, row, truth_of
from kinegraph.operators.sleep.evaluation.agreement import Confusion
from tests.support.rendered_room import Renderer

pytestmark = pytest.mark.quick


def test_the_truth_is_what_happens() -> None:
    truth = truth_of(Visited(150, ((40.0, 130.0),), moves=(10.0, 58.0, 65.0)))
    assert truth["in_bed_s"].tolist() == [0, 20, 30, 30, 10]
    assert truth["moved_s"].tolist() == [0, 2, 6, 0, 0], "movement before a person is there counts for no one"


def test_without_a_visitor_the_frames_are_the_tests_own() -> None:
    ours, theirs = VisitedRenderer(PLAIN, 64, 48), Renderer(PLAIN, 64, 48)
    assert all((ours.frame(t) == theirs.frame(t)).all() for t in (0.0, 200.0, 301.0))


@pytest.mark.parametrize("visitor", ["cat_floor", "cat_bed", "fan", "curtains"])
def test_a_visitor_is_nearer_than_what_is_behind_it_and_moves(visitor: str) -> None:
    scene = replace(PLAIN, **{visitor: ((0.0, 9.0),)})
    there, plain = VisitedRenderer(scene, 128, 96), Renderer(PLAIN, 128, 96)
    places = []
    for t in (1.0, 2.5):
        seen, bare = there.frame(t).astype(int), plain.frame(t).astype(int)
        places.append((seen > 0) & (bare > 0) & (bare - seen > 100))
    assert 3 < places[0].sum() < places[0].size // 3 and (places[0] != places[1]).any()


def test_a_row_says_what_was_found() -> None:
    assert row("a", Confusion(90, 3, 1, 10, 7)) == ["a", "100", "4", "7", "0.900", "0.750"]
    assert row("b", Confusion(0, 0, 0, 0, 9))[-2:] == ["-", "-"] and len(SCENES) == 13
