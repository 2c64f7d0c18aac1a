"""Settings files: YAML read safely, checked against a pydantic model, every complaint with its file, line and key."""

from __future__ import annotations

import datetime
import math
import re
from collections.abc import Hashable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import yaml
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic_core import ErrorDetails, PydanticCustomError

from aridcal.system.errors import AridcalError, CampaignError, nearest, printable, shortened
from aridcal.system.reading.regular_files import IMAGE, SETTINGS, TABLE_LIMIT, URDF, Limit, not_utf8, read_file
from aridcal.system.reading.user_names import check_path

MAX_YAML_DEPTH = 50

MAX_NODES = 200_000
"""Keys and values: more than a calibration of three thousand coefficients has; they are read within a second."""

MAX_COMPLAINTS = 8

LARGEST_INTEGER = 2**63
"""Whole numbers beyond are no row, no seed and no length; Python does not even print one of 5,000 digits."""

MOST_DIGITS = 70
"""Characters of a whole number at the most: 64 binary digits, their mark and a sign."""

LARGEST_NUMBER = 1e15
"""Largest number with a fraction, a time in microseconds for instance: its square and its products are numbers, too."""

LARGEST_SETTING = 1e9
"""[m], [rad], [px]: no place, angle or image is larger."""

FINEST = 1e-12
"""[m], [rad], [px]: no length and no sigma is smaller; these could not be divided by."""

TEXT_TAG = "tag:yaml.org,2002:str"

Location = tuple[str | int, ...]

# The parser in C where there is one: a covariance of a hundred parameters is ten thousand numbers.
_SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class Loader(_SafeLoader):
    """Safe loader that also takes ``1e-4`` for a number: YAML 1.1 would make it text for want of a point."""

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        """A whole number that is none of thousands of digits."""
        if len(node.value) <= MOST_DIGITS:
            value = super().construct_yaml_int(node)
            if abs(value) <= LARGEST_INTEGER:
                return int(value)
        raise yaml.constructor.ConstructorError(
            problem=f"the number {shortened(node.value)} is too large: write a smaller one",
            problem_mark=node.start_mark,
        )


Loader.add_constructor("tag:yaml.org,2002:int", Loader.construct_yaml_int)
Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+\Z"), list("-+.0123456789")
)


def _path(name: Any, info: ValidationInfo) -> Any:
    if not isinstance(name, str | Path) or not str(name).strip():
        raise ValueError(f"should be a file name, not {_shown(name)}")
    path: Path = info.context["folder"] / name if info.context else Path(name)
    try:
        check_path(path, CampaignError)
    except CampaignError as problem:
        raise ValueError(str(problem)) from None
    return path


# A path that is relative to the settings file that names it; already resolved on the loaded model.
RelativePath = Annotated[Path, BeforeValidator(_path)]

Number = Annotated[float, Field(ge=-LARGEST_SETTING, le=LARGEST_SETTING)]

Positive = Annotated[float, Field(ge=FINEST, le=LARGEST_SETTING)]
"""A length, a focal length or a sigma."""

Vector3 = tuple[Number, Number, Number]


class Section(BaseModel):
    """One mapping of a settings file: immutable, finite numbers only, no unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _refuse_unknown_keys(cls, keys: Any) -> Any:
        if isinstance(keys, dict):
            names = [field.alias or name for name, field in cls.model_fields.items()]
            for key in keys:
                if key not in names:
                    facts = {"key": key, "hint": nearest(str(key), names)}
                    raise PydanticCustomError("unknown_key", "unknown key{hint}", facts)
        return keys


class Limits(Section):
    """How much is read; raised for files that are large on purpose."""

    urdf_mb: float = Field(default=URDF.megabytes, gt=0, le=1e6)
    """Megabytes of a URDF, also as xacro expands it."""
    table_mb: float = Field(default=TABLE_LIMIT.megabytes, gt=0, le=1e6)
    """Megabytes of a table as a file, and of its cells in memory, eight bytes each."""
    image_mb: float = Field(default=IMAGE.megabytes, gt=0, le=1e6)
    """Megabytes of an image."""
    image_megapixels: float = Field(default=100.0, gt=0, le=1e6)
    """By its header; no camera that measures has more than 100."""

    @property
    def urdf(self) -> Limit:
        """Limit of a URDF."""
        return Limit(self.urdf_mb, URDF.key)

    @property
    def table(self) -> Limit:
        """Limit of a table."""
        return Limit(self.table_mb, TABLE_LIMIT.key)

    @property
    def image(self) -> Limit:
        """Limit of an image as a file."""
        return Limit(self.image_mb, IMAGE.key)


class Settings(Section):
    """A whole settings file. Keeps its text and where it came from."""

    format: Literal[1]
    """Version of the file's format."""
    limits: Limits = Limits()
    _path: Path = PrivateAttr(default=Path())
    _text: str = PrivateAttr(default="")

    @property
    def path(self) -> Path:
        """The file that the settings were read from."""
        return self._path

    @property
    def text(self) -> str:
        """The file as the user wrote it."""
        return self._text

    def __str__(self) -> str:
        return self._text

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self._path}>"


