"""What a user's columns may mean, by their names alone: joints, positions, orientations, labels."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

UNIT_WORDS = {"rad": "rad", "radians": "rad", "deg": "deg", "degree": "deg", "degrees": "deg", "°": "deg"} | {
    word: word for word in ("m", "cm", "mm", "um", "in", "ft", "s")
}
SYNONYMS = {"roll": "rx", "pitch": "ry", "yaw": "rz", "alpha": "a", "beta": "b", "gamma": "c"}


def _set(text: str) -> frozenset[str]:
    return frozenset(text.split())


FILLERS = _set("joint joints position positions pos reading readings state states robot value angle")
COMMANDED = _set(
    "goal cmd command commanded desired nominal setpoint ref reference planned wanted expected theoretical"
)
MEASURED = _set("measured measurement meas actual tracker laser mocap leica marker reflector smr probe")
SCATTER = _set("std sigma sd stdev error err residual")
OTHER = SCATTER | _set(
    "delta diff d v vel velocity speed qd acc acceleration f force torque tau "
    "moment effort current temperature temp direction"
)
TURNED = _set("r rot rotation rv rotvec euler orientation ori angle angles rpy o q quat quaternion")
JOINT_LIKE = _set("j q joint joints axis a theta th angle")


@dataclass(frozen=True)
class Family:
    """Columns whose names differ in one letter or number only.

    Attributes:
        columns: In the order of the letters or numbers.
        about: The words that they share.
        numbers: Where they are numbered: their numbers.
    """

    columns: tuple[str, ...]
    about: frozenset[str]
    numbers: tuple[int, ...] = ()

    @property
    def commanded(self) -> bool:
        """Whether the names speak of what was asked for, not of what was measured."""
        return bool(self.about & COMMANDED)

    @property
    def measured(self) -> bool:
        """Whether the names say that this was measured."""
        return bool(self.about & MEASURED)


def words(name: str) -> tuple[str, ...]:
    """A name's words without units: ``Measured X [mm]`` and ``measuredX`` give ``measured x``, ``J1_deg`` ``j 1``."""
    said = tuple(SYNONYMS.get(word, word) for word in _split(name))
    return tuple(word for word in said if word not in UNIT_WORDS) or said


def unit(name: str) -> str | None:
    """The unit that a name ends in, as campaigns write it."""
    said = _split(name)
    return UNIT_WORDS.get(said[-1]) if len(said) > 1 else None


def lettered(names: Iterable[str], letters: str) -> list[Family]:
    """Families of columns that differ in the last letter of one word: ``tcp_x tcp_y tcp_z``, ``rx ry rz``."""
    found: dict[tuple[object, ...], dict[str, str]] = {}
    for name in names:
        said = words(name)
        for k, word in enumerate(said):
            if word[-1] in letters:
                members = found.setdefault((said[:k], word[:-1], said[k + 1 :]), {})
                members.setdefault(word[-1], name)
    families = []
    for (before, stem, after), members in found.items():
        if len(members) == len(letters):
            about = frozenset((*before, stem, *after)) - {""}  # type: ignore[misc]
            families.append(Family(tuple(members[letter] for letter in letters), about))
    return families


def numbered(names: Iterable[str]) -> list[Family]:
    """Families of columns that differ in one number only and count without a gap: ``q0`` … ``q5``."""
    found: dict[tuple[tuple[str, ...], tuple[str, ...]], dict[int, str]] = {}
    for name in names:
        said = words(name)
        at = [k for k, word in enumerate(said) if word.isdecimal()]
        if len(at) == 1:
            members = found.setdefault((said[: at[0]], said[at[0] + 1 :]), {})
            members.setdefault(int(said[at[0]]), name)
    families = []
    for (before, after), members in found.items():
        numbers = tuple(sorted(members))
        if numbers == tuple(range(numbers[0], numbers[0] + len(numbers))):
            families.append(Family(tuple(members[n] for n in numbers), frozenset((*before, *after)), numbers))
    return families


