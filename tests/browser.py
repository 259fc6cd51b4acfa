"""A headless Chromium that shows pages as a reader sees them: at any width, light or dark.

It is controlled through its debugging pipe, by the protocol of chromedevtools.github.io/devtools-protocol.

`python -m tests.browser PAGE.html ... -o DIR` saves a picture of each page: light, dark, and on a phone.
"""

import argparse
import base64
import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

LOOKS = {"light": (1100, False), "dark": (1100, True), "phone": (400, False)}
"""(width in CSS pixels, dark) of the pictures."""

PATIENCE = 30.0
"""Longest time [s] that a page may take on a busy machine."""

_FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--remote-debugging-pipe", "--no-first-run")


@contextlib.contextmanager
def browser(profile: Path) -> Iterator["Browser"]:
    """A browser with an empty tab; its files are in `profile`. Skips the test if there is no browser."""
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine: pages are not rendered")
    opened = Browser(profile)
    try:
        yield opened
    finally:
        opened.close()


class Browser:
    """One tab. Messages are JSON, ended by a NUL, on descriptors 3 (to the browser) and 4 (from it)."""

    def __init__(self, profile: Path):
        to_browser, self._out = os.pipe()
        self._in, from_browser = os.pipe()

        def place() -> None:  # both first out of the way of 3 and 4
            reading, writing = os.dup(to_browser), os.dup(from_browser)
            os.dup2(reading, 3)
            os.dup2(writing, 4)

        self._process = subprocess.Popen(
            [CHROMIUM, *_FLAGS, f"--user-data-dir={profile}", "about:blank"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            preexec_fn=place,  # noqa: PLW1509 (two system calls, no lock)
            close_fds=False,
        )
        os.close(to_browser)
        os.close(from_browser)
        self._rest, self._count, self._session = b"", 0, None
        self.problems: list[str] = []
        targets = self.ask("Target.getTargets")["targetInfos"]
        page = next(target for target in targets if target["type"] == "page")
        self._session = self.ask("Target.attachToTarget", targetId=page["targetId"], flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.ask(f"{domain}.enable")

    def ask(self, method: str, **parameters) -> dict:
        """The answer to a command of the DevTools protocol."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        answer = self._until(lambda told: told.get("id") == self._count)
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']}")
        return answer["result"]

    def window(self, width: int, height: int, dark: bool = False) -> None:
        """Set the page's size in CSS pixels, and its colours."""
        self.ask("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600)
        self.scheme(dark)

    def open(self, address: str) -> None:
        """Open an address, wait until it is loaded, and collect errors of its scripts and refusals in `problems`."""
        self.problems = []
        self.ask("Page.navigate", url=address)
        self._until(lambda told: told.get("method") == "Page.loadEventFired")

    def show(self, page: Path, width: int, height: int, dark: bool) -> None:
        """Open the page of a file."""
        self.window(width, height, dark)
        self.open(page.resolve().as_uri())
        self.run("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def scheme(self, dark: bool) -> None:
        """Light or dark, as the reader's system prefers."""
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.ask("Emulation.setEmulatedMedia", features=[scheme])

    def drag(self, start: float, end: float, y: float) -> None:
        """Press the mouse at one place of the window, move it and release it at another, all in pixels."""
        for kind, x in (("mousePressed", start), ("mouseMoved", end), ("mouseReleased", end), ("mouseMoved", end - 5)):
            button = "none" if x == end - 5 else "left"
            self.ask(
                "Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, buttons=int(button == "left"), clickCount=1
            )

    def run(self, script: str):
        """The value of an expression in the page; a promise is awaited."""
        answer = self.ask("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(answer["exceptionDetails"]["exception"].get("description"))
        return answer["result"].get("value")

    def wait_for(self, expression: str):
        """Wait until an expression of JavaScript is true; its value."""
        end = time.monotonic() + PATIENCE
        while not (value := self.run(expression)):
            assert time.monotonic() < end, f"{expression} is still {value}: {self.run('document.body.innerText')[:600]}"
            time.sleep(0.02)
        return value

    def press(self, selector: str) -> float:
        """Click the middle of an element; the time at which the click began [s, monotonic]."""
        box = f"(() => {{ const b = document.querySelector({selector!r}).getBoundingClientRect(); "
        x, y = self.run(f"{box} return [b.x + b.width / 2, b.y + b.height / 2]; }})()")
        began = time.monotonic()
        for kind in ("mousePressed", "mouseReleased"):
            self.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
        return began

    def picture(self) -> bytes:
        """The whole page as PNG."""
        return base64.b64decode(self.ask("Page.captureScreenshot", captureBeyondViewport=True)["data"])

    def close(self) -> None:
        os.close(self._out)  # it ends when nobody speaks to it
        self._process.wait()
        os.close(self._in)

    def _until(self, wanted: Callable[[dict], bool]) -> dict:
        while True:
            while b"\0" not in self._rest:
                read = os.read(self._in, 1 << 16)
                if not read:
                    raise RuntimeError("the browser has ended")
                self._rest += read
            message, self._rest = self._rest.split(b"\0", 1)
            told = json.loads(message)
            if told.get("method") == "Runtime.exceptionThrown":
                details = told["params"]["exceptionDetails"]
                self.problems.append(details.get("exception", {}).get("description", details["text"]))
            if told.get("method") == "Log.entryAdded":
                self.problems.append(told["params"]["entry"]["text"])
            if wanted(told):
                return told


def main() -> None:
    """Save pictures of pages; exit code 1 if a page's scripts or the browser report a problem."""
    parser = argparse.ArgumentParser(prog="python -m tests.browser", description="Pictures of pages: light, dark, phone.")
    parser.add_argument("pages", nargs="+", type=Path, metavar="PAGE.html")
    parser.add_argument("-o", "--output", type=Path, default=Path("pictures"), metavar="DIR")
    options = parser.parse_args()
    if CHROMIUM is None:
        parser.error("no Chromium on this machine")
    if missing := [str(page) for page in options.pages if not page.is_file()]:
        parser.error(f"no such file: {', '.join(missing)}")
    options.output.mkdir(parents=True, exist_ok=True)
    failed = False
    with tempfile.TemporaryDirectory() as profile, browser(Path(profile)) as tab:
        for page in options.pages:
            for look, (width, dark) in LOOKS.items():
                tab.show(page, width, 900, dark)
                path = options.output / f"{page.resolve().parent.name}_{page.stem}_{look}.png"
                path.write_bytes(tab.picture())
                print(f"{path}: {'; '.join(tab.problems) or 'no problem'}")
                failed |= bool(tab.problems)
    sys.exit(int(failed))


if __name__ == "__main__":
    main()
