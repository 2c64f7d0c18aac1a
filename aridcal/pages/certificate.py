"""The certificate: one dated page of what was calibrated, how well, and where it holds; the maker's own record."""

from __future__ import annotations

import datetime
import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aridcal import __version__
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.trust.iso9283 import STANDARD
from aridcal.engine.trust.tolerance import CONFIDENCE, SHARE
from aridcal.files.purposes import About
from aridcal.jobs.calibrate.instrument_results import known_scale_sigma
from aridcal.jobs.calibrate.key_figures import (
    constants,
    every_held_out_row,
    scored,
    sigma_and_error,
    verification_agreement,
)
from aridcal.jobs.calibrate.outcome import Outcome, errors
from aridcal.jobs.calibrate.saving import ends, fitted_values, holes
from aridcal.jobs.calibrate.verdict import VERDICTS
from aridcal.pages.drawing.html import attempt, collect_notices, note
from aridcal.pages.drawing.one_page import OnePage, Part, as_html, as_pdf
from aridcal.pages.drawing.words import (
    LONGEST_SHOWN_NAME,
    NOT_STATED_WORDS,
    certificate_subject,
    noise_unknown_in_words,
    printable_name,
    scale_in_words,
)
from aridcal.pages.report.iso_section import cycles_in_words, lines
from aridcal.system.errors import printable, shortened
from aridcal.system.wording import number, plural, range_in_words

CERTIFICATE_FILES = ("certificate.html", "certificate.pdf")

OWN = (
    "Computed by aridcal {} from measurements of those who are named below. It is not issued by an accredited laboratory, and is "
    "no proof of traceability."
)

COVERAGE = 2.0
"""Coverage factor k: for normal noise 95 % of one direction's errors are within two standard deviations."""

MOST_LISTED_JOINTS = 24
"""Joints whose ranges are stated; an arm has seven."""

MOST_COVARIATES, MOST_GAPS = 8, 8
"""Other quantities, and gaps, that are named."""

MOST_LACKING = 24
"""Characters without a font that are named."""

MOST_REASONS = 3
"""Reasons of the verdict that are stated; the report has all."""

LONGEST_REASON, LONGEST_SENTENCE = 200, 400
"""Characters of a reason that are shown, and of a sentence with a file's name in it."""

MOST_CHANNELS = 8
"""Quantities whose errors are stated; a campaign of several instruments has two or three."""

MODELS = "Before: the nominal URDF with only the unknown frames fitted. After: the calibrated model."

LIMITS_SENTENCE = (
    "Outside these ranges the model extrapolates. It holds for the robot as it was measured: not after a collision, a change of "
    "motor, gear or encoder, nor for loads and temperatures that were not measured."
)

HASHED = ("calibrated.urdf", "calibration.yaml")
"""Files of the result that the certificate identifies by their hash."""


def write_certificate(outcome: Outcome, folder: Path, issued: datetime.date) -> tuple[str, ...]:
    """Write the certificate as HTML and as PDF where the campaign has ``about``.

    Args:
        outcome: What was found.
        folder: Of the result, whose other files are there already.
        issued: Date of issue.

    Returns:
        Notices: what could not be drawn, and why.
    """
    about = outcome.campaign.about
    if about is None:
        return ()
    with collect_notices() as notices:
        texts = attempt("the certificate", lambda: _drawn(certificate(outcome, about, folder, issued)), lambda _: {})
    for name, content in texts.items():
        (folder / name).write_bytes(content)
    return tuple(notices)


def _drawn(page: OnePage) -> dict[str, bytes]:
    """The files of the certificate by their names."""
    html = as_html(page).encode("utf-8", "replace")
    content, lacking = as_pdf(page)
    if lacking:
        note(
            f"certificate.pdf: no font of this computer has {shortened(lacking, MOST_LACKING)}: boxes stand there. Install a "
            "font that has them (Noto Sans CJK, for instance), or use certificate.html"
        )
    return dict(zip(CERTIFICATE_FILES, (html, content), strict=True))


