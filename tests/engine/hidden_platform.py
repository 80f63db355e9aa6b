"""Run in a process of its own: what Windows lacks is hidden, every module is imported, and a graph is run with a simulated device."""

from __future__ import annotations

import importlib
import pkgutil
import select
import socket
import sys
from typing import Any

HIDDEN = ("pty", "termios", "tty", "fcntl", "resource")


class Hidden:
    """An import finder by which these modules do not exist."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        if name in HIDDEN:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def refuse_all_but_sockets() -> None:
    """`select` as on Windows."""
    real = select.select

    def only_sockets(r: Any, w: Any, x: Any, *timeout: Any) -> Any:
        for one in (*r, *w, *x):
            if not isinstance(one, socket.socket):
                raise OSError(10038, "An operation was attempted on something that is not a socket")
        return real(r, w, x, *timeout)

    select.select = only_sockets


def main() -> None:
    for name in HIDDEN:
        sys.modules.pop(name, None)
    sys.meta_path.insert(0, Hidden())  # type: ignore[arg-type]
    refuse_all_but_sockets()
    failed = {}
    for package in ("kinegraph.stream", "kinegraph.devices", "kinegraph.operators", "kinegraph"):
        module = importlib.import_module(package)
        for info in pkgutil.walk_packages(getattr(module, "__path__", []), f"{package}."):
            if not info.name.endswith("__main__"):
                try:
                    importlib.import_module(info.name)
                except ImportError as error:
                    if getattr(error, "name", "") in HIDDEN:
                        failed[info.name] = str(error)
    print("imported" if not failed else f"failed: {failed}", flush=True)
    sys.argv = ["kinegraph", *sys.argv[1:]]
    from kinegraph.stream.cli.main import main as command

    command()


if __name__ == "__main__":
    main()
