"""What a user's columns may mean, by their names alone: joints, positions, orientations, labels."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from aridcal.files.quantities import COMPUTED


def _set(text: str) -> frozenset[str]:
    return frozenset(text.split())


# Words for units, and what campaigns call them.
UNIT_WORDS = {
    **{word: "rad" for word in ("rad", "radian", "radians")},
    **{word: "deg" for word in ("deg", "degree", "degrees", "grad", "°")},
    **{word: "m" for word in ("meter", "meters", "metres")},
    **{word: "mm" for word in ("millimeter", "millimeters", "millimetres")},
    **{word: "in" for word in ("inch", "inches")},
    **{word: "s" for word in ("sec", "secs", "second", "seconds")},
    **{word: word for word in ("m", "cm", "mm", "um", "in", "ft", "s", "ms", "us", "ns")},
}
# Words for one letter.
SYNONYMS = {"roll": "rx", "pitch": "ry", "yaw": "rz", "alpha": "a", "beta": "b", "gamma": "c"}
# Words that tell nothing.
FILLER_WORDS = _set("joint joints position positions pos reading readings state states robot value angle")
# Words for what was asked for.
COMMANDED_WORDS = _set(
    "goal cmd command commanded desired nominal setpoint ref reference planned wanted expected theoretical"
)
# Words for what was measured.
MEASURED_WORDS = _set("measured measurement meas actual tracker laser mocap leica marker reflector smr probe")
# Of these, words for what may be one of several on a body.
ON_A_BODY = _set("marker reflector smr probe")
# Words for how well something was measured.
SCATTER_WORDS = _set("std sigma sd stdev error err residual")
# Words for what is neither a reading nor a pose.
OTHER_WORDS = SCATTER_WORDS | _set(
    "delta diff dev deviation d v vel velocity speed qd acc acceleration f force torque tau "
    "moment effort current temperature temp direction"
)
# Words for orientations.
ORIENTATION_WORDS = _set("r rot rotation rv rotvec euler orientation ori angle angles rpy o q quat quaternion e")
# Words for quaternions.
QUATERNION_WORDS = _set("q quat quaternion")
# Words for the scalar of a quaternion.
SCALAR_WORDS = _set("0 4 w s r scalar real qw qs qr qo")
# Words for the numbers of a position, where they are numbered.
POSITION_WORDS = _set("position pos p t trans translation xyz point pose tcp")
# Angles whose columns are called by Greek letters or otherwise, in their order.
NAMED_ANGLES = (("phi", "theta", "psi"), ("psi", "theta", "phi"), ("o", "a", "t"), ("az", "el", "roll"))
# A cell of a matrix: what it is of, its row and its column.
MATRIX_CELL = re.compile(r"(.*?)[\s_\[(,.]*([0-4])[\s_\]\[)(,.]*([0-4])[\])]?")
# Numbers of a matrix in a row: of a rotation, of a pose without and with its last line.
MATRIX_SIZES = (9, 12, 16)
# Words for joints.
JOINT_WORDS = _set("j q jt joint joints axis a theta th angle robax gelenk achse axe eje asse")
# Where a word ends without a separator: before a capital, a number, or a letter after a number.
WORD_ENDS = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[^\W\d_])(?=\d)|(?<=\d)(?=[^\W\d_])")

# Words before the one in which a family differs, what its members share of that word, and words after it.
_Pattern = tuple[tuple[str, ...], str, tuple[str, ...]]


@dataclass(frozen=True)
class Family:
    """Columns whose names differ in one letter or number only.

    Attributes:
        columns: In the order of the letters or numbers.
        about: The words that they share.
        numbers: Of the columns, where they are numbered.
    """

    columns: tuple[str, ...]
    about: frozenset[str]
    numbers: tuple[int, ...] = ()

    @property
    def commanded(self) -> bool:
        """Whether the names speak of what was asked for, not of what was measured."""
        return bool(self.about & COMMANDED_WORDS)

    @property
    def computed(self) -> bool:
        """Whether this is where a controller's own model has its tool, so that nothing was measured."""
        return self.about >= COMPUTED

    @property
    def measured(self) -> bool:
        """Whether the names say that this was measured."""
        return bool(self.about & MEASURED_WORDS)


def words(name: str) -> tuple[str, ...]:
    """A name's words without units: ``Measured X [mm]`` and ``measuredX`` give ``measured x``, ``J1_deg`` ``j 1``."""
    parts = tuple(SYNONYMS.get(word, word) for word in _split(name))
    without_units = tuple(word for word in parts if word not in UNIT_WORDS)
    return without_units or parts


