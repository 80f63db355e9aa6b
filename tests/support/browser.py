"""A real browser for pages that people read: what it makes of them, at a phone's width and on paper."""

from __future__ import annotations

import re
import shutil
import subprocess
from html import escape
from pathlib import Path

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
QUIET = ["disable-gpu", "disable-quic", "no-first-run", "disable-background-networking", "disable-component-update"]
FLAGS = [f"--{flag}" for flag in ("headless", "no-sandbox", *QUIET, "disable-sync", "no-pdf-header-footer")]
PHONE = """<!doctype html><title>?</title><iframe width=375 height=800 srcdoc="%s"
onload="document.title = this.contentDocument.documentElement.scrollWidth + ' of ' + this.contentWindow.innerWidth"></iframe>"""

needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no chromium here (Debian: apt-get install chromium)")


class Browser:
    """`folder` is where it may write."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._command = [str(CHROMIUM), *FLAGS, f"--user-data-dir={folder / 'profile'}"]

    def _ask(self, page: Path, *what: str) -> bytes:
        command = [*self._command, *what, page.as_uri()]
        return subprocess.run(command, check=True, capture_output=True, timeout=120).stdout

    def shown(self, page: Path) -> str:
        """The page as it stands when its scripts have run."""
        return self._ask(page, "--dump-dom").decode()

    def fits_a_phone(self, page: Path) -> bool:
        """Whether nothing sticks out to the right at 375 pixels."""
        phone = self._folder / "phone.html"
        phone.write_text(PHONE % escape(page.read_text()))
        reported = re.search(
            rb"<title>(\d+) of (\d+)</title>", self._ask(phone, "--dump-dom", "--virtual-time-budget=10000")
        )
        assert reported, "the page did not load"
        return int(reported[1]) <= int(reported[2])

    def sheets(self, page: Path) -> int:
        """How many sheets of paper it takes."""
        printed = self._folder / "page.pdf"
        self._ask(page, f"--print-to-pdf={printed}")
        return len(re.findall(rb"/Type\s*/Page\b", printed.read_bytes()))
