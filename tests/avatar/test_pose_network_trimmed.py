"""The pose network without the outputs that are not read: the others keep every bit, and what is no such network is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.operators.body.network.blazepose import READ, _interpreter, default_model, look
from kinegraph.operators.body.network.trimmed import trimmed
from kinegraph.stream.errors import ParameterError
from tests.support.pose_model import pose_network_or_skip


def outputs_of(content: bytes, image: np.ndarray) -> tuple[dict[tuple[int, ...], np.ndarray], int]:
    """What a network says of an image, by the shape of its outputs; and how many steps it takes."""
    from ai_edge_litert.interpreter import Interpreter

    network: Any = Interpreter(model_content=content, num_threads=1)
    network.allocate_tensors()
    network.set_tensor(network.get_input_details()[0]["index"], image[None])
    network.invoke()
    facts = {tuple(map(int, o["shape"])): network.get_tensor(o["index"]).copy() for o in network.get_output_details()}
    return facts, len(network._get_ops_details())


def test_what_is_read_keeps_every_bit_without_the_mask() -> None:
    pose_network_or_skip()
    content = default_model().read_bytes()
    image = np.random.default_rng(5).random((256, 256, 3), np.float32)
    whole, steps = outputs_of(content, image)
    alone, fewer = outputs_of(trimmed(content, READ), image)
    assert set(whole) == {*READ, (1, 256, 256, 1)}
    assert set(alone) == set(READ)
    assert fewer < steps - 30
    for shape in READ:
        assert np.array_equal(alone[shape], whole[shape])
    assert len(_interpreter(str(default_model()))[0].get_output_details()) == len(READ)
    raw = look(str(default_model()), image)
    assert np.array_equal(raw.points.ravel(), whole[1, 195][0]) and np.array_equal(raw.heat, whole[1, 64, 64, 39][0])
    assert raw.presence == whole[1, 1][0, 0] and np.array_equal(raw.world.ravel(), whole[1, 117][0])


def test_a_network_that_lacks_an_output_says_which_ones_it_has() -> None:
    pose_network_or_skip()
    with pytest.raises(ValueError, match=r"no output of the shape \(1, 196\), but .*\(1, 195\)"):
        trimmed(default_model().read_bytes(), ((1, 195), (1, 196)))


@pytest.mark.parametrize("content", [b"", b"no network at all", b"\x1c\x00\x00\x00TFL3" + bytes(60)])
def test_what_is_no_network_is_refused(tmp_path: Path, content: bytes) -> None:
    pose_network_or_skip()
    path = tmp_path / "other.tflite"
    path.write_bytes(content)
    with pytest.raises(ParameterError, match="a landmark network of BlazePose"):
        look(str(path), np.zeros((256, 256, 3), np.float32))
