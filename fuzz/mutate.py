"""Mutations of text by its lines, words and columns: what comes out is mostly still YAML, XML or csv, and so goes deep."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from random import Random

WORD = re.compile(rb"[-+.\w]+")
NUMBER = re.compile(rb"[-+]?[.\d][.\d]*([eE][-+]?\d+)?")

# Edits of one mutant: mostly one, or nothing that is right would be left.
EDITS = (1, 1, 1, 1, 2, 2, 3, 6)

# Share of the mutants that start from a right file: most that libFuzzer has gathered are wrong already.
AFRESH = 0.5

# What has no place where a number or a name is expected, or is the last of its kind.
HOSTILE: tuple[bytes, ...] = (
    *b"0 -0 1 -1 2 7 1.0 0.5 -1e-9 1e-320 1e9 1e308 -1e308 1e999 nan NaN .nan inf -inf .inf -.inf 2147483648".split(),
    *b"-2147483649 18446744073709551616 0xfff 0o17 0b1 1_000 190:20:30 2024-02-30 2001-12-14t21:59:43.10-05:00 3.14".split(),
    *b"~ null true false yes on ' \" , ; : - # % @ ` ! & * | > ? [ ] { } [] {} [[]] {a: b} <<: &a *a !!binary".split(),
    *b"!!python/name:os.system !!float % < > </robot> <a/> <![CDATA[x]]> &amp; &lt; &#10; &#0; &x; <!DOCTYPE".split(),
    *b"<!-- <?xml xmlns:a='b' / .. ../x".split(),
    *(b"", b" ", b"\t", b"\n", b"\r", b"\r\n\r\n", b"\0", b"\x1b[31m", b"\x7f", b"\xff", b"\xc3\xa9", b"\xe2\x80\xa8"),
    *(b"\xc2\x85", b"\xf0\x9f\xa4\x96", b"\xef\xbb\xbf", b"[bold red]", b"a[/]b", b"a: b", b"x" * 300, b"9" * 400),
    *(b"[" * 60, b"- " * 60),
)

Edit = Callable[[bytes, Random, Sequence[bytes]], bytes]


def mutate(content: bytes, seed: int, seeds: Sequence[bytes], longest: int) -> bytes:
    """A mutant of a text.

    Args:
        content: The text.
        seed: Fixes the mutant.
        seeds: Other texts of its kind, to take lines and words from.
        longest: Bytes that it may have.
    """
    rng = Random(seed)
    if rng.random() < AFRESH:
        content = rng.choice(seeds)
    for _ in range(rng.choice(EDITS)):
        content = rng.choice(_CHOICE)(content, rng, seeds)
    return content[:longest]


def _word_from(rng: Random, texts: Sequence[bytes]) -> bytes:
    """A hostile word, or one of a text's own."""
    if rng.random() < 0.4:
        return rng.choice(HOSTILE)
    text = rng.choice(texts)
    found = WORD.search(text, rng.randrange(len(text) + 1))
    return found.group() if found else b"0"


def _span(content: bytes, rng: Random) -> tuple[int, int]:
    """Where some word stands."""
    found = WORD.search(content, rng.randrange(len(content) + 1)) or WORD.search(content)
    return found.span() if found else (0, 0)


def _replace_word(content: bytes, rng: Random, seeds: Sequence[bytes]) -> bytes:
    start, stop = _span(content, rng)
    return content[:start] + _word_from(rng, (*seeds, content)) + content[stop:]


def _other_number(content: bytes, rng: Random, seeds: Sequence[bytes]) -> bytes:
    """A number replaced by one that is near, far or absurd."""
    found = NUMBER.search(content, rng.randrange(len(content) + 1))
    if found is None:
        return content
    number = b"%.*g" % (
        rng.choice((1, 3, 17)),
        rng.choice((-1, 1)) * 10.0 ** rng.choice((rng.gauss(0, 1), rng.uniform(-320, 308))),
    )
    whole = b"%d" % rng.choice((0, 1, 2, 3, rng.randrange(100), 2**31, 2**63, 10**20))
    return content[: found.start()] + rng.choice((number, whole, b"-" + found.group())) + content[found.end() :]


