"""NatNet frames and descriptions put together, for simulators and tests: 3.0 to 4.2."""

from __future__ import annotations

import struct

from kinegraph.devices.natnet.protocol import SIZED, NatNetBody, NatNetFrame, NatNetModels, Version


def build_frame(frame: NatNetFrame, version: Version) -> bytes:
    """The payload of a frame."""
    sized = version >= SIZED

    def section(parts: list[bytes]) -> bytes:
        body = b"".join(parts)
        return struct.pack("<i", len(parts)) + (struct.pack("<i", len(body)) if sized else b"") + body

    made = struct.pack("<i", frame.number)
    made += section([_text(name) + _counted(points, "3f") for name, points in frame.sets.items()])
    made += section([struct.pack("<3f", *point) for point in frame.unlabelled])
    made += section([_body(one) for one in frame.bodies])
    made += section(
        [
            struct.pack("<ii", number, len(bones)) + b"".join(map(_body, bones))
            for number, bones in frame.skeletons.items()
        ]
    )
    if sized:
        made += section([])
    made += section(
        [
            struct.pack("<i3ffhf", m.model << 16 | m.marker, *m.position, m.size, m.flags, m.residual)
            for m in frame.markers
        ]
    )
    for kind in ("plate", "device"):
        parts = []
        for (of, number), channels in frame.analog.items():
            if of == kind:
                each = b"".join(struct.pack(f"<i{len(c)}f", len(c), *c) for c in channels)
                parts.append(struct.pack("<ii", number, len(channels)) + each)
        made += section(parts)
    made += struct.pack("<IIdQQQ", *frame.timecode, frame.time_s, *frame.ticks)
    made += struct.pack("<II", 0, 0) if sized else b""
    return made + struct.pack("<hi", frame.flags, 0)


def build_models(models: NatNetModels, version: Version) -> bytes:
    """The payload of the descriptions."""
    parts = [(0, _text(name) + _texts(names)) for name, names in models.sets.items()]
    parts += [(1, _described(name, i, -1, models.markers.get(i, []), version)) for i, name in models.bodies.items()]
    for number, (name, bones) in models.skeletons.items():
        each = b"".join(_described(text, bone, parent, [], version) for bone, (text, parent) in bones.items())
        parts.append((2, _text(name) + struct.pack("<ii", number, len(bones)) + each))
    for (kind, number), names in models.analog.items():
        if kind == "plate":
            about = _text("SN1") + struct.pack("<161f", *[0.0] * 161) + struct.pack("<ii", 0, 0)
            parts.append((3, struct.pack("<i", number) + about + _texts(names)))
        else:
            about = _text("Device") + _text("SN2") + struct.pack("<ii", 0, 0)
            parts.append((4, struct.pack("<i", number) + about + _texts(names)))
    sized = version >= SIZED
    lines = [struct.pack("<i", kind) + (struct.pack("<i", len(b)) if sized else b"") + b for kind, b in parts]
    return struct.pack("<i", len(lines)) + b"".join(lines)


def _body(one: NatNetBody) -> bytes:
    return struct.pack("<i3f4ffh", one.id, *one.position, *one.rotation, one.error, one.tracked)


def _described(name: str, number: int, parent: int, markers: list[str], version: Version) -> bytes:
    n = len(markers)
    made = _text(name) + struct.pack("<ii3f", number, parent, 0, 0, 0)
    made += struct.pack("<4f", 0, 0, 0, 1) if version >= (4, 2) else b""
    made += struct.pack("<i", n) + bytes(12 * n) + struct.pack(f"<{n}i", *range(1, n + 1))
    return made + (b"".join(map(_text, markers)) if version >= (4, 0) else b"")


def _text(text: str) -> bytes:
    return text.encode() + b"\0"


def _texts(texts: list[str]) -> bytes:
    return struct.pack("<i", len(texts)) + b"".join(map(_text, texts))


def _counted(rows: list[tuple[float, float, float]], form: str) -> bytes:
    return struct.pack("<i", len(rows)) + b"".join(struct.pack("<" + form, *row) for row in rows)