AnySection = TypeVar("AnySection", bound=Section)

AnySettings = TypeVar("AnySettings", bound=Settings)


def decode(content: bytes, path: Path, error: type[AridcalError]) -> str:
    """Decode UTF-8 with or without a byte order mark.

    Raises:
        AridcalError: of the given kind, naming the file and the line that is something else.
    """
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        raise not_utf8(content, problem.start, path, error) from None


def load_settings(path: str | Path, model: type[AnySettings], limit: Limit = SETTINGS) -> AnySettings:
    """Read a settings file, YAML in UTF-8, whose paths are relative to its folder.

    Raises:
        CampaignError: naming the file, the line, the key and the remedy.
    """
    path = Path(path)
    content = read_file(path, CampaignError, limit)
    return parse_settings(decode(content, path, CampaignError), path, model)


def parse_settings(text: str, path: Path, model: type[AnySettings]) -> AnySettings:
    """Check the text of a settings file, whose path need not exist, as :func:`load_settings` does.

    Raises:
        CampaignError: naming the file, the line, the key and the remedy.
    """
    keys, lines = parse_yaml(text, path)
    if "format" not in keys:
        raise CampaignError(f"{path}: the key 'format' is missing; write `format: 1` on top")
    if type(keys["format"]) is not int or keys["format"] != 1:
        where = f"{path}, line {lines['format',]}"
        raise CampaignError(
            f"{where}: format: this version reads format 1 only, not {_shown(keys['format'])}; write `format: 1`"
        )
    settings = validated(keys, lines, path, model)
    settings._path, settings._text = path, text
    return settings


def validated(keys: dict[str, Any], lines: dict[Location, int], path: Path, model: type[AnySection]) -> AnySection:
    """Check the keys and lines of :func:`parse_yaml`.

    Raises:
        CampaignError: naming the file, the line, the key and the remedy.
    """
    try:
        settings = model.model_validate(_frozen(keys), strict=True, context={"folder": path.parent})
    except ValidationError as problem:
        complaints = [_complaint(error, path, lines) for error in problem.errors(include_url=False)]
        if len(complaints) > MAX_COMPLAINTS:
            complaints[MAX_COMPLAINTS:] = [f"and {len(complaints) - MAX_COMPLAINTS} more"]
        raise CampaignError("\n".join(complaints)) from None
    _check_numbers(keys, (), path, lines)
    return settings


def _check_numbers(value: Any, location: Location, path: Path, lines: dict[Location, int]) -> None:
    """Refuse a number so large that no computation with it would end in a number."""
    if isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            _check_numbers(item, (*location, key), path, lines)
    elif isinstance(value, float) and LARGEST_NUMBER < abs(value) < math.inf:
        where = f"{path}, line {lines[location]}: {_dotted(location)}"
        raise CampaignError(f"{where}: should not be beyond {LARGEST_NUMBER:g}, not {value:g}")


def parse_yaml(text: str, path: Path) -> tuple[dict[str, Any], dict[Location, int]]:
    """Read a YAML mapping safely.

    Returns:
        The mapping, and the line of each of its keys and list items.

    Raises:
        CampaignError: it is no plain YAML; naming the file and the line.
    """
    try:
        _refuse_tricks(text, path)
        loader = Loader(text)
        node = loader.get_single_node()
        if not isinstance(node, yaml.MappingNode):
            raise CampaignError(f"{path}: holds no `key: value` pairs")
        lines = dict(_lines(node, (), path))
        return loader.construct_document(node), lines
    except yaml.reader.ReaderError as problem:
        line = text.count("\n", 0, problem.position) + 1
        raise CampaignError(f"{path}, line {line}: holds a character that YAML forbids; delete it") from None
    except yaml.MarkedYAMLError as problem:
        mark = problem.problem_mark or problem.context_mark
        number = mark.line if mark else 0
        shown = (text.splitlines() or [""])[number : number + 1]
        tab = " (YAML wants spaces, not tabs)" if shown and "\t" in shown[0] else ""
        raise CampaignError(
            f"{path}, line {number + 1}: is not valid YAML: {problem.problem}{tab}. Mend that line"
        ) from None
    except ValueError as problem:  # a date such as 2024-02-30
        raise CampaignError(f"{path}: is not valid YAML: {problem}; put what is no date in quotes") from None


