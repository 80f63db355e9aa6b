"""Packages that come with an extra: imported when they are used, and named where they cannot be."""

from __future__ import annotations

import importlib
from typing import Any

from kinegraph.stream.errors import KinegraphError


def optional(module: str, user: str, install: str, kind: type[KinegraphError] = KinegraphError) -> Any:
    """The module of that name; `user` is what needs it, `install` how one gets it ("pip install 'kinegraph[oak]'").

    Raises `kind`, which tells a package that is missing from one that is installed and does not load.
    """
    package = module.partition(".")[0]
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if (error.name or package).partition(".")[0] != package:
            raise kind(_broken(user, package, install, error)) from None
        raise kind(f"{user} needs {package}; install it: {install}") from None
    except (ImportError, OSError) as error:
        raise kind(_broken(user, package, install, error)) from None


def _broken(user: str, package: str, install: str, error: Exception) -> str:
    reason = str(error).strip().partition("\n")[0]
    return f"{user} needs {package}, which is installed but does not load ({reason}); {install} brings it"