def unit(name: str) -> str | None:
    """The unit that a name ends in, as campaigns write it: ``deg`` of ``J1 [degrees]``; None where it ends in none."""
    parts = _split(name)
    return UNIT_WORDS.get(parts[-1]) if len(parts) > 1 else None


def lettered_families(names: Iterable[str], letters: str) -> list[Family]:
    """Families of columns that differ in the last letter of one word: ``tcp_x tcp_y tcp_z``, ``rx ry rz``.

    Args:
        names: Columns.
        letters: One for each member, in their order.

    Returns:
        Families that have all their members; of two columns for one letter the first.
    """
    groups: dict[_Pattern, dict[str, str]] = {}
    for name in names:
        parts = words(name)
        for k, word in enumerate(parts):
            stem, letter = word[:-1], word[-1]
            if letter in letters:
                members = groups.setdefault((parts[:k], stem, parts[k + 1 :]), {})
                members.setdefault(letter, name)
    families = []
    for (before, stem, after), members in groups.items():
        if len(members) == len(letters):
            columns = tuple(members[letter] for letter in letters)
            about = frozenset((*before, stem, *after)) - {""}
            families.append(Family(columns, about))
    return families


def numbered(names: Iterable[str]) -> list[Family]:
    """Families of columns that differ in one number only and count without a gap: ``q0`` … ``q5``.

    Args:
        names: Columns; of two with the same number the first counts.
    """
    groups: dict[_Pattern, dict[int, str]] = {}
    for name in names:
        parts = words(name)
        places = [k for k, word in enumerate(parts) if word.isdecimal()]
        if len(places) == 1:
            k = places[0]
            members = groups.setdefault((parts[:k], "", parts[k + 1 :]), {})
            members.setdefault(int(parts[k]), name)
    families = []
    for (before, _, after), members in groups.items():
        numbers = tuple(sorted(members))
        without_gap = tuple(range(numbers[0], numbers[0] + len(numbers)))
        if numbers == without_gap:
            columns = tuple(members[n] for n in numbers)
            families.append(Family(columns, frozenset((*before, *after)), numbers))
    return families


def match_joints(joints: Sequence[str], names: Sequence[str]) -> tuple[dict[str, str], str] | None:
    """Find a column for each joint: by its own name, by a similar one, by number, or by order alone.

    Args:
        joints: Names as in the URDF, in the order of the chain.
        names: Columns.

    Returns:
        The column of each joint and how they were matched: ``same name``, ``similar name``, ``number`` or ``order``;
        None if a joint has no column.
    """
    if set(joints) <= set(names):
        return {joint: joint for joint in joints}, "same name"
    readings = [name for name in names if not set(words(name)) & OTHER_WORDS]
    similar = _similar(joints, readings)
    if similar is not None:
        return similar, "similar name"
    families = joint_families(readings, len(joints))
    if not families:
        return None
    family = families[0]
    numbers = _numbers(joints)
    if sorted(numbers) == list(family.numbers):
        column = dict(zip(family.numbers, family.columns, strict=True))
        return {joint: column[number] for joint, number in zip(joints, numbers, strict=True)}, "number"
    return dict(zip(joints, family.columns, strict=True)), "order"


def joint_families(names: Sequence[str], count: int) -> list[Family]:
    """Numbered families that may be so many joints' readings, all that are the likeliest by their names."""
    readings = [name for name in names if not set(words(name)) & OTHER_WORDS]
    families = [family for family in numbered(readings) if _may_be_joints(family, count)]
    least = min(map(_doubt, families), default=None)
    return [family for family in families if _doubt(family) == least]


def _similar(joints: Sequence[str], names: Sequence[str]) -> dict[str, str] | None:
    """The column of each joint whose words are the joint's; None unless every joint has one of its own."""
    columns = {joint: column for joint in joints if (column := _alike(joint, names))}
    complete = len(columns) == len(joints) == len(set(columns.values()))
    return columns if complete else None


def _may_be_joints(family: Family, count: int) -> bool:
    return len(family.columns) == count and bool(family.about & (JOINT_WORDS | FILLER_WORDS))


def _doubt(family: Family) -> tuple[bool, bool]:
    """Sort key of families by how likely they hold what was measured, the surest first."""
    return family.commanded or "target" in family.about, not family.measured


