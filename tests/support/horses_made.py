"""Made-up horses for maps of motion: walks and trots of seven markers, sound or lame, as recordings and as an index.

`python -m tests.support.horses_made` writes operators/maps/pose_map/example.npz.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kinegraph.operators.maps.pose_map.commands.build import build_index
from kinegraph.operators.maps.pose_map.commands.gather import PoseReading
from kinegraph.operators.maps.pose_map.commands.marker_table import MarkerTable
from kinegraph.stream.chunk import NS, Array, Samples, StreamSpec, grid
from kinegraph.stream.domain.pose_map import MotionIndex
from kinegraph.stream.recording.series import Series, write_recording

NAMES = ("withers", "sacrum", "poll", "hoof_fl", "hoof_fr", "hoof_hl", "hoof_hr")
BONES = (
    ("withers", "sacrum"),
    ("withers", "poll"),
    *(("withers", h) for h in NAMES[3:5]),
    *(("sacrum", h) for h in NAMES[5:]),
)
TABLE = MarkerTable("withers", "sacrum", "y", {name: ((name,),) for name in NAMES}, BONES)
YAML = """origin: withers
ahead: sacrum
markers: {withers: [withers, T6], sacrum: [sacrum, S1 + S2], poll: , hoof_fl: , hoof_fr: , hoof_hl: , hoof_hr: }
bones: [[withers, sacrum], [withers, poll], [withers, hoof_fl], [withers, hoof_fr], [sacrum, hoof_hl], [sacrum, hoof_hr]]
"""
TIMING = {"walk": (0.0, 0.5, 0.75, 0.25), "trot": (0.0, 0.5, 0.5, 0.0)}
"""When in the cycle each hoof swings."""


def horse(
    gait: str, seconds: float, rate_hz: float = 60.0, *, lame: float = 1.0, size: float = 1.0, seed: int = 0
) -> Samples:
    """Markers (n, 7, 3) in m of a horse that goes along a curve; `lame` scales the stride of the left hind hoof."""
    n = round(seconds * rate_hz)
    rng = np.random.default_rng(seed)
    stride_hz = {"walk": 0.9, "trot": 1.4}[gait]
    phase = 2 * np.pi * (stride_hz * np.arange(n) / rate_hz + rng.uniform())
    made = np.zeros((n, 7, 3))
    made[:, 0] = [0.0, 1.5, 0.0]
    made[:, 1] = [-0.9, 1.45, 0.0]
    made[:, 2] = [0.8, 1.8, 0.0]
    made[:, :3, 1] += 0.03 * np.sin(2 * phase)[:, None]
    for k, (begin, (x, z)) in enumerate(
        zip(TIMING[gait], ((0, 0.2), (0, -0.2), (-0.9, 0.2), (-0.9, -0.2)), strict=True)
    ):
        reach = 0.35 * (lame if k == 2 else 1.0)
        own = phase + 2 * np.pi * begin
        made[:, 3 + k, 0] = x + reach * np.sin(own)
        made[:, 3 + k, 1] = 0.15 * (lame if k == 2 else 1.0) * np.clip(np.cos(own), 0.0, None)
        made[:, 3 + k, 2] = z
    made = size * made + 0.004 * rng.normal(size=made.shape)
    heading = 0.3 * np.arange(n) / rate_hz + rng.uniform(0, 6)
    c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
    x, z = made[..., 0].copy(), made[..., 2].copy()
    made[..., 0], made[..., 2] = c * x + s * z + 3.0 * np.sin(heading)[:, None], -s * x + c * z
    return made


def record(
    path: Path, data: Array, rate_hz: float = 60.0, names: tuple[str, ...] = NAMES, unit: str = "m", **facts: str
) -> Path:
    """A recording of markers, with facts about its session."""
    spec = StreamSpec(data.shape[1:], rate_hz=rate_hz, channels=names, units=(unit,))
    time = grid(rate_hz, len(data)) + 1_700_000_000 * NS
    write_recording(
        path, [Series("markers", spec, time, np.asarray(data, np.float64))], {"session": facts}, chunk_s=1.0
    )
    return path


def index_of(horses: dict[str, Samples], rows: int = 6, columns: int = 6, rate_hz: float = 60.0) -> MotionIndex:
    """The index of horses at 60 Hz."""
    reading = PoseReading(rate_hz, TABLE)
    found = []
    for name, data in horses.items():
        spec = StreamSpec(data.shape[1:], rate_hz=60.0, channels=NAMES, units=("m",))
        found += reading._sequences(name, name, spec, grid(60.0, len(data)), data, {"gait": name.split("-")[0]})
    return build_index(TABLE, found, rate_hz, rows, columns, 0)


if __name__ == "__main__":
    made = index_of({"walk": horse("walk", 5.0), "trot": horse("trot", 5.0, seed=1)}, 3, 4, 30.0)
    made.write(
        Path(__file__).resolve().parents[2] / "operators" / "maps" / "pose_map" / "example.npz",
        {"trained_on": ["made up"]},
    )
