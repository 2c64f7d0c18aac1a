"""What `mkdocs build` adds to the pages of this folder: the start page, how to contribute, commands' help, notebooks, run."""

from __future__ import annotations

import base64
import importlib
import itertools
import os
import posixpath
import re
import textwrap
from pathlib import Path

import nbformat
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.plugins import get_plugin_logger
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

from aridcal.__main__ import COMMANDS, USAGE

TOP = Path(__file__).resolve().parents[1]
RUN = os.environ.get("ARIDCAL_DOCS_RUN", "1") == "1"
"""Whether notebooks are run; `ARIDCAL_DOCS_RUN=0` shows them as they are, which is quick."""

OF_THE_TOP = {"index.md": "README.md", "contributing.md": "CONTRIBUTING.md"}
"""Pages of the site that are files of the repository's top folder."""

FROM_THE_TOP = {source: page for page, source in OF_THE_TOP.items()}

WIDTH = 80
"""Characters of a line of code that a page shows beside its two columns at 1,280 pixels."""

COLOUR = re.compile(r"\x1b\[[\d;]*m")
log = get_plugin_logger("aridcal")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made from something else."""
    made = {page: (TOP / source).read_text("utf-8") for page, source in OF_THE_TOP.items()}
    made["commands.md"] = commands_page()
    for path in sorted((TOP / "notebooks").glob("*.ipynb")):
        made |= notebook_page(path)
    for name, content in made.items():
        files.append(File.generated(config, name, content=content))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links are those of the repository; of one that leads out of the site the text remains."""
    own = page.file.src_uri
    above = posixpath.dirname(own)
    folder = "" if own in OF_THE_TOP else "notebooks" if above == "notebooks" else posixpath.join("docs", above)

    def link(match: re.Match[str]) -> str:
        text, target, anchor = match.groups("")
        if not target or "://" in target:
            return match[0]
        path = posixpath.normpath(posixpath.join(folder, target)).removeprefix("docs/")
        path = re.sub(r"^(notebooks/.*)\.ipynb$", r"\1.md", FROM_THE_TOP.get(path, path))
        if files.get_file_from_path(path) is None:
            return text.strip("![]")
        return f"{text}({posixpath.relpath(path, posixpath.dirname(own) or '.')}{anchor})"

    return re.sub(r"(!?\[[^\]]*\])\(([^)#\s]*)(#[^)]*)?\)", link, markdown)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Cells of tables carry their headings: on a phone each row is shown as a card (tables.css)."""

    def labelled(table: re.Match[str]) -> str:
        heads = [re.sub(r"<[^>]*>", "", head) for head in re.findall(r"<th[^>]*>(.*?)</th>", table[0], re.DOTALL)]
        labels = itertools.cycle(heads if len(heads) > 2 else ["", ""])
        marked = re.sub(r"<td", lambda _: f'<td data-label="{next(labels)}"', table[0])
        return marked.replace("<table>", "<table data-cards>", 1)

    return re.sub(r"<table>.*?</table>", labelled, html, flags=re.DOTALL)


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """The theme loads one script from elsewhere, for the search on file://; it is shipped with the site instead."""
    here = posixpath.relpath("javascripts/iframe-worker.js", posixpath.dirname(page.file.src_uri) or ".")
    return output.replace("https://unpkg.com/iframe-worker/shim", here)


def on_post_template(output: str, template_name: str, config: MkDocsConfig) -> str:
    """The page for what is not found loads it too; it is only ever seen from a server."""
    return output.replace("https://unpkg.com/iframe-worker/shim", "/javascripts/iframe-worker.js")


def commands_page() -> str:
    """Each command's own help."""
    os.environ["COLUMNS"] = str(WIDTH + 2)  # argparse leaves two columns free
    parts = [
        "# Commands",
        f"```text\n{_narrow(USAGE)}\n```",
        "Exit status: 0 done, 1 a bug, 2 bad input or use, 3 done and the answer is no, 130 after Ctrl-C, 143 after SIGTERM.",
    ]
    for command in COMMANDS:
        own = importlib.import_module(f"aridcal.{command}").parser()
        parts.append(f"## aridcal {command}\n\n```text\n{_narrow(own.format_help().rstrip())}\n```")
    return "\n\n".join(parts)


def _narrow(text: str) -> str:
    """Text with its paragraphs filled anew, and the second column of its lists under itself."""
    paragraphs = []
    for paragraph in text.split("\n\n"):
        lines = paragraph.splitlines()
        if len(lines[-1:]) and not any(line.startswith(" ") for line in lines):
            lines = textwrap.wrap(paragraph, WIDTH)
        for k, line in enumerate(lines):
            column = re.match(r"\s*(?:\S+\s{2,})?", line)
            behind = " " * (column.end() if column else 0)
            lines[k] = "\n".join(textwrap.wrap(line, WIDTH, subsequent_indent=behind, break_on_hyphens=False))
        paragraphs.append("\n".join(lines))
    return "\n\n".join(paragraphs)


def notebook_page(path: Path) -> dict[str, str | bytes]:
    """A notebook as a page with its pictures."""
    notebook = nbformat.read(path, as_version=4)
    note = "not run for this page"
    if RUN:
        where = {"metadata": {"path": str(path.parent)}}
        try:
            NotebookClient(notebook, timeout=600, kernel_name="python3", resources=where).execute()
            note = "run when this page was made"
        except CellExecutionError as error:
            note = f"not run to its end: {COLOUR.sub('', str(error)).strip().splitlines()[-1]}"
            log.info(f"{path.name}: {note}")
    made: dict[str, str | bytes] = {}
    parts = []
    for cell in notebook.cells:
        parts.append(cell.source if cell.cell_type == "markdown" else _fenced(cell.source, "python"))
        said = ""
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            said += output.get("text", "") or ("" if "image/png" in data else data.get("text/plain", ""))
            if "image/png" in data:
                name = f"{path.stem}-{len(made) + 1}.png"
                made[f"notebooks/{name}"] = base64.b64decode(data["image/png"])
                parts.append(f"![]({name})")
        if said.strip():
            parts.append(_fenced(said, "text"))
    title, _, text = "\n\n".join(parts).partition("\n")
    made[f"notebooks/{path.stem}.md"] = f"{title}\n\n<small>`notebooks/{path.name}`, {note}.</small>\n{text}\n"
    return made


def _fenced(text: str, language: str) -> str:
    clean = COLOUR.sub("", text).replace("\r", "")
    if language == "text":
        clean = re.sub(r"\n{2,}", "\n", clean).strip()
    return f"```{language}\n{clean}\n```"