def positions(names: Iterable[str]) -> list[Family]:
    """Families that may hold measured positions, the likeliest first.

    What was measured comes before what was not said to be, what was commanded last; among these, short names first.
    """
    names = list(names)
    by_number = [
        Family(family.columns[:3], family.about, family.numbers[:3])
        for family in numbered(names)
        if (len(family.columns) == 3 or (len(family.columns) in (6, 7) and family.about & {"pose", "tcp"}))
        and family.about & POSITION_WORDS
        and not family.about & ORIENTATION_WORDS
    ]
    by_letter = [family for family in lettered_families(names, "xyz") if not family.about & ORIENTATION_WORDS]
    families = [family for family in (*by_letter, *by_number) if not family.about & OTHER_WORDS]
    return sorted(families, key=lambda family: (family.commanded, not family.measured, len(family.about)))


def quaternions(names: Iterable[str]) -> list[Family]:
    """Families of four columns that may be quaternions, the likeliest first: x y z w by letter, or numbered."""
    names = list(names)
    by_letter = lettered_families(names, "xyzw")
    by_number = [family for family in numbered(names) if len(family.columns) == 4 and family.about & ORIENTATION_WORDS]
    by_number += [
        Family(family.columns[3:], family.about, family.numbers[3:])
        for family in numbered(names)
        if len(family.columns) == 7 and family.about & {"pose", "tcp"}
    ]
    families = [family for family in (*by_letter, *_with_scalars(names), *by_number) if not family.about & OTHER_WORDS]
    return sorted(families, key=lambda family: (family.commanded, not family.measured, bool(family.numbers)))


def angle_triples(names: Iterable[str]) -> list[Family]:
    """Families of three columns that may be Euler angles or a rotation vector, the likeliest first.

    By axis (``rx ry rz``, where another word speaks of orientation), KUKA's ``A B C``, Fanuc's ``W P R``.
    """
    names = list(names)
    by_axis = [family for family in lettered_families(names, "xyz") if family.about & ORIENTATION_WORDS]
    candidates = [*by_axis, *lettered_families(names, "abc"), *lettered_families(names, "wpr")]
    by_words = {words(name): name for name in reversed(names)}
    for angles in NAMED_ANGLES:
        if all((SYNONYMS.get(word, word),) in by_words for word in angles):
            candidates.append(Family(tuple(by_words[(SYNONYMS.get(word, word),)] for word in angles), frozenset()))
    for family in numbered(names):
        if len(family.columns) == 3 and family.about & ORIENTATION_WORDS:
            candidates.append(family)
        elif len(family.columns) == 6 and family.about & {"pose", "tcp"}:
            candidates.append(Family(family.columns[3:], family.about, family.numbers[3:]))
    families = [family for family in candidates if not family.about & OTHER_WORDS]
    return sorted(families, key=lambda family: (family.commanded, not family.measured))


def _with_scalars(names: Sequence[str]) -> list[Family]:
    """Quaternions whose scalar is called otherwise than their vector: ``Q0 Qx Qy Qz``."""
    families = []
    for family in lettered_families(names, "xyz"):
        if not family.about & QUATERNION_WORDS:
            continue
        for name in names:
            parts = set(words(name))
            if name not in family.columns and parts & SCALAR_WORDS and parts - SCALAR_WORDS <= family.about:
                families.append(Family((*family.columns, name), family.about))
                break
    return families


@dataclass(frozen=True)
class MatrixColumns:
    """Columns of a rotation matrix, or of a pose as one.

    Attributes:
        rotation: Columns of the matrix row by row, once for each way in which they may be meant.
        position: Columns of the place, one triple for each of these ways; None: there is none.
        about: The words that they share.
    """

    rotation: tuple[tuple[str, ...], ...]
    position: tuple[tuple[str, str, str], ...] | None
    about: frozenset[str]


def matrices(names: Iterable[str]) -> list[MatrixColumns]:
    """Families of columns that are matrices: by two numbers, numbered through, or ``nx ny nz ox … az``."""
    names = list(names)
    cells: dict[str, dict[tuple[int, int], str]] = {}
    for name in names:
        place = MATRIX_CELL.fullmatch(name)
        if place is not None:
            cells.setdefault(place[1].strip(" _[(."), {}).setdefault((int(place[2]), int(place[3])), name)
    matrices_found = []
    for prefix, cell in cells.items():
        for base in (1, 0):
            span = range(base, base + 3)
            if all((i, j) in cell for i in span for j in span):
                rotation = tuple(cell[i, j] for i in span for j in span)
                last_column = [cell.get((i, base + 3)) for i in span]
                position = ((last_column[0], last_column[1], last_column[2]),) if all(last_column) else None
                transposed = tuple(cell[j, i] for i in span for j in span)
                matrices_found.append(MatrixColumns((rotation, transposed), position, frozenset(words(prefix))))  # type: ignore[arg-type]
                break
    matrices_found += [_numbered_matrix(family) for family in numbered(names) if len(family.columns) in MATRIX_SIZES]
    return [*matrices_found, *_of_vectors(names)]


