"""The documentation's site: built in strict mode without a network, with every page, every component, and a search over all of it."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from kinegraph.stream.cli.registry import names
from kinegraph.stream.graph.components import catalogue
from kinegraph.stream.params import schema

HOUSE = Path(__file__).resolve().parents[2]
NO_NETWORK = "import socket, sys\ndef refused(*_, **__):\n    raise OSError('no network here')\nsocket.socket.connect = refused\n"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("material", reason="mkdocs-material is not installed (extra docs)")
    out = tmp_path_factory.mktemp("site")
    build = ["build", "--strict", "--quiet", "-f", "docs/site/mkdocs.yml", "-d", str(out)]
    code = f"{NO_NETWORK}from mkdocs.__main__ import cli\ncli({build!r})"
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=HOUSE, env=environment, capture_output=True, text=True, timeout=250
    )
    assert done.returncode == 0 and "WARNING" not in done.stderr, done.stdout + done.stderr
    return out


def text_of(page: Path) -> str:
    return re.sub(r"<[^>]+>", "", page.read_text(encoding="utf-8"))


@pytest.mark.timeout(280)
def test_every_component_is_in_the_reference_with_its_parameters(site: Path) -> None:
    pages = {
        kind: text_of(site / f"reference/{kind}.html") for kind in ("operators", "devices", "simulators", "outlets")
    }
    parts, _ = catalogue()
    for use, part in parts.items():
        if use.startswith("stream."):
            continue
        (kind,) = [kind for kind, text in pages.items() if f"\n{use}" in text or f">{use}" in text or f"{use}¶" in text]
        for name in schema(part).get("properties", {}):
            assert name in pages[kind], f"{use}: {name}"


@pytest.mark.nightly
def test_every_page_is_there_and_can_be_searched(site: Path) -> None:
    wanted = [p.relative_to(HOUSE / "docs").with_suffix(".html") for p in (HOUSE / "docs").rglob("*.md")]
    wanted += [Path("notebooks") / f"{p.stem}.html" for p in (HOUSE / "docs" / "notebooks").glob("*.ipynb")]
    assert [str(path) for path in wanted if not (site / path).is_file()] == []
    index = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))
    found = {entry["location"].partition("#")[0] for entry in index["docs"]}
    assert {
        "index.html",
        "use/batch.html",
        "reference/operators.html",
        "CODE_OF_CONDUCT.html",
    } <= found
    assert any("Lowpass" in entry["title"] for entry in index["docs"])
    assert not any(entry["location"].startswith("CHANGELOG") for entry in index["docs"]), (
        "the page is found, not its history"
    )


def test_commands_and_graphs_are_there(site: Path) -> None:
    commands, graphs = text_of(site / "reference" / "commands.html"), text_of(site / "reference" / "configs.html")
    assert all(f"kinegraph {name}" in commands for name in names())
    assert all(path.stem in graphs for path in (HOUSE / "configs").glob("*.yaml"))
    assert "BatchResults.to_pandas" in text_of(site / "reference" / "python.html")


def test_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    """Links may lead elsewhere; scripts, styles, fonts and pictures lie beside the pages."""
    source = r"<(?:script|img|iframe|source)[^>]*\ssrc=[\"']?https?:"
    style = r"<link[^>]*rel=[\"']?(?:stylesheet|preconnect)[^>]*https?:"
    loaded = re.compile(f"{source}|{style}")
    assert [
        str(page.relative_to(site)) for page in site.rglob("*.html") if loaded.search(page.read_text(encoding="utf-8"))
    ] == []


def test_the_first_level_leads_to_pages_for_users(site: Path) -> None:
    """Records of the laboratory are below; the home page holds pictures, and no source of a diagram."""
    home = (site / "index.html").read_text(encoding="utf-8")
    assert "flowchart" not in home and "mermaid" not in home
    pictures = re.findall(r'<img[^>]*src="([^"]+)"', home)
    assert len(pictures) >= 4 and all((site / name).is_file() for name in pictures)
    tabs = yaml_nav()
    assert [next(iter(tab)) for tab in tabs][:4] == ["Home", "Start", "Tutorials", "Use"]
    assert not any("lab/" in str(page) for tab in tabs for page in next(iter(tab.values())) if isinstance(page, str))


def yaml_nav() -> list[dict[str, Any]]:
    return list(YAML(typ="safe").load((HOUSE / "docs" / "site" / "mkdocs.yml").read_text(encoding="utf-8"))["nav"])
