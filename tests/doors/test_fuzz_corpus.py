"""Small files that once broke a reader, or that fuzzing starts from: all read or refused, each with a message."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest

from aridcal.system.errors import AridcalError
from fuzz.mutate import mutate
from fuzz.targets import CORPUS, TARGETS

FILES = sorted(path for path in CORPUS.glob("*/*"))
TEXT = [name for name, target in TARGETS.items() if target.kind == "text"]

# Mutants of each reader's corpus that every run of the tests looks at.
MUTANTS = 100


def attempt(reader: str, content: bytes, folder: Path) -> str:
    """Have a reader read a file; what it says against it, or nothing."""
    path = folder / f"input{TARGETS[reader].suffix}"
    path.write_bytes(content)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            TARGETS[reader].read(path)
    except AridcalError as error:
        assert str(error).strip(), "an error that says nothing"
        return str(error)
    return ""


@pytest.mark.parametrize("file", FILES, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_a_file_of_the_corpus_is_read_or_refused_by_every_reader_of_its_kind(file: Path, tmp_path: Path) -> None:
    for reader, target in TARGETS.items():
        if file.suffix == target.suffix or file.parent.name == reader:
            said = attempt(reader, file.read_bytes(), tmp_path)
            assert not (said and file.parent.name == reader and not file.stem.startswith("bad")), said


def test_every_reader_has_a_corpus_and_every_corpus_a_reader() -> None:
    assert {path.name for path in CORPUS.iterdir()} == set(TARGETS)


@pytest.mark.parametrize("reader", TEXT)
def test_mutants_are_read_or_refused(reader: str, tmp_path: Path) -> None:
    """What `make fuzz` does by the million, seeded; some are accepted and some refused, or nothing was tried."""
    seeds = [path.read_bytes() for path in sorted((CORPUS / reader).iterdir())]
    said = [
        attempt(reader, mutate(seeds[k % len(seeds)], k, seeds, TARGETS[reader].longest), tmp_path)
        for k in range(MUTANTS)
    ]
    assert "" in said and any(said)


def test_a_mutant_is_fixed_by_its_seed_and_never_too_long() -> None:
    seeds = [(CORPUS / "campaign" / "long.yaml").read_bytes()]
    mutants = [mutate(seeds[0], k, seeds, 900) for k in range(200)]
    assert mutants == [mutate(seeds[0], k, seeds, 900) for k in range(200)]
    assert len(set(mutants)) > 150 and max(map(len, mutants)) <= 900
