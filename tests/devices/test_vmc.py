"""VMC frames: python-osc reads back what was written, byte for byte the bundle that it would compose itself."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.devices.osc.vmc_protocol import BONES, SAFE_BYTES, VmcFrame
from kinegraph.stream.chunk import Samples

osc_bundle = pytest.importorskip("pythonosc.osc_bundle", reason="python-osc is not installed")
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder  # noqa: E402
from pythonosc.osc_message_builder import OscMessageBuilder  # noqa: E402

RNG = np.random.default_rng(1)
OFFSETS = RNG.normal(0.0, 0.1, (55, 3))


def some_rotations(n: int) -> Samples:
    q = RNG.normal(size=(n, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def read(datagrams: list[memoryview]) -> list[tuple[str, list[object]]]:
    return [(m.address, list(m.params)) for d in datagrams for m in osc_bundle.OscBundle(bytes(d))]


def composed(time_s: float, hips: Samples, rotations: Samples, blends: dict[str, float]) -> bytes:
    """The same frame by python-osc, from the protocol's text."""
    bundle = OscBundleBuilder(IMMEDIATELY)

    def add(address: str, *values: str | int | float) -> None:
        message = OscMessageBuilder(address)
        for value in values:
            message.add_arg(value, {str: "s", int: "i", float: "f"}[type(value)])
        bundle.add_content(message.build())

    add("/VMC/Ext/OK", 1, 3, 0, 1)
    add("/VMC/Ext/T", time_s)
    add("/VMC/Ext/Root/Pos", "root", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    for bone, at, (w, x, y, z) in zip(BONES, OFFSETS, rotations, strict=True):
        place = hips if bone == "Hips" else at
        add("/VMC/Ext/Bone/Pos", bone, *map(float, (-place[0], place[1], place[2], x, -y, -z, w)))
    for name, weight in blends.items():
        add("/VMC/Ext/Blend/Val", name, weight)
    add("/VMC/Ext/Blend/Apply")
    return bytes(bundle.build().dgram)


def test_there_are_unitys_bones() -> None:
    assert len(BONES) == 55 == len(set(BONES))


def test_a_whole_frame_is_what_a_library_would_compose() -> None:
    frame = VmcFrame(BONES, OFFSETS, ["Joy", "A"], most=65_000)
    for k in range(3):
        hips, rotations = RNG.normal(size=3), some_rotations(55)
        (datagram,) = frame.write(1.5 + k, hips, rotations, [0.25, 0.5])
        assert bytes(datagram) == composed(1.5 + k, hips, rotations, {"Joy": 0.25, "A": 0.5})


def test_split_frames_hold_the_same_messages() -> None:
    hips, rotations = RNG.normal(size=3), some_rotations(55)
    whole = read(VmcFrame(BONES, OFFSETS, most=65_000).write(0.0, hips, rotations))
    parts = VmcFrame(BONES, OFFSETS).write(0.0, hips, rotations)
    assert len(parts) > 2 and max(map(len, parts)) <= SAFE_BYTES
    assert read(parts) == whole


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="'Tail' is not a bone"):
        VmcFrame(["Hips", "Tail"], np.zeros((2, 3)))
    with pytest.raises(ValueError, match=r"must be \(1, 3\)"):
        VmcFrame(["Hips"], np.zeros((2, 3)))
    with pytest.raises(ValueError):
        VmcFrame(["Hips"], np.zeros((1, 3)), ["Joy"]).write(0.0, np.zeros(3), np.array([[1.0, 0, 0, 0]]), [])
