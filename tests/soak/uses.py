"""The graphs that are soaked: the shipped configurations, each with a device that counts its own samples, a table and a broker."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
RATE_HZ = 200.0
COUNTED = """
  lines:
    use: devices.lines.AsciiLines
    port: {port}
    columns: [index, t, n]
    time: t
    counter: n
    rate_hz: {rate_hz}
  table: {{use: devices.outlets.csv_file.CsvFile, from: lines, path: lines.csv}}
  home:
    use: devices.mqtt.MqttOutlet
    from: lines
    broker: {{host: 127.0.0.1, port: {broker}}}
    device: {{id: soak}}
    entities: {{index: {{of: lines, field: index, name: Index, every_s: 0.2}}}}
"""


@dataclass(frozen=True, slots=True)
class Use:
    """One of the shipped graphs.

    live     settings that make it run in real time
    hours    settings that make so many `{seconds}`, or `{hours}`, of it run as fast as they can
    regular  its sources' streams with stamps on a grid
    """

    name: str
    config: str
    live: tuple[str, ...]
    hours: tuple[str, ...]
    regular: tuple[str, ...]

    def write(self, folder: Path, port: str, broker: int) -> Path:
        """The graph of the soak in `folder`: as shipped, and what counts beside it."""
        path = folder / f"{self.name}.yaml"
        shipped = (CONFIGS / self.config).read_text(encoding="utf-8")
        path.write_text(shipped + COUNTED.format(port=port, rate_hz=RATE_HZ, broker=broker), encoding="utf-8")
        return path


USES = (
    Use(
        "treadmill",
        "treadmill_emg.yaml",
        ("treadmill.muscles=[TA, SO]",),
        (
            "treadmill.muscles=[TA, SO]",
            "treadmill.realtime=false",
            "treadmill.duration_s={seconds:g}",
            "treadmill.chunk_ms=1000",
        ),
        ("treadmill.emg", "treadmill.force"),
    ),
    Use(
        "bedside",
        "bedside_simulated.yaml",
        ("camera.speed=1", "camera.evening_min=2", "recording.rolling=false"),
        ("camera.bed_h={hours:g}",),
        ("camera.depth",),
    ),
    Use(
        "motion",
        "segment_mocap.yaml",
        ("mocap.duration_s=0",),
        ("mocap.realtime=false", "mocap.duration_s={seconds:g}"),
        (),
    ),
    Use(
        "avatar",
        "avatar_markers.yaml",
        (),
        ("performer.realtime=false", "performer.duration_s={seconds:g}"),
        ("performer.markers", "performer.pose"),
    ),
)
