"""Show the 3D scene of a result folder in the browser, live.

The page is DIR/scene.html, served to this computer only, until Ctrl-C. When identify writes the folder anew, the browser
shows the new scene at once. Over ssh, forward the port that is printed, or copy scene.html and open it: it needs neither
server nor network.

Example:
    aridcal view results
"""

from __future__ import annotations

import argparse
import asyncio
import hashlib
import re
import sys
from importlib.resources import files
from pathlib import Path
from typing import Any

# Here and not where they are used: until a command runs, Ctrl-C ends it without a traceback, inside of imports as well.
import tornado.web
import umsgpack  # type: ignore[import-untyped]
from meshcat.servers.tree import find_node
from meshcat.servers.zmqserver import WebSocketHandler, ZMQWebSocketBridge
from tornado.httpserver import HTTPServer

from aridcal.command_line import CommandParser, command, command_parser
from aridcal.runs.local_pages import ADDRESS, MOST_ASKED, Nothing, listen, show
from aridcal.system.errors import OutputError
from aridcal.system.progress import Screen
from aridcal.system.reading.regular_files import RESULT, read_file
from aridcal.system.reading.user_names import path_argument

# Meshcat's server runs inside this process: its own way, a child in a session of its own, outlives a parent that is
# killed. Two things of it are closed: it would listen to the whole network, and take drawing commands from any program on
# this computer. The page is ours, with the panel that scene.html has; the scene travels to it as one meshcat object.

SCENE_PATH = "calibration"
"""Of the scene in meshcat's tree."""

LOOK_EVERY = 0.5
"""[s] between two looks at the folder."""

SCENE = re.compile(r'<script type="application/json" id="scene">(.*?)</script>', re.DOTALL)


class Viewer(ZMQWebSocketBridge):
    """Meshcat's server, which shows one scene and follows its file. It needs a running asyncio loop."""

    def __init__(self, scene: Path, port: int = 0) -> None:
        """Listen, to this computer only.

        Args:
            scene: The page's file.
            port: 0: any that is free.
        """
        self._file = scene
        self._seen: tuple[int, ...] = ()
        self._page, self._stamp = "", ""
        super().__init__(zmq_url=f"inproc://{id(self)}", port=port)  # a socket that no other process can reach
        self.fileserver_port = self.app.port
        self.look()

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{ADDRESS}:{self.fileserver_port}/"

    def make_app(self) -> _Application:
        """Meshcat's hook: what is served."""
        this = {"viewer": self}
        return _Application(
            [(r"/(?:scene\.html)?", _Page, this), ("/live", _Connection, {"bridge": self})],
            default_handler_class=Nothing,
            log_function=lambda handler: None,  # the terminal is the user's
            websocket_max_message_size=MOST_ASKED,
        )

    def look(self) -> None:
        """Send the scene to every browser if its file is another one; a file that is gone for a moment changes nothing."""
        try:
            status = self._file.stat()
            seen = (status.st_dev, status.st_ino, status.st_mtime_ns, status.st_size)
            if seen == self._seen:
                return
            self._page = read_file(self._file, OutputError, RESULT).decode("utf-8", "replace")
        except (OSError, OutputError):
            return
        self._seen = seen
        stamp = hashlib.sha256(self._page.encode()).hexdigest()[:16]
        if stamp != self._stamp:
            self._stamp = stamp
            found = SCENE.search(self._page)
            command = {"type": "set_object", "path": f"/{SCENE_PATH}", "object": found[1] if found else "null"}
            node = find_node(self.tree, [SCENE_PATH])
            node.object = umsgpack.packb(command)
            self.forward_to_websockets([b"set_object", SCENE_PATH.encode(), node.object])

    def page(self) -> str:
        """The file's page, with the script that keeps it up to date."""
        script = files("aridcal.pages.drawing").joinpath("assets/live.js").read_text("utf-8")
        live = f'<script data-stamp="{self._stamp}">{script}</script>'
        no_icon = '<link rel="icon" href="data:,">'  # browsers would ask for one
        before, end, after = self._page.replace("</head>", f"{no_icon}</head>", 1).rpartition("</body>")
        return f"{before}{live}{end}{after}" if end else f"{after}{live}"

    def send_scene(self, websocket: _Connection) -> None:
        """Meshcat's hook: tell a browser that has just come what it has not."""
        if websocket.get_query_argument("stamp", "") != self._stamp:
            super().send_scene(websocket)

    async def follow(self) -> None:
        """Show what the file becomes, for ever."""
        while True:
            await asyncio.sleep(LOOK_EVERY)
            self.look()

    def close(self) -> None:
        """Leave nothing open."""
        self.app.server.stop()
        for browser in list(self.websocket_pool):
            browser.close()
        self.zmq_stream.close(linger=0)


class _Application(tornado.web.Application):
    """A web application that listens to this computer only."""

    def listen(self, port: int, address: str | None = None, **settings: Any) -> HTTPServer:
        self.server, self.port = listen(self, port)
        return self.server


class _Page(Nothing):
    """The scene's page."""

    def initialize(self, viewer: Viewer) -> None:
        self.viewer = viewer

    def get(self) -> None:
        self.viewer.look()
        self.finish(self.viewer.page())


class _Connection(WebSocketHandler, Nothing):
    """Meshcat's connection to a browser, which listens only: ``check_origin`` of tornado refuses pages of other sites."""

    def open(self) -> None:
        self.bridge.websocket_pool.add(self)
        self.bridge.send_scene(self)

    def on_message(self, message: str | bytes) -> None:
        """Nothing that a browser says matters."""

    def on_close(self) -> None:
        self.bridge.websocket_pool.discard(self)


def scene_file(folder: Path) -> Path:
    """The scene of a result folder (or the file itself, where that is given).

    Raises:
        OutputError: there is no such result.
    """
    path = folder if folder.suffix == ".html" else folder / "scene.html"
    if not path.is_file():
        what = "is not a result folder: there is no scene.html in it" if folder.is_dir() else "does not exist"
        raise OutputError(f"{folder} {what}. Run `aridcal identify` first and give the folder that it wrote.")
    return path


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("view", __doc__)
    arguments.add_argument(
        "folder", type=path_argument, metavar="DIR", help="a result folder, as written by `aridcal identify`"
    )
    return arguments


async def _show(scene: Path) -> None:
    viewer = Viewer(scene)
    try:
        Screen().say(f"{viewer.url}  (follows the folder; Ctrl-C ends it)")
        show(viewer.url)
        await viewer.follow()
    finally:
        viewer.close()


def _main(arguments: argparse.Namespace) -> None:
    asyncio.run(_show(scene_file(arguments.folder)))


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