def certificate(outcome: Outcome, about: About, folder: Path, issued: datetime.date) -> OnePage:
    """What the certificate says.

    Args:
        outcome: What was found.
        about: What the campaign states.
        folder: Where the files are that it identifies.
        issued: Date of issue.
    """
    unknown = outcome.verdict.noise_unknown
    verdict = noise_unknown_in_words(outcome) if unknown else VERDICTS[outcome.verdict.word].sentences.partition(".")[0]
    judged, target = _judged(outcome), _known(outcome)
    reference = f"No. {about.certificate_number}. " if about.certificate_number else ""
    return OnePage(
        title="Calibration certificate: the maker's own record",
        under=OWN.format(__version__),
        headline=[
            *(
                (f"{j.noun}, RMS", f"before {number(j.before['rms'])}, after {number(j.after['rms'])} {j.unit}")
                for j in judged
            ),
            (f"Uncertainty, k = {COVERAGE:g}", _in_short(target)),
            *_tolerances(outcome),
            ("Verdict", f"{verdict}."),
        ],
        parts=[
            Part("Robot and measurement", facts=list(_facts(outcome, about))),
            _errors(outcome, judged),
            Part("Uncertainty of the calibrated target", words=[_uncertainty(outcome, target)]),
            Part("Where it is valid", facts=list(_validity(outcome)), words=[LIMITS_SENTENCE]),
            *_iso(outcome),
            Part("Files", table=[("file", "sha256"), *_hashes(outcome, folder)]),
        ],
        foot=f"{reference}Issued on {issued.isoformat()}. aridcal {__version__}.",
        boxes="Boxes stand for characters that no font of the computer has which made this file; certificate.html has them.",
    )


@dataclass(frozen=True)
class _Judged:
    """A channel with its errors before and after calibration, as they are shown.

    Attributes:
        noun: What an error of it is called.
        unit: Of its errors.
        rows: How many rows were scored.
        before: Statistics with the nominal model.
        after: With the final one.
    """

    noun: str
    unit: str
    rows: int
    before: dict[str, float]
    after: dict[str, float]


def _judged(outcome: Outcome) -> list[_Judged]:
    """Every channel that judges the arm, of many the first."""
    mask, _ = scored(outcome)
    scores = []
    for k, channel in enumerate(outcome.channels):
        own = mask & outcome.measurements.measures[:, k]
        if not channel.inner and own.any():
            first, last = (
                errors(outcome.stage(name).residual, own, outcome.channels)[channel.key]
                for name in ("nominal", "final")
            )
            noun = printable_name(f"{channel.noun[0].upper()}{channel.noun[1:]}")
            scores.append(_Judged(noun, channel.shown, int(own.sum()), first, last))
    return scores[:MOST_CHANNELS]


def _facts(outcome: Outcome, about: About) -> Iterator[tuple[str, str]]:
    """Who measured what, when and how."""
    m, robot = outcome.measurements, outcome.robot
    yield from certificate_subject(about, robot, m)
    temperatures = _some(list(_temperatures(m)), MOST_COVARIATES)
    yield "Environment", "; ".join(filter(None, (about.environment, temperatures))) or NOT_STATED_WORDS
    used = f"{plural(len(m), 'row')} of {', '.join(kinds_in_words(m))}, {m.test.sum():,} of them held out"
    sought = "" if outcome.diagnosis is None else f" and {plural(len(outcome.effects), 'effect')}"
    corrections = sum(p["status"] == "identified" for p in constants(outcome))
    fitted = f"{plural(corrections, 'geometric correction')}{sought} by least squares"
    chain = f"{printable_name(robot.base)} to {printable_name(robot.tip)}"
    stated = f"{about.method.rstrip('.')}. " if about.method else ""
    yield "Method", f"{stated}{used}; {chain}; {fitted}."
    if about.notes:
        yield "Notes", about.notes


def kinds_in_words(m: Dataset) -> list[str]:
    """What the rows measure, each once."""
    if m.direct:
        return ["poses" if m.sees_turns else "positions"]
    return list(dict.fromkeys(MEASUREMENT_KINDS[block.kind].words for block in m.blocks))


def _temperatures(m: Dataset) -> Iterator[str]:
    """Measured temperatures."""
    for name, values in m.covariates.items():
        if name.startswith("temperature") and np.isfinite(values).any():
            low, high = ends(values)
            yield f"{printable_name(name)} {number(low)} to {number(high)} °C in the rows"


