"""Headless Chromium for tests, without network but this computer's own: pages are opened, worked, measured and looked at.

It is driven over the DevTools protocol on two pipes (``--remote-debugging-pipe``), as Puppeteer does: messages are JSON,
each ended by a zero byte. Nothing needs to be installed for it but Chromium.
"""

from __future__ import annotations

import base64
import contextlib
import fcntl
import io
import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

PATIENCE = 60.0  # seconds for one answer
# WebGL in software; pages are drawn without it, since a plot of thousands of strokes takes it a minute.
FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu-sandbox", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--disable-gpu-rasterization", "--disable-background-networking",
    "--disable-component-update", "--no-first-run", "--hide-scrollbars",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    "--proxy-server=127.0.0.1:9", "--remote-debugging-pipe",
]  # fmt: skip


class Page:
    """An open page.

    Attributes:
        console: What the page said, errors that it did not catch among it.
        requests: What it asked for beside itself.
    """

    def __init__(self, browser: Browser, session: str) -> None:
        self._browser, self._session = browser, session
        self.console: list[str] = []
        self.requests: list[str] = []

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """One command of the protocol."""
        return self._browser.call(method, self._session, **parameters)

    def evaluate(self, script: str) -> Any:
        """The value of an expression, or of the promise that it gives."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait(self, condition: str) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + PATIENCE
        while not self.evaluate(f"Boolean({condition})"):
            assert time.monotonic() < end, f"never became true: {condition}"
            time.sleep(0.05)

    def resize(self, width: int, height: int) -> None:
        """Show the page in a window of that size."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def pixels(self) -> np.ndarray:
        """What is seen, shape (height, width, 3), after the next two frames were drawn."""
        self.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")
        picture = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(picture)).convert("RGB"), float)

    def heard(self, message: dict[str, Any]) -> None:
        """Note an event."""
        method, content = message["method"], message["params"]
        if method == "Runtime.consoleAPICalled":
            self.console.append(" ".join(str(a.get("value", a.get("description"))) for a in content["args"]))
        elif method == "Runtime.exceptionThrown":
            self.console.append(str(content["exceptionDetails"].get("exception", {}).get("description")))
        elif method == "Log.entryAdded":
            self.console.append(content["entry"]["text"])
        elif method == "Network.requestWillBeSent" and content["request"]["url"].partition(":")[0] not in (
            "data",
            "blob",
        ):
            self.requests.append(content["request"]["url"])


class Browser:
    """A running Chromium."""

    def __init__(self, program: str, profile: Path) -> None:
        # Chromium reads commands from descriptor 3 and answers on 4: first move ours out of the way.
        theirs_in, ours_out = os.pipe()
        ours_in, theirs_out = os.pipe()
        high = [fcntl.fcntl(fd, fcntl.F_DUPFD_CLOEXEC, 20) for fd in (theirs_in, theirs_out)]

        def settle() -> None:
            os.dup2(high[0], 3)
            os.dup2(high[1], 4)

        self._process = subprocess.Popen(
            [program, *FLAGS, f"--user-data-dir={profile}", "about:blank"],
            pass_fds=(3, 4), preexec_fn=settle, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        for fd in (theirs_in, theirs_out, *high):
            os.close(fd)
        self._out, self._in, self._rest, self._last = ours_out, ours_in, b"", 0
        self._pages: dict[str, Page] = {}

    def call(self, method: str, session: str | None = None, **parameters: Any) -> dict[str, Any]:
        """Send a command and wait for its answer; events that come before it are noted."""
        self._last += 1
        number = self._last
        message = {"id": number, "method": method, "params": parameters}
        os.write(self._out, json.dumps(message | ({"sessionId": session} if session else {})).encode() + b"\0")
        while True:
            answer = self._receive()
            if answer.get("id") == number:
                assert "error" not in answer, answer["error"]
                return dict(answer["result"])
            if "method" in answer and answer.get("sessionId") in self._pages:
                self._pages[answer["sessionId"]].heard(answer)

    def _receive(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._in], [], [], PATIENCE)
            assert ready, "Chromium does not answer"
            part = os.read(self._in, 1 << 20)
            assert part, "Chromium ended"
            self._rest += part
        message, _, self._rest = self._rest.partition(b"\0")
        return dict(json.loads(message))

    @contextlib.contextmanager
    def open(self, page: Path | str, width: int = 1280, height: int = 800) -> Iterator[Page]:
        """Open a file, or an address of this computer, in a window of that size, and wait until it is loaded."""
        url = page if isinstance(page, str) else page.as_uri()
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        opened = self._pages[session] = Page(self, session)
        for domain in ("Runtime", "Log", "Page", "Network"):
            opened.call(f"{domain}.enable")
        opened.resize(width, height)
        opened.call("Page.navigate", url=url)
        opened.wait("document.readyState === 'complete' && location.href !== 'about:blank'")
        opened.requests.remove(url)
        yield opened
        del self._pages[session]
        self.call("Target.closeTarget", targetId=target)

    def close(self) -> None:
        """End it."""
        with contextlib.suppress(AssertionError, OSError):
            self.call("Browser.close")
        os.close(self._out)
        os.close(self._in)
        try:
            self._process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def find() -> str:
    """The program; the test is skipped where there is none, or fails where one is required."""
    for name in ("chromium", "chromium-browser", "google-chrome"):
        if program := shutil.which(name):
            return program
    if os.environ.get("ARIDCAL_REQUIRE_CHROMIUM") == "1":
        pytest.fail("ARIDCAL_REQUIRE_CHROMIUM=1, but there is no Chromium")
    pytest.skip("no Chromium on this computer: install it to test pages in a browser")
