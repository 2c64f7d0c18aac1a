"""Work for processes that are to die of it; alone in its module, which a worker imports anew after each death."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path


def slow_or_deadly(task: tuple[str, str]) -> str:
    """Work for workers: marks that it began, and on the first attempt dies, or holds its worker for ever, where told to."""
    folder, name = task
    mark = Path(folder) / name
    times = len(mark.read_text()) if mark.exists() else 0
    mark.write_text("x" * (times + 1))
    if name.startswith("dies") and times == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    if name.startswith("holds") and times == 0:
        threading.Event().wait()
    if name.startswith("raises"):
        raise ValueError("on purpose")
    return name.upper()
