"""Mutants of small programs, read, corrected and proved: the proof is never false, and other bytes never change.

    python benchmarks/program_fuzz.py --language KRL --mutants 1000000

Seeds are those of `tests/support/program_attacks`. Each is read; every target that may be corrected gets other numbers, and
the new text is proved. A finding is a proof that fails though only numbers of targets were changed, a byte outside of these that
differs, or any exception but an `AridcalError`.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from random import Random

import numpy as np
from programs_marked import attacks, cell_of, language_named, project_of
from scipy.spatial.transform import Rotation

from aridcal.jobs.apply.programs.cell import Cell
from aridcal.jobs.apply.programs.language import Language
from aridcal.jobs.apply.programs.languages import LANGUAGES
from aridcal.jobs.apply.programs.project import Project
from aridcal.jobs.apply.programs.proof import TextChange, corrected, edit_texts, expected_targets
from aridcal.jobs.apply.programs.targets import Target
from aridcal.jobs.apply.programs.text import LARGEST_IN_PROGRAM, NUL, written
from aridcal.system.errors import AridcalError
from fuzz.mutate import mutate

TOLD_AFTER = 100_000
"""Mutants after which it is said how far the run is: a minute or two."""

LONGEST = 1500
"""Bytes of a mutant: what is wrong with a long program is wrong with a short one, and sooner found."""

FRAMES = (
    "format: 1\n"
    "bases: {default: {xyz: [0.1, 0, 0]}, '1': {xyz: [0, 0.2, 0]}, '2': {xyz: [0, 0, 0.3]}, '5': {xyz: [0.3, 0, 0]},"
    " g54: {xyz: [0.1, 0, 0]}, g55: {xyz: [0, 0.1, 0]}}\n"
    "tools: {default: {xyz: [0, 0, 0.1]}, '1': {xyz: [0, 0, 0.2]}, '2': {xyz: [0, 0, 0.05]}, '3': {xyz: [0, 0, 0.3]}}\n"
)


def changed_outside(before: str, after: str, changes: Sequence[TextChange]) -> bool:
    """Whether anything but the given numbers differs: the old numbers are put back, from the end to the beginning."""
    own = [pair for c in changes for pair in zip(c.numbers, c.texts.split(NUL), strict=True)]
    text, ordered = after, sorted(own, key=lambda pair: pair[0].start)
    shift = sum(len(new) - len(number.text) for number, new in ordered)
    for number, new in reversed(ordered):
        shift -= len(new) - len(number.text)
        start = number.start + shift
        text = text[:start] + number.text + text[start + len(new) :]
    return text != before


def nearby(target: Target, rng: Random) -> np.ndarray:
    """Numbers of a place near a target's, as its language writes them."""
    steps = np.array([rng.choice((-1.0, 1.0)) * 10.0 ** rng.uniform(-7, -3) for _ in range(6)])
    if target.notation is None:
        return target.values + np.resize(steps, len(target.units)) / [unit for unit, _ in target.units]
    T = target.notation.pose(target.values)
    moved = T.copy()
    moved[:3, :3], moved[:3, 3] = Rotation.from_rotvec(steps[3:]).as_matrix() @ T[:3, :3], T[:3, 3] + steps[:3]
    return target.notation.numbers(moved, target.values)


def attempt(language: Language, cell: Cell, project: Project, rng: Random) -> tuple[int, str]:
    """How many targets were corrected, and what is wrong; empty if nothing is."""
    try:
        targets = language.read(project, cell).targets
    except AridcalError:
        return 0, ""
    changes = []
    plain = [target for target in targets if not target.why]
    for target in plain:
        new = list(map(written, nearby(target, rng), target.numbers.texts, target.places))
        if max(map(abs, map(float, new))) <= LARGEST_IN_PROGRAM:  # larger ones are left by the correction, too
            changes.append(TextChange(target.file, target.numbers, NUL.join(new)))
    texts = corrected(language, project, cell, expected_targets(targets), edit_texts(project, changes))
    for file, (source, text) in enumerate(zip(project.sources, texts, strict=True)):
        if changed_outside(source.text, text, [c for c in changes if c.file == file]):
            return len(plain), "a byte outside of targets has changed"
    return len(plain), ""


def fuzz(language: Language, mutants: int, seed: int) -> dict[str, int]:
    """Counts of mutants, of those with corrected targets, of these targets, and of findings, which are printed."""
    cell = cell_of(language, FRAMES)
    seeds = [project_of(attack.files) for ending in language.endings for _, attack in attacks(ending)]
    texts = [source.text.encode("latin-1") for _, project, _ in seeds for source in project.sources if source.ours]
    rng = Random(seed)
    counts = {"mutants": 0, "with targets": 0, "targets": 0, "findings": 0}
    for number in range(mutants):
        _, project, _ = rng.choice(seeds)
        changed = rng.randrange(len(project.sources))
        new = [source.text for source in project.sources]
        content = new[changed].encode("latin-1")
        new[changed] = mutate(content, rng.randrange(2**63), texts, LONGEST).decode("latin-1").replace("\0", " ")
        mutant = project.with_texts(new)
        try:
            targets, fault = attempt(language, cell, mutant, rng)
        except Exception as problem:  # whatever it is, it is a finding
            targets, fault = 0, f"{type(problem).__name__}: {problem}"
        counts["mutants"] += 1
        if counts["mutants"] % TOLD_AFTER == 0:
            print(
                f"{language.name}: {counts['mutants']:,} mutants, {counts['findings']} findings",
                file=sys.stderr,
                flush=True,
            )
        counts["with targets"] += targets > 0
        counts["targets"] += targets
        if fault:
            counts["findings"] += 1
            if counts["findings"] <= 20:
                print(f"seed {seed}, mutant {number}: {fault}\n{new[changed]!r}", flush=True)
    return counts


def main() -> None:
    command = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    command.add_argument("--language", choices=[language.name for language in LANGUAGES])
    command.add_argument("--mutants", type=int, default=1_000_000)
    command.add_argument("--seed", type=int, default=1)
    arguments = command.parse_args()
    languages = LANGUAGES if arguments.language is None else [language_named(arguments.language)]
    for language in languages:
        begin = time.process_time()
        counts = fuzz(language, arguments.mutants, arguments.seed)
        said = ", ".join(f"{count:,} {name}" for name, count in counts.items())
        print(f"{language.name}: {said}; {time.process_time() - begin:.0f} s", flush=True)


if __name__ == "__main__":
    main()
