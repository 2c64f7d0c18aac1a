"""Pages served to this computer only: what they answer, whom, and how they are opened."""

from __future__ import annotations

import os
import sys
import webbrowser
from urllib.parse import urlsplit

import tornado.web
from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets

LOCAL = frozenset({"127.0.0.1", "localhost", "::1"})
"""Names by which a browser may ask for us, on any port (ssh forwards them). Under another name it is a foreign page's
address that was pointed at this computer (DNS rebinding)."""

ADDRESS = "127.0.0.1"

MOST_ASKED = 10_000
"""Bytes of a request or a message: browsers have next to nothing to tell us."""


class Nothing(tornado.web.RequestHandler):
    """What answers browsers: pages of other sites get nothing."""

    def prepare(self) -> None:
        """Refuse who asks under another name, and what there is not."""
        try:
            name = urlsplit(f"//{self.request.host}").hostname
        except ValueError:
            name = None
        if name not in LOCAL:
            raise tornado.web.HTTPError(403)
        if type(self) is Nothing:
            raise tornado.web.HTTPError(404)

    def set_default_headers(self) -> None:
        """Nothing is kept, and no other page may embed it."""
        self.set_header("Cache-Control", "no-store")
        self.set_header("Cross-Origin-Resource-Policy", "same-origin")


def listen(application: tornado.web.Application, port: int = 0) -> tuple[HTTPServer, int]:
    """Listen to this computer only; returns the server and its port. It needs a running asyncio loop.

    Args:
        application: What answers.
        port: 0: any that is free.
    """
    sockets = bind_sockets(port, ADDRESS)
    server = HTTPServer(application, max_body_size=MOST_ASKED, max_header_size=MOST_ASKED)
    server.add_sockets(sockets)
    return server, int(sockets[0].getsockname()[1])


def show(url: str) -> None:
    """Open a page, where a browser can show itself: without a display, Python would start a text browser in this terminal."""
    names = ("BROWSER", "DISPLAY", "WAYLAND_DISPLAY")
    if not sys.platform.startswith("linux") or any(os.environ.get(name) for name in names):
        webbrowser.open(url)
