"""The page `campaign-keys.md`: every key of a campaign, from the models that read it and the docstrings beside their fields.

Example:
    python docs/keys.py                    # writes docs/campaign-keys.md, which tests/repository/test_docs.py compares
"""

from __future__ import annotations

import ast
import inspect
import textwrap
import types
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo

from aridcal.files.campaign import Campaign
from aridcal.files.yaml_file import Section

PAGE = Path(__file__).resolve().parent / "campaign-keys.md"

BEGINNING = """# Keys of a campaign

Every key of `campaign.yaml`, with its default. [Formats](formats.md#1-the-campaign-campaignyaml) has an example, and the rules
behind the keys. A scenario has the same keys, and [`truth`](simulate.md). This page is made from the models that read the file
(`python docs/keys.py`): change their docstrings, not this text.

NAME stands for a name of yours, FRAME for one of two. Of a list of mappings the keys of each are given.
"""

WORDS: dict[Any, str] = {str: "text", float: "number", int: "whole number", bool: "`true` or `false`", Path: "file"}


@cache
def docstrings(model: type[Section]) -> dict[str, str]:
    """What stands below each field of a model, or of what it is derived from, as one line."""
    said: dict[str, str] = {}
    for parent in reversed([c for c in model.__mro__ if issubclass(c, Section)]):
        (definition,) = ast.parse(textwrap.dedent(inspect.getsource(parent))).body
        assert isinstance(definition, ast.ClassDef)
        for field, after in zip(definition.body, [*definition.body[1:], None], strict=True):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
                documented = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
                text = " ".join(str(after.value.value).split()) if documented else ""
                said[field.target.id] = text or said.get(field.target.id, "")
    return said


def parts(annotation: Any) -> tuple[Any, ...]:
    """Alternatives of a type, without what only checks it and without `None`."""
    if get_origin(annotation) is Annotated:
        return parts(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        return tuple(p for each in get_args(annotation) for p in parts(each) if p is not type(None))
    return (annotation,)


def section_of(annotation: Any) -> tuple[type[Section] | None, str]:
    """The model of a field that holds keys of its own, and how its keys begin: `.`, or with a name of the user's."""
    for part in parts(annotation):
        arguments = get_args(part)
        if isinstance(part, type) and issubclass(part, Section):
            return part, "."
        if get_origin(part) is dict:
            model, _ = section_of(arguments[1])
            return model, ".NAME."
        if get_origin(part) is tuple:
            model, _ = section_of(arguments[0])
            return model, "."
    return None, ""


def words(annotation: Any) -> str:
    """A type in words."""
    said = []
    for part in parts(annotation):
        arguments = get_args(part)
        if get_origin(part) is Literal:
            values = (str(value).replace("|", "\\|") if value else "''" for value in arguments)
            said.append(", ".join(f"`{value}`" for value in values))
        elif get_origin(part) is dict:
            said.append(f"NAME: {words(arguments[1])}")
        elif get_origin(part) is tuple and arguments[-1] is Ellipsis:
            said.append(f"list of {words(arguments[0])}")
        elif get_origin(part) is tuple:
            said.append(f"{len(arguments)} × {words(arguments[0])}")
        elif section_of(part)[0]:
            said.append("keys")
        else:
            said.append(WORDS[part])
    return " or ".join(said)


def default(field: FieldInfo) -> str:
    """How a default is written in YAML; nothing where there is none worth a word."""
    value = field.get_default(call_default_factory=True)
    if field.is_required():
        return "required"
    if value is None or isinstance(value, Section) or value in ((), {}, ""):
        return ""
    if isinstance(value, tuple):
        if any(isinstance(each, Section) for each in value):
            return ""
        shown = ", ".join(f"{each:g}" if isinstance(each, float) else str(each) for each in value)
        return f"`[{shown}]`" if len(shown) < 60 else "`all`"
    return (
        f"`{value:g}`" if isinstance(value, float) else f"`{str(value).lower() if isinstance(value, bool) else value}`"
    )


def rows(model: type[Section], begin: str) -> Iterator[tuple[str, str, str, str]]:
    """Key, value, default and meaning of each key of a model, those of its sections behind it."""
    names = [name for name, field in model.model_fields.items() if field.alias not in model.model_fields]
    sections = [(name, *section_of(model.model_fields[name].annotation)) for name in names]
    for k, (name, below, joint) in enumerate(sections):
        field = model.model_fields[name]
        key = begin + (field.alias or name)
        meaning = docstrings(model)[name] or (" ".join((below.__doc__ or "").split("\n\n")[0].split()) if below else "")
        if not meaning:
            raise LookupError(f"{model.__name__}.{name} ({key}) has no docstring: say there what it means")
        yield key, words(field.annotation), default(field), meaning
        alike = [other for _, other, _ in sections[k + 1 :]]
        if below is not None and below not in alike:  # of several of one model the keys stand behind the last
            title = begin + "FRAME" if [of for _, of, _ in sections].count(below) > 1 else key
            yield from rows(below, title + joint)


def page() -> str:
    """The page as Markdown: a heading for each key at the top, and a table of those below it."""
    heads: dict[str, list[tuple[str, str, str, str]]] = {}
    for row in rows(Campaign, ""):
        heads.setdefault(row[0].partition(".")[0], []).append(row)
    said = [BEGINNING]
    for head, ((_, value, usual, meaning), *below) in heads.items():
        known = "; ".join(word for word in (value, usual) if word not in ("", "keys"))
        said.append(f"## {head}\n\n{meaning}{f' ({known})' if known else ''}\n")
        if below:
            cells = [
                f"| `{key.removeprefix(head + '.')}` | {'; '.join(word for word in (value, usual) if word)} | {meaning} |\n"
                for key, value, usual, meaning in below
            ]
            said.append("".join(["| key | value; default | meaning |\n", "|---|---|---|\n", *cells]))
    return "\n".join(said)


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
