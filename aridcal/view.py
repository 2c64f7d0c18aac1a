"""Show the 3D scene of a result folder in the browser.

The page is DIR/scene.html, served to this computer only, until Ctrl-C; reload it after another run of identify. Over ssh,
forward the port that is printed, or copy scene.html and open it: it needs neither server nor network.

Example:
    aridcal view results
"""

from __future__ import annotations

import os
import sys
import webbrowser
from collections.abc import Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from rich.console import Console

from aridcal.command_line import CommandParser, command_parser, run
from aridcal.errors import OutputError
from aridcal.reading.names import path_argument

# Meshcat's own server is left out on purpose: it is a second process in a session of its own, which outlives a killed
# parent, and its page knows nothing of the panel. Here the command itself is the server, so nothing can be left behind.


def serve(scene: Path, port: int = 0) -> ThreadingHTTPServer:
    """Serve one page, and nothing else, to this computer only.

    Args:
        scene: The file; read anew at each request.
        port: 0: any that is free.

    Returns:
        The server, listening but not yet answering: call ``serve_forever``.
    """

    class Page(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            try:
                body = scene.read_bytes() if self.path.partition("?")[0] in ("/", "/scene.html") else None
            except OSError:
                body = None
            self.send_response(200 if body is not None else 404)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(body or b"")))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(body or b"")

        def log_message(self, format: str, *args: object) -> None:
            """Say nothing: the terminal is the user's."""

    return ThreadingHTTPServer(("127.0.0.1", port), Page)


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


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    arguments = parser().parse_args(argv)
    return run(lambda: _main(arguments.folder))


def _main(folder: Path) -> None:
    with serve(scene_file(folder)) as server:
        url = f"http://127.0.0.1:{server.server_port}/"
        Console().print(f"{url}  (Ctrl-C ends it)", soft_wrap=True, highlight=False, markup=False)
        if _has_screen():
            webbrowser.open(url)
        server.serve_forever()


def _has_screen() -> bool:
    """Whether a browser can show itself: without a display, Python would start a text browser in this terminal."""
    names = ("BROWSER", "DISPLAY", "WAYLAND_DISPLAY")
    return not sys.platform.startswith("linux") or any(os.environ.get(name) for name in names)


if __name__ == "__main__":
    sys.exit(main())
