"""`python -m tests.platform_wheel FOLDER`: beside the wheel in FOLDER, one for Linux on x86-64 that holds compiled kernels.

Every operator and every shipped graph is compiled for two levels of processors, with this Python and its numba; a wheel is tagged for this
Python. FOLDER/constraints.txt names the versions with which pip has to install it for the kernels to fit; with others they are compiled at
the first start, as from the wheel without them.
"""

from __future__ import annotations

import csv
import hashlib
import io
import os
import platform
import subprocess
import sys
import zipfile
from base64 import urlsafe_b64encode
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

from kinegraph.stream.compiler.cache import LEVELS, MADE_BY, SUFFIX

PYTHON = f"cp{sys.version_info.major}{sys.version_info.minor}"
TAG = f"{PYTHON}-none-manylinux_2_28_x86_64"
"""As numba's own wheels; the kernels ask for less."""
WHERE = "kinegraph/compiled"


def compiled(level: str, folder: Path) -> list[Path]:
    """The kernels of all operators and graphs, for this level."""
    names = {"NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": "", "KINEGRAPH_CACHE": str(folder)}
    command = [sys.executable, "-m", "kinegraph", "dev", "compile", "all"]
    subprocess.run(command, env={**os.environ, **names}, check=True)
    return sorted((folder / "kernels").glob(f"*/*{SUFFIX}"))


def with_kernels(wheel: Path, kernels: dict[str, list[Path]]) -> Path:
    """Another wheel, which holds these kernels by level, too."""
    made = wheel.with_name(wheel.name.replace("py3-none-any", TAG))
    rows = []
    with zipfile.ZipFile(wheel) as old, zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as new:

        def put(name: str, content: bytes, how: int = zipfile.ZIP_DEFLATED) -> None:
            new.writestr(zipfile.ZipInfo(name, (2020, 2, 2, 0, 0, 0)), content, how)
            digest = urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
            rows.append((name, f"sha256={digest}", len(content)))

        for name in old.namelist():
            if name.endswith(".dist-info/RECORD"):
                record = name
            elif name.endswith(".dist-info/WHEEL"):
                text = old.read(name).decode().replace("Tag: py3-none-any", f"Tag: {TAG}")
                put(name, text.replace("Root-Is-Purelib: true", "Root-Is-Purelib: false").encode())
            else:
                put(name, old.read(name))
        for level, files in kernels.items():
            for file in files:
                where = f"{WHERE}/{MADE_BY}/{level}/{file.parent.name}/{file.name}"
                put(where, file.read_bytes(), zipfile.ZIP_STORED)  # which are compressed
        written = io.StringIO()
        csv.writer(written, lineterminator="\n").writerows([*rows, (record, "", "")])
        new.writestr(record, written.getvalue())
    return made


def main() -> None:
    folder = Path(sys.argv[1])
    (wheel,) = folder.glob(f"kinegraph-{version('kinegraph')}-py3-none-any.whl")
    if (sys.platform, platform.machine()) != ("linux", "x86_64"):
        print("kernels for x86-64 are compiled on Linux, on x86-64: only the wheel without them was built")
        return
    with TemporaryDirectory() as work:
        kernels = {level: compiled(level, Path(work) / level) for level in LEVELS}
        made = with_kernels(wheel, kernels)
        sizes = {level: sum(file.stat().st_size for file in files) / 1e6 for level, files in kernels.items()}
    pins = [f"{name}=={version(name)}" for name in ("numba", "llvmlite", "numpy")]
    (folder / "constraints.txt").write_text("\n".join([*pins, ""]), encoding="utf-8")
    for level, size in sizes.items():
        print(f"{level}: {len(kernels[level])} kernels, {size:.1f} MB")
    print(f"{made}: {made.stat().st_size / 1e6:.1f} MB; without kernels {wheel.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
