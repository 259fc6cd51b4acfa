"""A real browser without a window, driven by the Chrome DevTools Protocol (chromedevtools.github.io/devtools-protocol)."""

import asyncio
import base64
import contextlib
import json
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
PATIENCE = 30.0
"""s that a busy machine may take."""


def chromium() -> str:
    """Its command; skips the test where there is none."""
    found = next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        pytest.skip(f"no browser here: none of {', '.join(NAMES)}")
    return found


class Browser:
    """One page. Every call waits for its answer."""

    def __init__(self, loop, connection):
        self._loop, self._connection, self._number = loop, connection, 0

    def call(self, method: str, **parameters) -> dict:
        """A command of the protocol; what it answers."""
        self._number += 1
        return self._loop.run_until_complete(asyncio.wait_for(self._call(self._number, method, parameters), PATIENCE))

    async def _call(self, number, method, parameters):
        await self._connection.write_message(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(await self._connection.read_message())
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return answer["result"]

    def open(self, address: str) -> None:
        """Go there, and wait until it is there."""
        self.call("Page.navigate", url=address)
        self.wait_for("location.href !== 'about:blank' && document.readyState === 'complete'")

    def evaluate(self, expression: str):
        """What an expression of JavaScript gives in the page."""
        told = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in told, told
        return told["result"].get("value")

    def wait_for(self, expression: str):
        """Until an expression of JavaScript is true; its value."""
        end = time.monotonic() + PATIENCE
        while not (value := self.evaluate(expression)):
            assert time.monotonic() < end, f"{expression} is still {value}: {self.evaluate('document.body.innerText')[:600]}"
            time.sleep(0.02)
        return value

    def window(self, width: int, height: int, dark: bool = False) -> None:
        """The page's size in CSS pixels, and its colours."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])

    def picture(self, path: Path, whole: bool = True) -> None:
        """A screenshot of the whole page, or of what the window shows of it."""
        told = self.call("Page.captureScreenshot", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(told["data"]))

    def press(self, selector: str) -> float:
        """The mouse on an element's middle, pressed and released; when that began [s, monotonic]."""
        box = f"(() => {{ const b = document.querySelector({selector!r}).getBoundingClientRect(); "
        x, y = self.evaluate(f"{box} return [b.x + b.width / 2, b.y + b.height / 2]; }})()")
        where = {"x": x, "y": y, "button": "left", "clickCount": 1}
        began = time.monotonic()
        self.call("Input.dispatchMouseEvent", type="mousePressed", **where)
        self.call("Input.dispatchMouseEvent", type="mouseReleased", **where)
        return began


@contextlib.contextmanager
def browser(folder: Path) -> Iterator[Browser]:
    """A browser that shows nothing yet; its files are in `folder`. Skips the test where there is none."""
    pytest.importorskip("tornado", reason="needs the extra 'watch': tornado")
    switches = ("headless", "no-sandbox", "disable-gpu", "remote-debugging-port=0", f"user-data-dir={folder}", "no-first-run")
    command = [chromium(), *(f"--{switch}" for switch in switches), "about:blank"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    loop, connection = asyncio.new_event_loop(), None
    try:
        port = _port(folder, process)
        connection = loop.run_until_complete(_connected(port))
        page = Browser(loop, connection)
        page.call("Page.enable")
        yield page
    finally:
        if connection is not None:  # of a test that fails too: whichever comes next would hear of it
            connection.close()
        process.terminate()
        process.wait()
        loop.run_until_complete(asyncio.sleep(0))
        loop.close()


def _port(folder: Path, process: subprocess.Popen) -> int:
    """Chromium writes it down."""
    file, end = folder / "DevToolsActivePort", time.monotonic() + PATIENCE
    while time.monotonic() < end and process.poll() is None:
        with contextlib.suppress(FileNotFoundError, ValueError, IndexError):
            return int(file.read_text().splitlines()[0])
        time.sleep(0.05)
    pytest.skip(f"the browser does not start here (exit code {process.poll()})")


async def _connected(port: int):
    """To the first page."""
    from tornado.httpclient import AsyncHTTPClient
    from tornado.websocket import websocket_connect

    for _ in range(100):
        with contextlib.suppress(OSError, StopIteration):
            targets = json.loads((await AsyncHTTPClient().fetch(f"http://127.0.0.1:{port}/json/list")).body)
            wanted = next(target["webSocketDebuggerUrl"] for target in targets if target["type"] == "page")
            return await websocket_connect(wanted, max_message_size=1 << 26)
        await asyncio.sleep(0.05)
    raise AssertionError("the browser does not answer")
