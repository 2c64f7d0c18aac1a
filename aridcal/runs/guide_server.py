"""The live page of a campaign that is being measured: served in a thread of its own, to this computer only."""

from __future__ import annotations

import asyncio
import json
import secrets
import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import tornado.web

from aridcal.jobs.guide.events import Alarm, Event, Known, Next, RowRead, Stop
from aridcal.pages.guide_page import guide_page
from aridcal.runs.guided_campaign import REJECT, STOP, Incoming
from aridcal.runs.local_pages import ADDRESS, Nothing, listen

LAST_ROWS, LAST_ALARMS = 30, 20
"""Rows and alarms that the page lists: more than anybody reads beside a robot."""

MOST_POINTS = 2000
"""Points of the curve of what is known; of eight hours of rows the last ones."""


@dataclass
class Board:
    """What the page shows; it is changed by :meth:`note`, and read by the server's thread.

    Attributes:
        title: Of the campaign.
        tolerance: [m]; None where there is none.
        table: The file that is followed.
        units: Of the joints' columns.
        measured: What is counted: rows or images.
        subject: What is known.
    """

    title: str
    tolerance: float | None
    table: str
    units: dict[str, str] = field(default_factory=dict)
    measured: str = "rows"
    subject: str = "the target"
    rows: deque[dict[str, Any]] = field(default_factory=lambda: deque(maxlen=LAST_ROWS))
    alarms: deque[dict[str, Any]] = field(default_factory=lambda: deque(maxlen=LAST_ALARMS))
    known: deque[dict[str, Any]] = field(default_factory=lambda: deque(maxlen=MOST_POINTS))
    last: dict[str, Any] | None = None
    following: dict[str, Any] | None = None
    stop: dict[str, Any] | None = None
    report: str = ""
    number: int = 0
    text: str = "{}"

    def note(self, events: Iterable[Event], report: str = "") -> None:
        """Show more events, and where the report is."""
        for event in events:
            match event:
                case RowRead():
                    self.rows.append(event.document())
                    if self.last is None or event.row >= self.last["row"]:  # else an earlier one is judged again
                        self.last = event.document()
                case Alarm():
                    self.alarms.append({**event.document(), "after": self.last and self.last["row"]})
                case Known():
                    self.known.append(event.document())
                case Next():
                    self.following = event.document()
                case Stop():
                    self.stop, self.following = event.document(), None
        self.report = report or self.report
        self.number += 1
        self.text = json.dumps(
            {
                "number": self.number,
                "tolerance_mm": None if self.tolerance is None else 1e3 * self.tolerance,
                "table": self.table,
                "units": self.units,
                "measured": self.measured,
                "subject": self.subject,
                "rows": list(self.rows),
                "last": self.last,
                "alarms": list(self.alarms),
                "known": list(self.known),
                "next": self.following,
                "stop": self.stop,
                "report": self.report,
            },
            allow_nan=False,
        )


class GuideServer:
    """The page's server. It ends with the program."""

    def __init__(self, board: Board, incoming: Incoming) -> None:
        """Begin to serve.

        Args:
            board: What is shown.
            incoming: Takes what the user says on the page.
        """
        self.key = secrets.token_urlsafe(16)
        self.board, self.incoming = board, incoming
        self.port = 0
        ready = threading.Event()
        threading.Thread(target=lambda: asyncio.run(self._serve(ready)), daemon=True).start()
        ready.wait()

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{ADDRESS}:{self.port}/"

    async def _serve(self, ready: threading.Event) -> None:
        this = {"server": self}
        application = tornado.web.Application(
            [(r"/", _Page, this), (r"/state", _State, this), (r"/say", _Say, this)],
            default_handler_class=Nothing,
            log_function=lambda handler: None,  # the terminal is the user's
        )
        try:
            _, self.port = listen(application)
        finally:
            ready.set()
        await asyncio.Event().wait()


class _Handler(Nothing):
    def initialize(self, server: GuideServer) -> None:
        self.server = server


class _Page(_Handler):
    """The page itself."""

    def get(self) -> None:
        self.finish(str(guide_page(self.server.board.title, self.server.key)))


class _State(_Handler):
    """What it shows: nothing where the browser has that already."""

    def get(self) -> None:
        if self.get_query_argument("have", "") == str(self.server.board.number):
            self.set_status(204)
            return
        self.set_header("Content-Type", "application/json")
        self.finish(self.server.board.text)


class _Say(_Handler):
    """What the user says on it. The key stands in the page, which no other site can read."""

    def post(self) -> None:
        if not secrets.compare_digest(self.request.headers.get("X-Key", ""), self.server.key):
            raise tornado.web.HTTPError(403)
        word = self.request.body.decode("utf-8", "replace")
        if word not in (REJECT, STOP):
            raise tornado.web.HTTPError(400)
        self.server.incoming.lines.put(word)
        self.set_status(204)
