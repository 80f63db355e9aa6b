"""Fingers that bend and faces that move: from landmarks to what an avatar receives."""

from __future__ import annotations

import socket

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinegraph.devices.osc.vmc_outlet import VmcOutlet
from kinegraph.devices.people.performer import true_pose
from kinegraph.operators.body.camera.expressions import (
    EXPRESSIONS,
    EYES,
    FACE,
    MEASURES,
    MOUTH,
    expressions,
    learn_rest,
    measures,
)
from kinegraph.operators.body.camera.hand_bends import hand_bends
from kinegraph.operators.body.camera.hands import Hands
from kinegraph.operators.body.names import SEEN
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.domain.fingers import (
    BENDS,
    FINGER_BONES,
    MAX_BENDS,
    MIN_BENDS,
    RELAXED,
    finger_offsets,
    finger_rotations,
)  # fmt: skip
from kinegraph.stream.domain.humanoid import usual_body
from kinegraph.stream.errors import InputError


def landmarks(bends: np.ndarray, hand: int) -> np.ndarray:
    """The 21 landmarks (m) of a hand whose fingers bend so, by the avatar's own bones: palm down, fingers away from the body."""
    offsets, turns = finger_offsets().reshape(2, 5, 3, 3)[hand], finger_rotations(bends).reshape(2, 5, 3, 4)[hand]
    made = np.zeros((21, 3))
    for finger in range(5):
        place, turn = np.zeros(3), Rotation.identity()
        for joint in range(3):
            place = place + turn.apply(offsets[finger, joint])
            turn = turn * Rotation.from_quat(turns[finger, joint], scalar_first=True)
            made[1 + 4 * finger + joint] = place
        made[4 + 4 * finger] = place + turn.apply(0.6 * offsets[finger, 2])
    return made


