"""A real Chromium that looks at a page that lives: what it holds, what it says in its console, keys, and pictures of it."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

from websockets.sync.client import ClientConnection, connect

from tests.support.browser import CHROMIUM, QUIET

GRAPHICS = ["use-gl=angle", "use-angle=swiftshader", "enable-unsafe-swiftshader", "disable-accelerated-2d-canvas"]
FLAGS = [
    f"--{flag}" for flag in ("headless", "no-sandbox", *QUIET[1:], *GRAPHICS, "disable-sync", "remote-debugging-port=0")
]
PATIENCE_S = 100.0
GONE = re.compile(
    r"WebSocket connection to '[^']*' failed: .*(ERR_CONNECTION_|ERR_EMPTY_RESPONSE|before receiving a handshake)"
)
"""What the browser itself says while a page looks for a server that has ended, as every session does before its page is closed."""
CODES = {"Tab": 9, "Escape": 27, "ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40}
"""What a key needs beside its name to do what the browser itself does at it."""


class NavigatedAway(Exception):
    """The page that was asked is gone, and another one comes."""


class LiveBrowser:
    """One tab. `complaints` are the errors of the page that is open, whatever the console would show in red; `unmended` those of all pages
    that were; `fetched` the addresses that it asked for, other than the one it had to open."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket, self._number = socket, 0
        self.complaints: list[str] = []
        self.unmended: list[str] = []
        self.fetched: list[str] = []
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.ask(f"{domain}.enable")

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the DevTools protocol."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            record = json.loads(self._socket.recv(timeout=PATIENCE_S))
            self._note(record)
            if record.get("id") == self._number:
                if "navigated" in record.get("error", {}).get("message", ""):
                    raise NavigatedAway
                assert "error" not in record, record["error"]
                return dict(record["result"])

    def _note(self, facts: dict[str, Any]) -> None:
        given = facts.get("params", {})
        match facts.get("method"):
            case "Runtime.exceptionThrown":
                self._complain(json.dumps(given["exceptionDetails"])[:2000])
            case "Runtime.consoleAPICalled" if given["type"] in ("error", "assert"):
                self._complain(json.dumps(given["args"])[:2000])
            case "Network.requestWillBeSent":
                self.fetched.append(given["request"]["url"])
            case "Network.webSocketCreated":
                self.fetched.append(given["url"])
            case "Log.entryAdded" if given["entry"]["level"] == "error":
                self._complain(given["entry"]["text"] + " " + given["entry"].get("url", ""))

    def _complain(self, text: str) -> None:
        self.complaints.append(text)
        if not GONE.search(text):
            self.unmended.append(text)

    def open(self, url: str, width: int = 1280, height: int = 4000) -> Self:
        self.size(width, height)
        self.ask("Page.navigate", url="about:blank")
        self.wait("location.href === 'about:blank'")  # a page that was open before complains no more
        self.complaints.clear()
        self.fetched.clear()
        self.ask("Page.navigate", url=url)
        self.wait("document.readyState === 'complete'")
        return self

    def size(self, width: int, height: int) -> None:
        self.ask("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def value(self, script: str) -> Any:
        """What an expression gives."""
        reported = self.ask("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in reported, reported
        return reported["result"].get("value")

    def _value_once_there(self, script: str) -> Any:
        """What an expression gives; None while the page goes to another one, as from an address with a token, and has no body yet."""
        try:
            return self.value(f"document.body && ({script})")
        except NavigatedAway:
            return None

    def wait(self, script: str, seconds: float = PATIENCE_S) -> Any:
        """Wait until an expression gives something true."""
        end = time.monotonic() + seconds
        while not (found := self._value_once_there(script)):
            assert time.monotonic() < end, (
                script,
                self.value("document.body.innerText.slice(0, 3000)"),
                self.complaints,
            )
            time.sleep(0.05)
        return found

    def type(self, text: str) -> None:
        """Type it, wherever the focus is; "\\r" is Enter."""
        for key in text:
            named = {"key": "Enter", "code": "Enter", "windowsVirtualKeyCode": 13} if key == "\r" else {"key": key}
            self.ask("Input.dispatchKeyEvent", type="keyDown", text=key, **named)
            self.ask("Input.dispatchKeyEvent", type="keyUp", **named)

    def press(self, key: str, times: int = 1, *, shift: bool = False) -> None:
        """Press a key that has a name ("ArrowRight"), with Shift if asked for."""
        code = {"key": key, "code": key, "windowsVirtualKeyCode": CODES.get(key, 0), "modifiers": 8 if shift else 0}
        for _ in range(times):
            for kind in ("rawKeyDown", "keyUp"):
                self.ask("Input.dispatchKeyEvent", type=kind, **code)

    def drag(self, selector: str, begin: float, end: float) -> None:
        """Press the mouse within an element, at a share of its width, and let go of it at another."""
        box = self.value(
            f"(r => [r.x, r.y, r.width, r.height])(document.querySelector({selector!r}).getBoundingClientRect())"
        )
        y = box[1] + box[3] / 2
        for kind, share in (("mousePressed", begin), ("mouseMoved", end), ("mouseReleased", end)):
            at = {"x": box[0] + share * box[2], "y": y, "button": "left", "buttons": 1, "clickCount": 1}
            self.ask("Input.dispatchMouseEvent", type=kind, **at)

    def colours(self, selector: str) -> int:
        """How many colours a canvas holds: 1 is an empty one."""
        return int(self.value(
            f"""(canvas => {{ const copy = document.createElement('canvas'); copy.width = canvas.width; copy.height = canvas.height;
            const pen = copy.getContext('2d'); pen.drawImage(canvas, 0, 0);
            return new Set(new Uint32Array(pen.getImageData(0, 0, copy.width, copy.height).data.buffer)).size;
            }})(document.querySelector({selector!r}))"""
        ))  # fmt: skip

    def like(self, selector: str, colour: str, within: float = 40.0) -> list[list[int]]:
        """Where a canvas holds a colour ("#rrggbb", or the name of one of the page's own): [x, y] of its pixels."""
        return list(self.value(
            f"""(canvas => {{ const name = {colour!r};
            const css = name[0] === '#' ? name : getComputedStyle(document.documentElement).getPropertyValue('--' + name).trim();
            const wanted = [1, 3, 5].map(i => parseInt(css.slice(i, i + 2), 16));
            const copy = document.createElement('canvas'); copy.width = canvas.width; copy.height = canvas.height;
            const pen = copy.getContext('2d'); pen.drawImage(canvas, 0, 0);
            const {{ data }} = pen.getImageData(0, 0, copy.width, copy.height), found = [];
            for (let i = 0; i < data.length; i += 4)
              if (data[i + 3] > 80 && Math.hypot(...wanted.map((w, k) => w - data[i + k])) < {within})
                found.push([(i / 4) % copy.width, Math.floor(i / 4 / copy.width)]);
            return found; }})(document.querySelector({selector!r}))"""
        ))  # fmt: skip

    def picture(self, path: Path, selector: str = "") -> None:
        """A screenshot, of one element where one is named. With KINEGRAPH_PICTURES=FOLDER, as .ci/run sets it, it is kept there, too."""
        more: dict[str, Any] = {}
        if selector:
            box = f"(r => [r.x + scrollX, r.y + scrollY, r.width, r.height])(document.querySelector({selector!r}).getBoundingClientRect())"
            more["clip"] = {**dict(zip(("x", "y", "width", "height"), self.value(box), strict=True)), "scale": 1}
        path.write_bytes(base64.b64decode(self.ask("Page.captureScreenshot", format="png", **more)["data"]))
        if kept := os.environ.get("KINEGRAPH_PICTURES"):
            Path(kept).mkdir(parents=True, exist_ok=True)
            shutil.copy(path, kept)


@contextmanager
def live_browser(folder: Path, allowed: str = "") -> Iterator[LiveBrowser]:
    """A browser that ends with the test, and with an AssertionError if any page in it has written an error to the console; `allowed`: a
    pattern of those that a test provokes."""
    command = [str(CHROMIUM), *FLAGS, f"--user-data-dir={folder / 'profile'}", "about:blank"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stderr
            port = next(found[1] for line in process.stderr if (found := re.search(r"ws://[^/]*:(\d+)/", line)))
            with connect(
                f"ws://127.0.0.1:{port}{_tab(port)}", max_size=None, compression=None, ping_interval=None
            ) as socket:
                browser = LiveBrowser(socket)
                yield browser
                browser.value("1")  # its output until now has arrived
                unmended = [text for text in browser.unmended if not (allowed and re.search(allowed, text))]
                assert not unmended, unmended
        finally:
            process.terminate()
            process.communicate(timeout=100)


def _tab(port: str) -> str:
    from urllib.request import urlopen

    def found() -> list[str]:
        with urlopen(f"http://127.0.0.1:{port}/json/list", timeout=PATIENCE_S) as output:
            return [tab["webSocketDebuggerUrl"] for tab in json.load(output) if tab["type"] == "page"]

    end = time.monotonic() + PATIENCE_S
    while not (tabs := found()):
        assert time.monotonic() < end
        time.sleep(0.05)
    return "/" + tabs[0].split("/", 3)[3]
