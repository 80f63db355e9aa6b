"""Frames without detail finer than a block: every block as a few numbers (thesis, chapter 4, figure 4.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.bed.frames.basis import Learner, means
from kinegraph.operators.bed.frames.blocks import Frame, Single, gather, simplify
from kinegraph.stream.chunk import NEVER, NS, Array, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Case, Operator, grid
from kinegraph.stream.params import param

SCENE = np.dtype([("onset", "<i8"), ("what", "U9"), ("residual", "<f8")])
"""From `onset` on frames are under another basis: `learned` or `relearned`; `residual`: what it leaves out, mm of a pixel (rms)."""
EFFORT = 32 * 8**4
"""How much work on covariances a frame may cost: 32 blocks of 8 x 8. At least 8 blocks are summed, so that no sum shows one."""


@dataclass(slots=True)
class SimplifyState:
    """No frame stands here: only sums over many blocks, and vectors.

    tiles, centre, shift   of the basis in use, as `operators.bed.frames.blocks.simplify` takes them
    vectors                (m, n) the same basis
    learned                whether it was learned; before that, blocks are their means
    begun                  when the stretch began from which is learned (ns)
    turn                   which block is looked at next
    step, most             how far apart the blocks are that are looked at in a frame, and how many at most
    """

    tiles: Single
    centre: Single
    shift: Single
    vectors: Samples
    learned: bool
    learner: Learner
    begun: int
    turn: int
    step: int
    most: int
    needed: int


@dataclass(frozen=True, slots=True)
class Simplify(Operator[SimplifyState]):
    """Depth frames (height, width) uint16 in mm in, 0: no measurement; the same frames out, with `components` numbers left of each block.
    Or grey and infrared images (height, width) uint8, in which every pixel counts, and 0 is black; they come out as uint8.

    out     (height, width) uint16, mm: every block of `block` x `block` pixels as its level, and with more `components` than one also
            its projections on the principal components of what blocks hold beside their level. A block with fewer measured pixels than
            `min_valid` is 0 throughout; in any other all pixels have a value, those that were not measured count as the block's mean
    blocks  (height / block, width / block) float64, mm: the level of each block's middle: the mean of its measured pixels, less what
            the slope of the blocks around makes of those that are missing; NaN where it is not measured
    scene   an event at the first frame under another basis: a leap of all pixels that is no movement

    With one component a block is its mean: of what is finer nothing at all is left. More let the strongest patterns within blocks
    through, mostly slopes and edges. Outlines and habits remain either way: that is not anonymous.

    The thesis takes the components of every frame by itself, the level among them (of depth, the first component is the level anyway). Here
    the others are learned from the blocks of the first `learn_s` and then fixed: that costs a tenth, and does not tremble with the
    frame. Until then a block is its mean. Every further stretch of `learn_s` (64 frames at least) is compared: where its own components
    would leave `1 / worse` of the variance or less, the scene has changed, and they are taken. Components are sought by orthogonal
    iteration, one step a frame, from sums over some blocks of every frame: it keeps neither frames nor places, and neither does a snapshot
    of its state. No delay.

    >>> given, made = tried(Simplify)
    >>> given["in"][0, 0, :4], made["blocks"][0, 0, :3].round()
    (array([899,   0, 902, 902], dtype=uint16), array([913., 913., 914.]))
    """

    outputs: ClassVar[tuple[str, ...]] = ("out", "blocks", "scene")

    block: int = param(8, least=2, most=16, help="side of a block in pixels")
    components: int = param(1, least=1, help="how many numbers remain of a block")
    learn_s: float = param(120.0, above=0.0, help="how long blocks are observed before their components are chosen")
    worse: float = param(1.25, least=1.0, help="how much more the basis must leave over than a new one would")
    min_valid: float = param(0.5, above=0.0, most=1.0, help="share of a block's pixels that must be measured")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if len(spec.shape) != 2 or spec.dtype not in (np.dtype(np.uint16), np.dtype(np.uint8)):
            wanted = "depth frames: (height, width) uint16, or grey or infrared images: (height, width) uint8"
            raise InputError("in", spec.describe(), wanted)
        height, width = spec.shape
        b, m = self.block, self.components
        if height % b or width % b:
            fits = [str(k) for k in range(2, 17) if not height % k and not width % k]
            raise ParameterError(
                "block", b, f"a divisor of both {height} and {width}: {', '.join(fits) or 'no size fits'}"
            )
        if m > b * b:
            raise ParameterError("components", m, f"at most {b * b}, the pixels of a block")
        blocks = height * width // b**2
        # products of all pairs of a block's pixels: fewer blocks a frame where blocks are large
        most = min(blocks, max(8, min(64, EFFORT // b**4)))
        state = SimplifyState(
            np.zeros((m, b, width), np.float32), np.zeros((b, width), np.float32), np.zeros((m, 2), np.float32),
            means(b, m), False, Learner.of(b, m), NEVER, 0, _apart(blocks, most), most,
            max(1, int(np.ceil(self.min_valid * b * b))),
        )  # fmt: skip
        self.set_state(state)
        _use(state, state.vectors, np.zeros(b * b))
        meta = {**spec.meta, "simplified": {"block": b, "components": m}}
        grid_spec = spec.derive(shape=(height // b, width // b), dtype=np.dtype(np.float64), meta=meta)
        scene = StreamSpec((), SCENE, units=("ns", "", *(spec.units[:1] or ("",))), meta=meta)
        return {"out": spec.derive(meta=meta), "blocks": grid_spec, "scene": scene}

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        n, b = len(chunk.time), self.block
        grey = chunk.data.dtype == np.uint8
        frames = chunk.data + np.uint16(1) if grey else chunk.data  # 0 means missing, so black becomes 1
        height, width = frames.shape[1:]
        out = np.empty((n, height, width), np.uint16)
        blocks = np.empty((n, height // b, width // b))
        changes: list[tuple[int, str, float]] = []
        for i in range(n):
            if self.components > 1:
                self._learn(frames[i], int(chunk.time[i]), changes)
            simplify(frames[i], s.tiles, s.centre, s.shift, s.needed, out[i], blocks[i])
        if grey:
            out, blocks = np.minimum(out - np.uint16(1), 255).astype(np.uint8), blocks - 1.0
        scene = np.array(changes, SCENE)
        return [
            ("scene", Chunk(scene["onset"].copy(), scene, chunk.until)),
            ("out", Chunk(chunk.time, out, chunk.until, chunk.lost)),
            ("blocks", Chunk(chunk.time, blocks, chunk.until, chunk.lost)),
        ]

    @classmethod
    def cases(cls) -> Sequence[Case]:
        random = np.random.default_rng(12)
        y, x = np.mgrid[0:16, 0:24]
        first, then = 900 + 9.0 * y, np.where(x % 7 < 3, 1400.0, 900.0)
        frames = np.where(np.arange(240)[:, None, None] < 90, first, then) + random.normal(0, 3, (240, 16, 24))
        frames[random.random(frames.shape) < 0.1] = 0
        frames[40:43] = 0
        spec = StreamSpec((16, 24), np.dtype(np.uint16), 30.0, units=("mm",))
        grey, shades = StreamSpec((16, 24), np.dtype(np.uint8), 30.0), (frames / 8).astype(np.uint8)
        inputs = {"in": (spec, grid(30.0, 240), frames.astype(np.uint16))}
        return [
            Case(cls(block=4, components=2, learn_s=0.5), inputs, least=482),
            Case(cls(block=8), inputs, least=480),
            Case(cls(block=4, components=2, learn_s=0.5), {"in": (grey, grid(30.0, 240), shades)}, least=481),
        ]

    def _learn(self, frame: Frame, time: int, changes: list[tuple[int, str, float]]) -> None:
        """What this frame adds to what is known; a basis that is found holds for it already."""
        s, b = self.state, self.block
        learner = s.learner
        if s.begun == NEVER:
            s.begun = time
        if learner.idle and time - s.begun >= self.learn_s * NS:
            learner.conclude()
            s.begun = time
        elif learner.advance():
            left, now = learner.missed(learner.vectors), learner.missed(s.vectors)
            if not s.learned or now > self.worse * left:
                changes.append((time, "relearned" if s.learned else "learned", float(np.sqrt(left)) / b))
                s.learned = True
                _use(s, learner.vectors, learner.centre)
        learner.count += gather(frame, b, s.needed, s.turn, s.step, s.most, learner.sums)
        s.turn = (s.turn + s.most * s.step) % (frame.size // b**2)


def frames_of(spec: StreamSpec, port: str = "in") -> None:
    """Raises where a stream is not one of depth frames."""
    if len(spec.shape) != 2 or spec.dtype != np.dtype(np.uint16):
        raise InputError(port, spec.describe(), "depth frames: (height, width) uint16")


def _apart(blocks: int, most: int) -> int:
    """A step that visits every one of the blocks before it comes back, spread over the frame."""
    step = max(1, blocks // most)
    while np.gcd(step, blocks) != 1:
        step += 1
    return step


def _use(s: SimplifyState, vectors: Samples, centre: Array) -> None:
    """Take a basis into use."""
    b, width = s.centre.shape
    s.vectors[:] = vectors
    square = vectors.reshape(-1, b, b).astype(np.float32)
    s.tiles[:] = np.tile(square, (1, 1, width // b))
    s.centre[:] = np.tile(centre.reshape(b, b).astype(np.float32), (1, width // b))
    s.shift[:, 0] = square.sum(axis=(1, 2))
    s.shift[:, 1] = (square * centre.reshape(b, b).astype(np.float32)).sum(axis=(1, 2))