def match_joints(joints: Sequence[str], names: Sequence[str]) -> tuple[dict[str, str], str] | None:
    """Find a column for each joint.

    Args:
        joints: Names as in the URDF, in the order of the chain.
        names: Columns.

    Returns:
        The column of each joint and how they were matched: ``same name``, ``similar name``, ``number`` or ``order``;
        None if a joint has no column.
    """
    if set(joints) <= set(names):
        return {joint: joint for joint in joints}, "same name"
    plain = [name for name in names if not set(words(name)) & OTHER]
    similar = {joint: _alike(joint, plain) for joint in joints}
    if all(similar.values()) and len(set(similar.values())) == len(joints):
        return {joint: str(column) for joint, column in similar.items()}, "similar name"
    families = [f for f in numbered(plain) if len(f.columns) == len(joints) and f.about & (JOINT_LIKE | FILLERS)]
    if not families:
        return None
    family = min(families, key=lambda f: (f.commanded or "target" in f.about, not f.measured))
    own = _numbers(joints)
    if sorted(own) == list(family.numbers):
        column = dict(zip(family.numbers, family.columns, strict=True))
        return {joint: column[n] for joint, n in zip(joints, own, strict=True)}, "number"
    return dict(zip(joints, family.columns, strict=True)), "order"


def positions(names: Iterable[str]) -> list[Family]:
    """Families that may hold measured positions, the likeliest first."""
    found = [f for f in lettered(names, "xyz") if not f.about & (TURNED | OTHER)]
    return sorted(found, key=lambda f: (f.commanded, not f.measured, len(f.about)))


def quaternions(names: Iterable[str]) -> list[Family]:
    """Families of four columns that may be quaternions: x y z w by letter, or numbered."""
    names = list(names)
    by_letter = [f for f in lettered(names, "xyzw") if not f.about & OTHER]
    by_number = [f for f in numbered(names) if len(f.columns) == 4 and f.about & TURNED and not f.about & OTHER]
    return sorted([*by_letter, *by_number], key=lambda f: (f.commanded, not f.measured, bool(f.numbers)))


def angle_triples(names: Iterable[str]) -> list[Family]:
    """Families of three columns that may be Euler angles or a rotation vector, the likeliest first."""
    names = list(names)
    found = [f for f in lettered(names, "xyz") if f.about & TURNED and not f.about & OTHER]
    for letters in ("abc", "wpr"):
        found += [f for f in lettered(names, letters) if not f.about & OTHER]
    return sorted(found, key=lambda f: (f.commanded, not f.measured))


def named(names: Iterable[str], *wanted: str) -> str | None:
    """The first column that is one of some words, with a unit perhaps and a word that says that it was measured."""
    found = ((name, [word for word in words(name) if word not in MEASURED]) for name in names)
    return next((name for name, said in found if len(said) == 1 and said[0] in wanted), None)


def _split(name: str) -> tuple[str, ...]:
    """``actualQ1 [deg]``: ``actual q 1 deg``."""
    apart = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Za-z])(?=\d)|(?<=\d)(?=[A-Za-z])", " ", name)
    return tuple(re.findall(r"[^\W_]+|°", apart.lower())) or (name,)


def _core(name: str) -> tuple[str, ...]:
    said = words(name)
    return tuple(word for word in said if word not in FILLERS | MEASURED) or said


def _alike(joint: str, names: Sequence[str]) -> str | None:
    """The one column whose words are the joint's, fillers aside."""
    if not any(word.isalpha() and word not in JOINT_LIKE for word in _core(joint)):
        return None  # only a number: other columns have numbers too
    found = [name for name in names if _core(name) == _core(joint)]
    return found[0] if len(found) == 1 else None


def _numbers(joints: Sequence[str]) -> list[int]:
    """The one number in each name, -1 where there is none."""
    found = [re.findall(r"\d+", joint) for joint in joints]
    if joints and len({tuple(f[:-1]) for f in found}) == 1:  # panda2_joint1 … panda2_joint7
        found = [f[-1:] for f in found]
    return [int(f[0]) if len(f) == 1 else -1 for f in found]
