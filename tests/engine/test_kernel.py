"""Compiled code is never stale: an edit anywhere in the package of a kernel is seen; an empty or read-only cache is no trouble."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

from kinegraph.stream.kernel import kernel
from tests.support.tiers import rest_nightly

HOUSE = Path(__file__).resolve().parents[2]
RUN = """
import sys
sys.path.insert(0, {folder!r})
from numba.core import event
with event.install_recorder("numba:compile") as recorder:
    from {module} import outer
    print(outer(3.0), sum(e.is_start for _, e in recorder.buffer))
"""
OUTER = """
from kinegraph.stream.kernel import kernel
from {inner} import inner

@kernel
def outer(x):
    return inner(x) + 1.0
"""
INNER = """
from kinegraph.stream.kernel import kernel

@kernel
def inner(x):
    return x * {factor}
"""


def run(folder: Path, module: str, cache: Path) -> tuple[float, int]:
    """In a process of its own: what `outer(3.0)` gives, and how many kernels were compiled for it."""
    code = RUN.format(folder=str(folder), module=module)
    # a module that is written again within a second would be the compiled one of before
    environment = {**os.environ, "KINEGRAPH_CACHE": str(cache), "PYTHONDONTWRITEBYTECODE": "1"}
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)
    assert found.returncode == 0, found.stderr
    value, compiled = found.stdout.split()
    return float(value), int(compiled)


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(textwrap.dedent(text))


@pytest.mark.parametrize("packaged", rest_nightly(True, False))
def test_an_edit_of_a_callee_in_another_file_is_seen(tmp_path: Path, packaged: bool) -> None:
    home, cache = tmp_path / "mine", tmp_path / "cache"
    place = home / "gains" if packaged else home
    module = "gains.outer" if packaged else "outer_gain"
    inner = "gains.deep.inner" if packaged else "inner_gain"
    if packaged:
        write(place / "__init__.py", "")
        write(place / "deep" / "__init__.py", "")
    write(home / f"{module.replace('.', '/')}.py", OUTER.format(inner=inner))
    write(home / f"{inner.replace('.', '/')}.py", INNER.format(factor=10.0))
    value, compiled = run(home, module, cache)
    assert (value, compiled > 0) == (31.0, True), "an empty cache is filled"
    assert run(home, module, cache) == (31.0, 0), "nothing changed: nothing compiles"
    write(home / f"{inner.replace('.', '/')}.py", INNER.format(factor=20.0))
    assert run(home, module, cache)[0] == 61.0, "the old machine code was used"


def test_a_file_that_is_imported_by_two_names_is_kept_twice(tmp_path: Path) -> None:
    write(
        tmp_path / "sub" / "whole_gain.py",
        "from kinegraph.stream.kernel import kernel\n\n@kernel\ndef outer(x):\n    return x * 2.0\n",
    )
    assert run(tmp_path / "sub", "whole_gain", tmp_path / "cache")[0] == 6.0
    assert run(tmp_path, "sub.whole_gain", tmp_path / "cache")[0] == 6.0
    assert run(tmp_path / "sub", "whole_gain", tmp_path / "cache") == (6.0, 0)


def test_a_cache_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    code = "from kinegraph.stream.kernel import kernel\n@kernel\ndef f(x): return x\n"
    (tmp_path / "late.py").write_text(code)
    environment = {**os.environ, "KINEGRAPH_CACHE": str(tmp_path / "file")}
    found = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import late; late.f(1.0)"],
        capture_output=True, text=True, env=environment, check=False,
    )  # fmt: skip
    assert found.returncode == 1
    assert "set KINEGRAPH_CACHE to a folder that can be written" in found.stderr


def test_division_follows_numpy_and_raises_nothing() -> None:
    @kernel
    def divide(x: float, y: float) -> float:
        return x / y

    assert divide(1.0, 0.0) == np.inf
    assert np.isnan(divide(0.0, 0.0))


def test_sums_keep_their_order() -> None:
    """Fastmath would be free to add in another order, and so to depend on the chunk."""

    @kernel
    def total(x: np.ndarray) -> float:
        s = 0.0
        for v in x:
            s += v
        return s

    x = np.random.default_rng(1).normal(size=1001) * 10.0 ** np.random.default_rng(2).integers(-8, 8, 1001)
    plain = 0.0
    for v in x:
        plain += v
    assert total(x) == plain


LATE = """
from kinegraph.stream.kernel import kernel
from factors import FACTORS
from inner_gain import inner

@kernel
def outer(x):
    return below(x) + 1.0

@kernel
def below(x):
    return inner(x) * FACTORS[0]