def _numbered_matrix(family: Family) -> MatrixColumns:
    """A matrix whose cells are counted through: row by row, or column by column."""
    c, size = family.columns, len(family.columns)
    columns_wide = 3 if size == 9 else 4
    rows = tuple(c[columns_wide * i + j] for i in range(3) for j in range(3))
    rows_tall = 4 if size == 16 else 3
    columns = tuple(c[rows_tall * j + i] for i in range(3) for j in range(3))
    place = None if size == 9 else ((c[3], c[7], c[11]), (c[3 * rows_tall], c[3 * rows_tall + 1], c[3 * rows_tall + 2]))
    return MatrixColumns((rows, columns), place, family.about)


def _of_vectors(names: Sequence[str]) -> list[MatrixColumns]:
    """Columns of a matrix as vectors: ``n``, ``o`` and ``a``, each with x y z, and perhaps ``p``."""
    by_stem: dict[frozenset[str], Family] = {family.about: family for family in lettered_families(names, "xyz")}
    triple = [by_stem.get(frozenset({stem})) for stem in "noa"]
    if any(family is None for family in triple):
        return []
    vectors = [family.columns for family in triple if family is not None]
    rotation = tuple(vectors[j][i] for i in range(3) for j in range(3))
    return [MatrixColumns((rotation,), None, frozenset())]


def places(free: Sequence[str]) -> list[Family]:
    """Families that may hold measured positions; those of a matrix of a pose first."""
    of_matrices, in_matrices = [], set()
    for matrix in matrices(free):
        in_matrices |= {name for way in matrix.rotation for name in way}
        of_matrices += [Family(place, matrix.about) for place in matrix.position or ()]
    inside = {name for family in of_matrices for name in family.columns}
    plain = positions(name for name in free if name not in in_matrices | inside)
    return [*of_matrices, *(family for family in plain if not set(family.columns) & inside)]


def has_orientation(free: Sequence[str], place: Family) -> bool:
    """True of a position beside which an orientation has the same words."""
    about = place.about - POSITION_WORDS
    triples = (*quaternions(free), *angle_triples(free))
    return any(
        family.about - ORIENTATION_WORDS == about and not set(family.columns) & set(place.columns) for family in triples
    )


def named_column(names: Iterable[str], *wanted: str) -> str | None:
    """The first column called by one of some words, apart from its unit and words such as ``measured``."""
    for name in names:
        parts = [word for word in words(name) if word not in MEASURED_WORDS | {"name"}]
        if len(parts) == 1 and parts[0] in wanted:
            return name
    return None


def _split(name: str) -> tuple[str, ...]:
    """A name's words and numbers in small letters: ``actual q 1 deg`` of ``actualQ1 [deg]``."""
    spaced = WORD_ENDS.sub(" ", name)
    return tuple(re.findall(r"[^\W_]+|°", spaced.lower())) or (name,)


def _core(name: str) -> tuple[str, ...]:
    """A name's words without those that tell nothing."""
    parts = words(name)
    return tuple(word for word in parts if word not in FILLER_WORDS | MEASURED_WORDS) or parts


def _alike(joint: str, names: Sequence[str]) -> str | None:
    """The one column whose words are the joint's, fillers aside."""
    core = _core(joint)
    if not any(word.isalpha() and word not in JOINT_WORDS for word in core):
        return None  # only a number: other columns have numbers too
    columns = [name for name in names if _core(name) == core]
    return columns[0] if len(columns) == 1 else None


def _numbers(joints: Sequence[str]) -> list[int]:
    """The one number in each name, -1 where there is none."""
    digits_of = [re.findall(r"\d+", joint) for joint in joints]
    prefixes = {tuple(digits[:-1]) for digits in digits_of}
    if joints and len(prefixes) == 1:  # panda2_joint1 … panda2_joint7
        digits_of = [digits[-1:] for digits in digits_of]
    return [int(digits[0]) if len(digits) == 1 else -1 for digits in digits_of]