# Change of the depth by each kind of event.
DEEPER = {yaml.MappingStartEvent: 1, yaml.SequenceStartEvent: 1, yaml.MappingEndEvent: -1, yaml.SequenceEndEvent: -1}


def _refuse_tricks(text: str, path: Path) -> None:
    """Refuse what a settings file has no need of and an attacker has.

    Aliases can blow up a few lines to gigabytes, deep nesting exhausts the stack, and tags make objects.

    Raises:
        CampaignError: naming the line.
    """
    depth = 0
    for number, event in enumerate(yaml.parse(text, Loader=Loader)):
        kind = type(event)
        depth += DEEPER.get(kind, 0)
        if kind is yaml.AliasEvent:
            anchor = str(getattr(event, "anchor", ""))
            trick = f"the alias *{shortened(anchor)} is refused; write the value out"
        elif tag := getattr(event, "tag", None):
            trick = f"the tag {shortened(tag)} is refused; write plain values"
        elif depth > MAX_YAML_DEPTH:
            trick = f"is nested more than {MAX_YAML_DEPTH} deep; write plain keys and values"
        elif number > MAX_NODES:
            trick = f"has more than {MAX_NODES:,} keys and values; name another file"
        else:
            continue
        mark = event.start_mark
        raise CampaignError(f"{path}, line {mark.line + 1 if mark else 1}: {trick}")


def _lines(node: yaml.Node, location: Location, path: Path) -> Iterator[tuple[Location, int]]:
    """Yield the line of every key and list item below a node; refuse a key twice and keys that are not text; `on` is."""
    if isinstance(node, yaml.SequenceNode):
        for number, item in enumerate(node.value):
            yield (*location, number), item.start_mark.line + 1
            yield from _lines(item, (*location, number), path)
    elif isinstance(node, yaml.MappingNode):
        keys: set[Hashable] = set()
        for key, value in node.value:
            line = key.start_mark.line + 1
            where = f"{path}, line {line}"
            if not isinstance(key, yaml.ScalarNode):
                raise CampaignError(f"{where}: a key must be a plain word; write `key: value`")
            if key.value == "on":  # a key of cameras and markers, which YAML 1.1 takes for a truth
                key.tag = TEXT_TAG
            if key.tag != TEXT_TAG:
                kind, name = key.tag.rpartition(":")[2], _dotted((*location, key.value))
                raise CampaignError(f"{where}: {name}: YAML reads this key as a {kind}; put it in quotes")
            if key.value in keys:
                raise CampaignError(f"{where}: {_dotted((*location, key.value))}: this key is there twice; delete one")
            keys.add(key.value)
            yield (*location, key.value), line
            yield from _lines(value, (*location, key.value), path)


def _frozen(value: Any) -> Any:
    """Make lists tuples, as strict models want them, and dates the text that they were."""
    if isinstance(value, dict):
        return {key: _frozen(item) for key, item in value.items()}
    if isinstance(value, list):
        return tuple(_frozen(item) for item in value)
    return str(value) if isinstance(value, datetime.date) else value


def _dotted(location: Location) -> str:
    parts = (f"[{part}]" if isinstance(part, int) else f".{shortened(printable(part))}" for part in location)
    return "".join(parts).removeprefix(".")


def _complaint(error: ErrorDetails, path: Path, lines: dict[Location, int]) -> str:
    """Turn an error of pydantic into one line: where, which key, what is wrong, what was meant."""
    location: Location = error["loc"]
    facts = error.get("ctx", {})
    value = error["input"]
    if error["type"] == "unknown_key":
        location = (*location, facts["key"])
        wrong = error["msg"]
    elif error["type"] == "missing":
        wrong = f"this {'item' if isinstance(location[-1], int) else 'key'} is missing; add it"
    elif value is None:
        wrong = "has no value; give one or delete the key"
    elif error["type"] == "value_error":
        wrong = str(facts["error"])
    else:
        wrong = error["msg"].replace("Input should", "should").replace("valid tuple", "list")
        wrong = re.sub(r"valid dictionary( or instance of \w+)?", "mapping", wrong)
        wrong += f", not {_shown(value)}"
        if error["type"] == "literal_error":
            wrong += nearest(str(value), re.findall(r"'([^']*)'", facts["expected"]))
    nearest_location = location
    while nearest_location and nearest_location not in lines:
        nearest_location = nearest_location[:-1]
    where = f"{path}, line {lines[nearest_location]}" if nearest_location else f"{path}"
    return f"{where}: {_dotted(location)}: {wrong}" if location else f"{where}: {wrong}"


def _shown(value: object) -> str:
    return shortened(repr(list(value) if isinstance(value, tuple) else value))