def _errors(outcome: Outcome, judged: Sequence[_Judged]) -> Part:
    """Errors before and after, and what they are of."""
    _, rows = scored(outcome)
    table: list[Sequence[str]] = [("", "rows", "before: RMS", "95 % below", "max", "after: RMS", "95 % below", "max")]
    for j in judged:
        numbers = [number(e[key]) for e in (j.before, j.after) for key in ("rms", "p95", "max")]
        table.append((f"{j.noun} [{j.unit}]", f"{j.rows:,}", *numbers))
    said = [MODELS]
    channels = sum(not channel.inner for channel in outcome.channels)
    if channels > len(judged):
        said.append(f"{channels - len(judged)} more quantities are in report.html.")
    if outcome.parts()["test_all"].any():
        said.append(f"{every_held_out_row(outcome)}.")
    else:
        said.append("No rows were held out: these are errors of the fit itself, and too optimistic.")
    verified = verification_agreement(outcome)
    if verified is not None:
        said.append(shortened(printable(verified[1]), LONGEST_SENTENCE))
    return Part(f"Errors before and after, on {rows}", table=table, words=[" ".join(said), *_reasons(outcome)])


def _reasons(outcome: Outcome) -> Iterator[str]:
    """Why the verdict is no better than it is."""
    verdict = outcome.verdict
    if verdict.word == "noise_floor":
        return
    rest = len(verdict.reasons) - MOST_REASONS
    more = f"; and {rest} more in report.html" if rest > 0 else ""
    share = f" {100 * verdict.share:.0f} % of the remaining variance is repeatable." if verdict.share > 0 else ""
    reasons = "; ".join(shortened(printable(reason), LONGEST_REASON) for reason in verdict.reasons[:MOST_REASONS])
    yield f"Verdict {verdict.word}: {reasons}{more}.{share} Where nothing was measured, errors may be larger than these."


@dataclass(frozen=True)
class _TargetUncertainty:
    """Expanded uncertainty of the target's position in its worst direction, [mm].

    Attributes:
        median: Over the fitted rows.
        most: The largest of them.
        anywhere: Below it are 95 % of configurations from the joints' whole range.
    """

    median: float
    most: float
    anywhere: float


def _known(outcome: Outcome) -> _TargetUncertainty | None:
    """How well the target is known; None where nothing measures its place, or no length gives its scale."""
    precision = outcome.precision
    certainty = outcome.certainty
    if (
        known_scale_sigma(outcome.measurements) in (None, math.inf)
        or not np.isfinite(precision.position).all()
        or not certainty
    ):
        return None
    median, most = (1e3 * COVERAGE * float(f(precision.position)) for f in (np.median, np.max))
    return _TargetUncertainty(median, most, 1e3 * COVERAGE * float(np.percentile(certainty.anywhere.sigma, 95)))


def _tolerances(outcome: Outcome) -> Iterator[tuple[str, str]]:
    """Each tolerance that was given, and whether it is kept."""
    certainty = outcome.certainty
    if certainty is None:
        return
    sure = f"in {100 * SHARE:.0f} % of {certainty.title}, with {100 * CONFIDENCE:.0f} % confidence"
    for part in certainty.tolerances:
        if part.tolerance is not None:
            unit = "mrad" if part.of == "rotation" else "mm"
            answer = "kept" if part.within else "cannot be said to be kept"
            yield f"Tolerance of {part.of}", f"{number(1e3 * part.tolerance)} {unit}: {answer} {sure}"


def _in_short(target: _TargetUncertainty | None) -> str:
    """The uncertainty among the figures."""
    return (
        "not known"
        if target is None
        else f"by noise alone: median {number(target.median)}, at most {number(target.most)} mm"
    )


