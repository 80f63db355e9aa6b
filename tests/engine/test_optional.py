"""Packages of extras: one that is missing, one that is installed and does not load, one that misses another."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinegraph.stream.errors import DeviceError, KinegraphError
from kinegraph.stream.system.extras import optional

INSTALL = "pip install 'kinegraph[oak]'"


def test_a_module_that_is_there() -> None:
    assert optional("json.decoder", "a test", INSTALL).JSONDecoder


def test_a_package_that_is_missing() -> None:
    with pytest.raises(
        DeviceError, match=r"^a camera needs no_such_camera; install it: pip install 'kinegraph\[oak\]'$"
    ):
        optional("no_such_camera.driver", "a camera", INSTALL, DeviceError)


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("raise ImportError('libusb-1.0.so.0: cannot open shared object file')", "libusb-1.0.so.0: cannot open"),
        ("raise OSError('libcamera.so: wrong ELF class')", "wrong ELF class"),
        ("import no_such_part", "No module named 'no_such_part'"),
    ],
)
def test_a_package_that_does_not_load(code: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is missing is something else: to install the package again would not help."""
    (tmp_path / "half_camera.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KinegraphError, match="is installed but does not load") as output:
        optional("half_camera", "a camera", INSTALL)
    assert reason in str(output.value)
