"""Decoders under atheris, which looks for bytes that reach new code: never an exception, and any cut gives the same.

Each for `KINEGRAPH_FUZZ_S` seconds (5 if not given).
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("atheris", reason="atheris is not installed (pip install 'kinegraph[peers]')")

HOUSE = Path(__file__).resolve().parent.parent.parent
SECONDS = int(os.environ.get("KINEGRAPH_FUZZ_S", "5"))

PROGRAM = """
import sys
import atheris
import kinegraph.devices.mti.xbus_numbers  # kernels: what is compiled cannot be watched
with atheris.instrument_imports(include=["kinegraph.devices"]):
    from kinegraph.devices.protocols import {module}
from kinegraph.devices.frames.declared import Field, Frame
from kinegraph.devices.frames.layout import FrameLayout
FRAMES = [FrameLayout(Frame("A5 5A", (Field("u8", role="counter"), Field("i16", "x")), "m", checksum="sum8")),
          FrameLayout(Frame("A5", (Field("u16", "y"),), "b", footer="0D"))]
def decoded(decoder, pieces):
    found = [decoder.feed(piece) for piece in pieces]
    return {decoded}
def one(data):
    at = data[0] % len(data) if data else 0
    assert decoded({make}, [data]) == decoded({make}, [data[:at], data[at:]])
atheris.Setup(sys.argv, one)
atheris.Fuzz()
"""

TARGETS = {
    "cyton": ("cyton.Decoder()", "b''.join(f.counts.tobytes() for f in found), sum(f.dropped for f in found)"),
    "ascii_lines": (
        "ascii_lines.Decoder(('a', 'b'), header=True)",
        "[repr(r) for f in found for r in f.rows.tolist()], sum(f.rejected for f in found)",
    ),
    "bitalino": ("bitalino.Decoder(3)", "b''.join(f.counts.tobytes() for f in found), sum(f.dropped for f in found)"),
    "shimmer": (
        "shimmer.Decoder((0, 1, 2, 30), 64)",
        "b''.join(f.table.tobytes() for f in found), sum(f.dropped for f in found), sum(f.repeated for f in found)",
    ),
    "xbus": ("xbus.Decoder()", "sum(len(r) for f in found for r in f.runs), sum(f.dropped for f in found)"),
    "declared": (
        "declared.Decoder(FRAMES)",
        "[k for f in found for k in f.kinds], sum(f.dropped for f in found), sum(f.bad for f in found)",
    ),
}
"""By module of devices.protocols: how a decoder is made, and what must not depend on the cuts."""


@pytest.mark.parametrize("module", TARGETS)
def test_no_bytes_are_found_that_break_it(module: str, tmp_path: Path) -> None:
    make, reported = TARGETS[module]
    program = tmp_path / "fuzz.py"
    program.write_text(PROGRAM.format(module=module, make=make, decoded=reported), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(program), f"-max_total_time={SECONDS}", "-max_len=2048", "-verbosity=0"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(HOUSE)},
        timeout=SECONDS + 120,
    )
    assert done.returncode == 0, done.stderr[-3000:]
