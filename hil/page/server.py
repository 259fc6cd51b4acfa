"""Serves the operator's page: `python -m hil.page.server SOCKET PORT`, with the other end of `operator_page`'s socket.

Each request must contain the token and name the loopback address. Its Host header must not be another name that resolves to
127.0.0.1 (DNS rebinding), and a page of another origin cannot press STOP. Standard error is the terminal's.
"""

import asyncio
import contextlib
import hmac
import json
import logging
import os
import re
import secrets
import signal
import socket
import sys
from importlib.resources import files

from plotly.offline import get_plotlyjs
from tornado.httpserver import HTTPServer
from tornado.iostream import StreamClosedError
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler

from hil.page.operator_page import STOP
from hil.page.story import Story

EVERY = 0.1
"""Interval between two readings of the log's memory, and between two messages to a browser, s."""
LINGER = 1.0
"""Time for which the end is still shown, s."""
HOSTS = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d{1,5})?")
"""Any port is allowed, because an SSH tunnel may have another one."""
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; connect-src 'self'; img-src data: blob:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Forbids the browser to fetch from anywhere else and to show the page in a frame; plotly sets styles."""
KINDS = {"html": "text/html", "css": "text/css", "js": "text/javascript"}


class Guarded(RequestHandler):
    """Refuses requests without the token or with another host name. `token`: of the address; `own`: further attributes."""

    def initialize(self, token: str, **own):
        self._token = token
        self.__dict__.update(own)

    def prepare(self):
        """Check a request before any method, also before one that does not exist."""
        if not HOSTS.fullmatch(self.request.headers.get("Host", "")):
            raise HTTPError(403)
        if not hmac.compare_digest(self.path_args[0].encode(), self._token.encode()):
            raise HTTPError(404)

    def set_default_headers(self):
        headers = {
            "Server": "vpp",
            "Content-Security-Policy": POLICY,
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "same-origin",  # the address holds the token
            "Cross-Origin-Resource-Policy": "same-origin",
            "Cross-Origin-Opener-Policy": "same-origin",
            "Cache-Control": "no-store",
        }
        for name, value in headers.items():
            self.set_header(name, value)

    def write_error(self, status_code, **_):
        self.finish(f"{status_code}\n")


class Files(Guarded):
    """The page and its files."""

    def get(self, _token, name):
        name = name or "page.html"
        if name not in self.texts:
            raise HTTPError(404)
        self.set_header("Content-Type", f"{KINDS[name.rpartition('.')[2]]}; charset=utf-8")
        self.write(self.texts[name])


class Stream(Guarded):
    """New data as server-sent events (HTML standard, 9.2), which go one way only."""

    async def get(self, _token):
        self.set_header("Content-Type", "text/event-stream")
        number, seen = -1, (0, 0, 0)
        with contextlib.suppress(StreamClosedError):
            while True:
                told = self.story.since(number, *seen)
                number, seen = told["number"], told.pop("seen")
                self.write(f"data: {json.dumps(told, allow_nan=False)}\n\n")
                await self.flush()  # a browser that does not read delays only itself
                await asyncio.sleep(EVERY)


class Stop(Guarded):
    """STOP: the same as Ctrl-C."""

    def post(self, _token):
        origin, site = (self.request.headers.get(name) for name in ("Origin", "Sec-Fetch-Site"))
        if origin not in (None, f"http://{self.request.headers['Host']}") or site not in (None, "same-origin"):
            raise HTTPError(403)
        if self.story.ended:
            raise HTTPError(409)
        self.press()
        self.write({"stop": True})


def application(story: Story, token: str, press) -> Application:
    """The web application of a story; `press`: function that STOP calls."""
    texts = {name: (files("hil.page") / name).read_text(encoding="utf-8") for name in ("page.html", "page.css", "page.js")}
    texts["plotly.js"] = get_plotlyjs()
    routes = [
        (r"/([^/]+)/stream", Stream, {"token": token, "story": story}),
        (r"/([^/]+)/stop", Stop, {"token": token, "story": story, "press": press}),
        (r"/([^/]+)/(.*)", Files, {"token": token, "texts": texts}),
        (r"/(.*)", Guarded, {"token": token}),
    ]
    return Application(routes, log_function=lambda handler: None)


def heard(end: socket.socket, story: Story) -> bool:
    """Take the messages of the loop's process; False once its end is closed."""
    with contextlib.suppress(BlockingIOError):
        while True:
            data, descriptors, _, _ = socket.recv_fds(end, 1 << 20, 1)
            if not data:
                story.ended = story.ended or "the loop's process is gone without a word"
                return False
            story.tell(json.loads(data), descriptors)
            for descriptor in descriptors:
                os.close(descriptor)  # the memory stays mapped
    return True


async def serve(end: socket.socket, port: int) -> None:
    """Wait until the loop's process has said goodbye, or has ended."""
    story, token, loop = Story(), secrets.token_urlsafe(24), os.pidfd_open(os.getppid())

    def press() -> None:
        """Send the byte before the signal, since the signal's handler looks for it."""
        with contextlib.suppress(OSError):
            end.send(STOP)
        with contextlib.suppress(ProcessLookupError):
            signal.pidfd_send_signal(loop, signal.SIGINT)

    try:
        listening = bind_sockets(port, "127.0.0.1")
    except OSError as error:
        end.send(json.dumps({"refused": f"port {port}, {os.strerror(error.errno).lower()}"}).encode())
        return
    server = HTTPServer(application(story, token, press), max_header_size=1 << 14, max_body_size=1 << 10)
    server.add_sockets(listening)
    end.setblocking(False)
    end.send(json.dumps({"address": f"http://127.0.0.1:{listening[0].getsockname()[1]}/{token}/"}).encode())
    while heard(end, story):
        story.look()
        await asyncio.sleep(EVERY)
    await asyncio.sleep(LINGER)


def main() -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN if number != signal.SIGTERM else signal.SIG_DFL)
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w") as file:
        file.write("900")  # if memory is short, the system kills the page before the rig
    logging.getLogger("tornado").addHandler(logging.NullHandler())
    logging.getLogger("tornado").propagate = False  # refused requests are not logged
    asyncio.run(serve(socket.socket(fileno=int(sys.argv[1])), int(sys.argv[2])))


if __name__ == "__main__":
    main()
