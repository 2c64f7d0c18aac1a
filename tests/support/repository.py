"""Where the repository lies: robots, campaigns and documents that tests read beside the package."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
