"""The graphs that come with kinegraph, found by their bare names."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).parents[2]
_ENDINGS = (".yaml", ".yml")


def shipped_folder(package: Path = _PACKAGE) -> Path | None:
    """The folder of the shipped graphs; None if they were not installed."""
    folder = package / "configs"  # a link in a checkout
    return folder.resolve() if folder.is_dir() else None


def shipped() -> dict[str, Path]:
    """The shipped graphs by name: {"treadmill_emg": .../treadmill_emg.yaml}."""
    folder = shipped_folder()
    return {p.stem: p for p in sorted(folder.glob("*.yaml"))} if folder else {}


def shipped_parts() -> dict[str, Path]:
    """The shipped parts of graphs, as a graph's `use` names them: {"parts/emg.yaml": ...}."""
    folder = shipped_folder()
    return {p.relative_to(folder).as_posix(): p for p in sorted(folder.glob("parts/*.yaml"))} if folder else {}


def resolve(path: Path) -> Path:
    """The file that is meant: `path` if there is one, else the shipped graph of that bare name ("treadmill_emg", also with .yaml)."""
    bare = path.parent == Path() and path.suffix in ("", *_ENDINGS)
    if not bare or path.is_file():
        return path
    return shipped().get(path.stem if path.suffix else path.name, path)


def summary(path: Path) -> str:
    """What a graph is for: the first sentence of the comment that it begins with."""
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("# ").strip())
    return " ".join(lines).partition(". ")[0].rstrip(".:")