"""


def test_what_stands_further_down_and_constants_of_other_files_count(tmp_path: Path) -> None:
    """A kernel may call what its file defines only later, which reaches into other files."""
    cache = tmp_path / "cache"
    write(tmp_path / "late_gain.py", LATE)
    write(tmp_path / "inner_gain.py", INNER.format(factor=10.0))
    write(tmp_path / "factors.py", "FACTORS = (1.0, 2.0)")
    assert run(tmp_path, "late_gain", cache)[0] == 31.0
    assert run(tmp_path, "late_gain", cache) == (31.0, 0)
    write(tmp_path / "inner_gain.py", INNER.format(factor=20.0))
    assert run(tmp_path, "late_gain", cache)[0] == 61.0, "a callee of a callee"
    write(tmp_path / "factors.py", "FACTORS = (2.0, 2.0)")
    assert run(tmp_path, "late_gain", cache)[0] == 121.0, "a constant of another file"


def test_an_edit_elsewhere_compiles_nothing(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    write(tmp_path / "outer_gain.py", OUTER.format(inner="inner_gain"))
    write(tmp_path / "inner_gain.py", INNER.format(factor=10.0))
    write(tmp_path / "beside.py", "x = 1")
    assert run(tmp_path, "outer_gain", cache)[1] > 0
    write(tmp_path / "beside.py", "x = 2")
    assert run(tmp_path, "outer_gain", cache) == (31.0, 0)


def test_every_process_takes_the_same_fingerprints(tmp_path: Path) -> None:
    """No address, order of a set or time of day may get into one, nor where the tree lies: the cache would never be found again."""
    code = (
        "import kinegraph.operators.neighbours.operator as o, kinegraph.operators.neighbours.layout as l\n"
        "import kinegraph, kinegraph.operators.filters.iir as i\n"
        "import kinegraph.operators.segmentation.operator as s, kinegraph.operators.segmentation.kernels.clusters as e\n"
        "from kinegraph.stream.compiler.fingerprint import fingerprint as f\n"
        "print([f(v.py_func) for m in (o, l, i, s, e) for n, v in sorted(vars(m).items()) if hasattr(v, 'py_func')])\n"
        "print(kinegraph.__path__)"
    )
    shutil.copytree(
        HOUSE / "kinegraph", tmp_path / "kinegraph", ignore=shutil.ignore_patterns("__pycache__", "web", "built")
    )
    environment = {**os.environ, "PYTHONPATH": ""}
    output = [
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=place, env=environment
        ).stdout.splitlines()
        for place in (HOUSE, HOUSE, tmp_path)
    ]
    assert output[0][0] == output[1][0] == output[2][0] and len(output[0][0]) > 60
    assert str(tmp_path) in output[2][1] and output[0][1] == output[1][1] != output[2][1]


BESIDE = """
from kinegraph.stream.kernel import kernel
{more}
A, B = {a}, {b}

@kernel
def outer(x):
    return A * x + B

@kernel
def beside(x):
    return x - {c}
"""


def test_an_edit_beside_a_kernel_compiles_nothing(tmp_path: Path) -> None:
    """In its own file, too: another function, or lines that move it."""
    cache = tmp_path / "cache"
    write(tmp_path / "one_gain.py", BESIDE.format(more="", a=2.0, b=1.0, c=1))
    assert run(tmp_path, "one_gain", cache)[1] > 0
    write(tmp_path / "one_gain.py", BESIDE.format(more="# moved\n\n", a=2.0, b=1.0, c=2))
    assert run(tmp_path, "one_gain", cache) == (7.0, 0)


def test_the_same_file_elsewhere_compiles_nothing(tmp_path: Path) -> None:
    for where in ("here", "there"):
        write(tmp_path / where / "one_gain.py", BESIDE.format(more="", a=2.0, b=1.0, c=1))
    assert run(tmp_path / "here", "one_gain", tmp_path / "cache")[1] > 0
    assert run(tmp_path / "there", "one_gain", tmp_path / "cache") == (7.0, 0)


def test_which_constant_and_which_function_a_name_stands_for_counts(tmp_path: Path) -> None:
    """Two constants exchanged, and a library's function instead of another by the same name."""
    cache = tmp_path / "cache"
    write(tmp_path / "one_gain.py", BESIDE.format(more="", a=2.0, b=1.0, c=1))
    assert run(tmp_path, "one_gain", cache)[0] == 7.0
    write(tmp_path / "one_gain.py", BESIDE.format(more="", a=1.0, b=2.0, c=1))
    assert run(tmp_path, "one_gain", cache)[0] == 5.0
    named = "from math import {} as f\nfrom kinegraph.stream.kernel import kernel\n\n@kernel\ndef outer(x):\n    return f(x)\n"
    write(tmp_path / "library_gain.py", named.format("floor"))
    assert run(tmp_path, "library_gain", cache)[0] == 3.0
    write(tmp_path / "library_gain.py", named.format("sqrt"))
    assert run(tmp_path, "library_gain", cache)[0] == 3.0**0.5
    for default, value in ((2.0, 6.0), (4.0, 12.0)):
        write(
            tmp_path / "default_gain.py",
            f"from kinegraph.stream.kernel import kernel\n\n@kernel\ndef outer(x, by={default}):\n    return x * by\n",
        )
        assert run(tmp_path, "default_gain", cache)[0] == value


def test_a_kernel_that_gives_up_the_interpreter_lock_is_another_one(tmp_path: Path) -> None:
    """Its code is the same, but not what was compiled around it."""
    text = "from kinegraph.stream.kernel import kernel\n\n@kernel{}\ndef outer(x):\n    return x + 1.0\n"
    write(tmp_path / "free_gain.py", text.format(""))
    assert run(tmp_path, "free_gain", tmp_path / "cache")[1] > 0
    write(tmp_path / "free_gain.py", text.format("(nogil=True)"))
    assert run(tmp_path, "free_gain", tmp_path / "cache")[1] > 0
    assert run(tmp_path, "free_gain", tmp_path / "cache")[1] == 0


def test_machine_code_is_made_for_what_python_calls_alone() -> None:
    """A kernel that others call is optimised within them; once Python calls it, it has machine code of its own."""

    @kernel
    def twice(x: float) -> float:
        return 2.0 * x

    @kernel
    def outer(x: float) -> float:
        return twice(x) + 1.0

    assert outer(3.0) == 7.0
    assert not twice.signatures  # type: ignore[attr-defined]
    assert twice(3.0) == 6.0
    assert outer(3) == 7.0, "other types than before"