def _uncertainty(outcome: Outcome, target: _TargetUncertainty | None) -> str:
    """Expanded uncertainty of the target, and what it leaves out."""
    scale = "".join(f" {sentence[0].upper()}{sentence[1:]}." for sentence in scale_in_words(outcome))
    if target is None:
        return f"These rows do not tell where the target is, so no uncertainty of its place can be stated.{scale}"
    agreed = None if outcome.measurements.direct else sigma_and_error(outcome)
    consistent = (
        f" The rows agree to {number(agreed[1])} mm RMS at the target: that is consistency, not accuracy."
        if agreed is not None and target.median > agreed[1]
        else ""
    )
    beyond = "" if outcome.verdict.word == "noise_floor" else " By the verdict, real errors may well exceed it."
    return (
        f"Expanded uncertainty of its position in the worst direction, k = {COVERAGE:g} (about 95 % for normal noise): median "
        f"{number(target.median)} mm, at most {number(target.most)} mm at the fitted rows; in 95 % of the joints' whole range at "
        f"most {number(target.anywhere)} mm. It is what the measurement noise makes of the calibration, and leaves out "
        "systematic errors of the instrument, the robot's own repeatability and errors that the model lacks."
        f"{consistent}{beyond}{scale}"
    )


def _validity(outcome: Outcome) -> Iterator[tuple[str, str]]:
    """Ranges of all that predictions depend on, and the gaps in them."""
    robot, ranges = outcome.robot, fitted_values(outcome)
    kinds = dict(zip(robot.readings, robot.kinds, strict=True))
    joints = [f"{printable_name(name)} {range_in_words(ends(ranges[name]), kinds[name])}" for name in robot.readings]
    yield "Joints", _some(joints, MOST_LISTED_JOINTS)
    others = [(name, *ends(values)) for name, values in ranges.items() if name not in kinds]
    if others:
        shown = [f"{printable_name(name)} {number(low)} to {number(high)}" for name, low, high in others]
        yield "Other quantities", _some(shown, MOST_COVARIATES)
    gaps = [
        f"{printable_name(name)} {range_in_words(gap, kinds[name]) if name in kinds else ' to '.join(map(number, gap))}"
        for name, values in ranges.items()
        for gap in holes(values)
    ]
    yield "Gaps in them", _some(gaps, MOST_GAPS) or "none"


def _some(items: Sequence[str], most: int) -> str:
    """Items in a line; of many the first, and how many more there are."""
    rest = len(items) - most
    return "; ".join([*items[:most], *([f"and {rest:,} more"] if rest > 0 else [])])


def _iso(outcome: Outcome) -> Iterator[Part]:
    """Figures by the definitions of ISO 9283, if there are any."""
    if outcome.iso is not None:
        head = ("", "characteristic (clause)", "worst of", "before", "after")
        yield Part(
            f"Figures by the definitions of {STANDARD}",
            table=[head, *lines(outcome.iso)],
            words=[cycles_in_words(outcome.iso)],
        )


def _hashes(outcome: Outcome, folder: Path) -> Iterator[tuple[str, str]]:
    """Files and their hashes, as ``sha256sum`` gives them."""
    campaign, m = outcome.campaign, outcome.measurements
    yield printable_name(campaign.path.name), sha256(_as_read(campaign.path, campaign.text))
    source, plain = campaign.robot.urdf.name, outcome.robot.path.name
    yield (
        printable_name(plain if source == plain else f"{source}, expanded"),
        sha256(outcome.robot.mjcf or outcome.robot.urdf),
    )
    if m.origin.sha256:
        files = [path.name for path in m.origin.files]
        one = printable_name(files[0]) if len(files) == 1 else f"{len(files)} files of measurements: {', '.join(files)}"
        yield shortened(printable(one), LONGEST_SHOWN_NAME) + _joined(m), m.origin.sha256
    for name in HASHED:
        yield name, sha256((folder / name).read_bytes())


def _joined(m: Dataset) -> str:
    """How the hash of several files is made, and what it leaves out."""
    if any(block.traits.of_head for block in m.blocks):
        return " (without its images)"
    if len(m.blocks) > 1:
        return " (of the blocks' hashes)"
    return " (one after the other)" if len(m.origin.files) > 1 else ""


def _as_read(path: Path, text: str) -> bytes:
    """Bytes of a file of settings as it was read: those on disk, unless it has changed since."""
    try:
        content = path.read_bytes()
        return content if content.decode("utf-8-sig") == text else text.encode()
    except (OSError, UnicodeDecodeError):
        return text.encode()


def sha256(content: bytes) -> str:
    """Hash of some bytes."""
    return hashlib.sha256(content).hexdigest()