def _drop_word(content: bytes, rng: Random, seeds: Sequence[bytes]) -> bytes:
    start, stop = _span(content, rng)
    return content[:start] + content[stop:]


def _insert_word(content: bytes, rng: Random, seeds: Sequence[bytes]) -> bytes:
    _, stop = _span(content, rng)
    between = rng.choice((b" ", b", ", b": ", b"=", b"\n", b""))
    return content[:stop] + between + _word_from(rng, (*seeds, content)) + content[stop:]


def _wrap_word(content: bytes, rng: Random, seeds: Sequence[bytes]) -> bytes:
    start, stop = _span(content, rng)
    before, after = rng.choice(
        (
            (b"[", b"]"),
            (b"{a: ", b"}"),
            (b"'", b"'"),
            (b'"', b'"'),
            (b"- ", b""),
            (b"-", b""),
            (b"<a>", b"</a>"),
            (b"&#x", b";"),
        )
    )
    return content[:start] + before + content[start:stop] + after + content[stop:]


def _swap_words(content: bytes, rng: Random, seeds: Sequence[bytes]) -> bytes:
    (a, b), (c, d) = sorted((_span(content, rng), _span(content, rng)))
    return content if b > c else content[:a] + content[c:d] + content[b:c] + content[a:b] + content[d:]


def _rename(content: bytes, rng: Random, seeds: Sequence[bytes]) -> bytes:
    """One word replaced wherever it stands: what refers to it goes with it."""
    start, stop = _span(content, rng)
    return content.replace(content[start:stop], _word_from(rng, (*seeds, content))) if stop > start else content


def _block(lines: Sequence[bytes], rng: Random) -> slice:
    start = rng.randrange(len(lines))
    return slice(start, start + rng.choice((1, 1, 1, 2, 4)))


def _edit_lines(content: bytes, rng: Random, seeds: Sequence[bytes]) -> bytes:
    """Lines dropped, doubled, moved, shifted right or left, or taken from another text."""
    lines = content.split(b"\n")
    block = _block(lines, rng)
    taken, what = lines[block], rng.randrange(6)
    if what == 0:
        lines[block] = []
    elif what == 1:
        lines[block] = taken * rng.choice((2, 2, 2, 20))
    elif what == 2:
        lines[block] = []
        there = rng.randrange(len(lines) + 1)
        lines[there:there] = taken
    elif what == 3:
        lines[block] = [b"  " + line for line in taken]
    elif what == 4:
        lines[block] = [line.removeprefix(b"  ") for line in taken]
    else:
        others = rng.choice(seeds).split(b"\n")
        lines[block.start : block.start] = others[_block(others, rng)]
    return b"\n".join(lines)


def _edit_column(content: bytes, rng: Random, seeds: Sequence[bytes]) -> bytes:
    """A column of a csv dropped, doubled, moved or filled with one word; the header may be kept."""
    rows = [line.split(b",") for line in content.split(b"\n")]
    k, there, what = rng.randrange(len(rows[0])), rng.randrange(len(rows[0]) + 1), rng.randrange(4)
    word, first = _word_from(rng, (*seeds, content)), rng.randrange(2)
    for row in rows[first:]:
        if len(row) <= k:
            continue
        if what == 0:
            del row[k]
        elif what == 1:
            row.insert(there, row[k])
        elif what == 2:
            row.insert(there, row.pop(k))
        else:
            row[k] = word
    return b"\n".join(b",".join(row) for row in rows)


# Those that go deepest stand twice.
_CHOICE: tuple[Edit, ...] = (
    *(_replace_word, _replace_word, _other_number, _other_number, _edit_lines, _edit_lines),
    *(_drop_word, _insert_word, _wrap_word, _swap_words, _rename, _edit_column),
)