@pytest.mark.parametrize("hand", [0, 1])
@pytest.mark.parametrize("seed", range(5))
def test_the_bends_of_a_hand_are_found_in_its_landmarks(hand: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    bends = np.where(random.random(40) < 0.5, 0.0, random.uniform(0.0, 0.8 * MAX_BENDS))
    bends[[k for k, name in enumerate(BENDS) if "spread" in name or "Thumb" in name]] = 0.0
    turn = Rotation.random(random_state=seed)
    found = np.empty((5, 4))
    hand_bends(turn.apply(landmarks(bends, hand)), hand == 0, found)
    wanted = bends[20 * hand : 20 * hand + 20].reshape(5, 4)
    np.testing.assert_allclose(found[1:, [0, 2, 3]], wanted[1:, [0, 2, 3]], atol=4.0)


def test_fingers_and_thumb_curl_towards_the_palm() -> None:
    curled = np.where(["spread" in name for name in BENDS], 0.0, 40.0)
    for hand, outwards in ((0, 1.0), (1, -1.0)):
        flat, bent = landmarks(np.zeros(40), hand), landmarks(curled, hand)
        for tip in (8, 12, 16, 20):
            assert bent[tip, 1] < flat[tip, 1] - 0.02  # palms face down
            assert outwards * bent[tip, 0] < outwards * flat[tip, 0]
        assert bent[4, 1] < flat[4, 1] - 0.001 and bent[4, 2] < flat[4, 2] - 0.01


def test_a_hand_that_is_not_seen_keeps_its_bends_and_then_relaxes() -> None:
    operator, spec = Hands(model="figure", min_px=400.0, hold_s=0.5, relax_s=0.2), StreamSpec((), SEEN, rate_hz=30.0)
    operator.open({"image": StreamSpec((48, 64, 3), np.dtype(np.uint8), rate_hz=30.0), "seen": spec})
    operator.state.bends[:] = MAX_BENDS
    operator.state.seen[:] = operator.state.last = NS
    rows = []
    for k in range(1, 60):
        time = np.array([NS + k * NS // 30])
        operator.process("image", Chunk(time, np.zeros((1, 48, 64, 3), np.uint8), int(time[0])))
        made = dict(operator.process("seen", Chunk(time, np.zeros(1, SEEN), int(time[0]))))
        rows += made["bends"].data.tolist()
    assert np.array_equal(rows[10], MAX_BENDS)
    np.testing.assert_allclose(rows[-1], RELAXED, atol=1.0)
    assert (RELAXED >= MIN_BENDS).all() and (RELAXED <= MAX_BENDS).all()


def test_fingers_go_out_as_unitys_bones_beside_the_body() -> None:
    osc_bundle = pytest.importorskip("pythonosc.osc_bundle", reason="python-osc is not installed")
    bends = np.where(np.array(BENDS) == "LeftIndex.bend", 60.0, 0.0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(5.0)
        outlet = VmcOutlet(port=receiver.getsockname()[1], max_bytes=65000)
        outlet.open({"pose": usual_body().spec(30.0), "fingers": StreamSpec((40,), rate_hz=30.0, channels=BENDS)})
        outlet.begin()
        outlet.process("fingers", Chunk(np.array([1]), bends[None], 1))
        outlet.process("pose", Chunk(np.array([2]), true_pose(0.0)[None], 2))
        messages = [(m.address, list(m.params)) for m in osc_bundle.OscBundle(receiver.recv(65536))]
        outlet.close()
    bones = {values[0]: values[1:] for address, values in messages if address == "/VMC/Ext/Bone/Pos"}
    assert set(FINGER_BONES) < set(bones) and len(bones) == 52
    # Unity is left-handed: a turn about z changes its sign
    np.testing.assert_allclose(
        bones["LeftIndexProximal"][3:], [0.0, 0.0, np.sin(np.pi / 6), np.cos(np.pi / 6)], atol=1e-5
    )
    np.testing.assert_allclose(bones["RightIndexProximal"][3:], [0.0, 0.0, 0.0, 1.0], atol=1e-5)


def test_other_signals_are_no_fingers() -> None:
    with pytest.raises(InputError, match="bends of fingers"):
        VmcOutlet().open({"pose": usual_body().spec(30.0), "fingers": StreamSpec((40,), rate_hz=30.0)})


def face(
    *, closed: tuple[float, float] = (0.0, 0.0), mouth: float = 0.0, size: float = 200.0, turn: float = 0.0
) -> np.ndarray:
    """A face's points (468, 3): only those that are measured, the others in the middle."""
    made = np.zeros((468, 3))
    made[FACE] = [(0.0, -0.5, 0.0), (0.0, 0.5 + mouth, 0.0), (-0.37, 0.0, 0.0), (0.37, 0.0, 0.0)]
    for eye, x in ((0, 1.0), (1, -1.0)):
        lid = 0.05 * (1.0 - closed[eye])
        made[EYES[eye]] = [
            (x * 0.24, -0.1, 0.0), (x * 0.1, -0.1, 0.0), (x * 0.2, -0.1 - lid / 2, 0.0), (x * 0.2, -0.1 + lid / 2, 0.0),
            (x * 0.14, -0.1 - lid / 2, 0.0), (x * 0.14, -0.1 + lid / 2, 0.0),
        ]  # fmt: skip
    made[MOUTH] = [
        (-0.14, 0.22, 0.0), (0.14, 0.22, 0.0), (0.0, 0.22 - mouth / 2, 0.0), (0.0, 0.22 + mouth / 2, 0.0),
        (0.0, 0.19 - mouth / 2, 0.0), (0.0, 0.25 + mouth / 2, 0.0),
    ]  # fmt: skip
    return Rotation.from_euler("z", turn).apply(size * made)


def weights(rows: list[np.ndarray]) -> np.ndarray:
    """What the rows of points give, one after the other, of a face that is learned as they come."""
    rest, made = np.full(MEASURES, np.nan), []
    for k, points in enumerate(rows):
        now, out = np.empty(MEASURES), np.empty(len(EXPRESSIONS))
        measures(np.ascontiguousarray(points), now)
        learn_rest(now, 0.002, float(k), rest)
        expressions(now, rest, out)
        made.append(out)
    return np.array(made)


@pytest.mark.parametrize("size", [60.0, 300.0])
def test_a_blink_is_the_blink_of_its_own_eye(size: float) -> None:
    rows = [face(size=size)] * 60 + [face(size=size, closed=(0.9, 0.0))] * 6 + [face(size=size, turn=0.4)] * 30
    made = weights(rows)
    left, right = (EXPRESSIONS.index(name) for name in ("Blink_L", "Blink_R"))
    assert made[62, left] > 0.9 and made[62, right] == 0.0
    assert made[40].max() == 0.0 and made[-1].max() < 0.05


def test_lids_that_close_as_far_as_the_network_shows_closed_ones_are_a_whole_blink() -> None:
    """Of rendered faces with closed eyes the network's lids are still apart, by 36 to 50 % of an open eye's opening."""
    made = weights([face()] * 60 + [face(closed=(0.55, 0.55))] * 4)
    blink = [EXPRESSIONS.index(name) for name in ("Blink_L", "Blink_R")]
    assert made[-1, blink].min() > 0.95 and made[59, blink].max() == 0.0


def test_an_open_mouth_is_an_a_and_opens_the_jaw() -> None:
    made = weights([face()] * 30 + [face(mouth=0.2)] * 5)
    for name in ("A", "jawOpen"):
        assert made[20, EXPRESSIONS.index(name)] == 0.0 and made[-1, EXPRESSIONS.index(name)] > 0.7
    assert made[-1, EXPRESSIONS.index("U")] == 0.0
