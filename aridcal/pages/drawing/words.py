"""Words of the report: errors, readings and effects, and what to measure to separate two confounded effects."""

from __future__ import annotations

import datetime
import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from aridcal.engine.corrections.effect import ROW_ORDER, Effect
from aridcal.engine.instruments.channels import INCLINATION, Channels
from aridcal.engine.robot.chain import Robot
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search.noise_causes import NoiseCause
from aridcal.engine.search.noise_shapes import NoiseShape
from aridcal.engine.trust.certainty import Certainty
from aridcal.engine.trust.tolerance import CONFIDENCE, SHARE, ToleranceAnswer
from aridcal.files.purposes import About
from aridcal.jobs.calibrate.controllers import ControllerExports
from aridcal.jobs.calibrate.instrument_results import known_scale_sigma, scale_std
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.system.errors import printable, shortened
from aridcal.system.wording import SHOWN_UNIT, enumeration, fixed, number, plus_minus, shown_unit

# Correlation of two columns from which the reader is told: beyond it less than 1 - 0.8^2 = 36 % of the variance of
# one is its own.
LEAST_CORRELATION_SAID = 0.8

# Share of the position's variance from which readings are most of what scatters.
MAIN_SHARE = 0.5

# Measured columns: what they are, and how to change one while all else stays the same.
COVARIATE_WORDS = {
    ROW_ORDER: ("the order of the rows", "repeat the same configurations after it, in another order"),
    "time": ("time", "repeat the same configurations hours later, in another order"),
    "temperature": ("temperature", "measure the same configurations cold and warm"),
    "payload": ("the payload", "measure the same configurations with and without payload"),
}

# Computed loads, by the end of their names.
LOAD_WORDS = {
    "gravity_torque": "the gravity load on {}",
    "gravity_moment": "the gravity moment on the bearing of {}",
    "payload_torque": "the payload's load on {}",
}


NOT_STATED_WORDS = "not stated"

LONGEST_SHOWN_NAME = 40
"""Characters of a name from a file that are shown beside what users state."""


def printable_name(name: str) -> str:
    """A name from a file, fit to be shown."""
    return shortened(printable(name), LONGEST_SHOWN_NAME)


def certificate_subject(about: About, robot: Robot, m: Dataset) -> Iterator[tuple[str, str]]:
    """Which robot was measured with what, by whom and when: names and what they are."""
    yield "Robot", about.robot or printable_name(robot.tree.name)
    yield "Serial number", about.serial_number or NOT_STATED_WORDS
    serial = f", serial number {about.instrument_serial}" if about.instrument_serial else ""
    yield "Instrument", f"{about.instrument or NOT_STATED_WORDS}{serial}"
    yield "Measured by", ", ".join(filter(None, (about.who, about.organisation))) or NOT_STATED_WORDS
    yield "Measured on", about.date or _date_of_files(m)


def _date_of_files(m: Dataset) -> str:
    """That nobody stated a date, and that of the newest file of measurements: a copy has the date of the copying."""
    times = [path.stat().st_mtime for path in m.origin.files if path.is_file()]
    if not times:
        return NOT_STATED_WORDS
    return f"{NOT_STATED_WORDS} (newest file: {datetime.date.fromtimestamp(max(times)).isoformat()})"


def sigmas_in_words(sigma: np.ndarray, channels: Channels, times: float = 1.0) -> str:
    """A multiple of one value for each channel, shape (C,), in words: ``0.1 mm and 0.2 mrad``; nothing of those with NaN."""
    sigmas = [(c, float(s)) for c, s in zip(channels, sigma, strict=True) if not (c.inner or math.isnan(s))]
    shown = [f"{number(times * c.scale * s)} {c.shown}" for c, s in sigmas]
    return enumeration(shown)


NOT_FOR_A_CONTROLLER = (
    "Not for a controller: too few rows for a model of this size, and elsewhere it may be worse than the nominal robot. Measure "
    "more rows first."
)
"""What a result says first that has too few data."""


def noise_unknown_in_words(outcome: Outcome) -> str:
    """That nothing is left which these rows can show, where nobody knows the instrument's noise."""
    scatter = noise_in_words(outcome, outcome.stage("final").fit.estimated)
    return f"nothing repeatable is left that these rows can show; whether {scatter} is the instrument's noise, nobody has said"


def noise_in_words(outcome: Outcome, sigma: np.ndarray) -> str:
    """Noise of each channel, shape (C,), in words: ``0.17 mm over three axes``, of several instruments that of each number."""
    if outcome.measurements.direct:
        return f"{sigmas_in_words(sigma, outcome.channels, math.sqrt(3))} over three axes"
    return f"{sigmas_in_words(sigma, outcome.channels)} {per_number(outcome)}"


def at_target_in_words(outcome: Outcome, k: int, mask: np.ndarray) -> str:
    """What the final error of a channel is at the target, as a sentence; empty where it is a length there already.

    Args:
        outcome: What was found.
        k: Number of the channel.
        mask: Rows that are asked about, shape (N,).
    """
    channel = outcome.channels[k]
    if channel.unit in ("m", "rad") or channel.inner:
        return ""
    size = np.linalg.norm(outcome.at_target.shift(outcome.stages[-1].residual)[mask], axis=1)
    size = size[~np.isnan(size)]
    if not len(size):
        return ""
    rms = number(1e3 * float(np.sqrt(np.mean(size**2))))
    return f" At the target that is {rms} mm RMS: each error times the distance over the focal length."


def per_number(outcome: Outcome) -> str:
    """What a sigma is of."""
    return (
        "per axis"
        if all(channel.size == 3 for channel in outcome.channels if not channel.inner)
        else "in each number read"
    )


def scale_in_words(outcome: Outcome) -> tuple[str, ...]:
    """How well the scale is known, where no instrument measures lengths itself; empty where one does."""
    m = outcome.measurements
    sigma = known_scale_sigma(m)
    if sigma is None:
        return ("scale: none of these rows measures a length or a place; the arm's lengths stay nominal",)
    if np.isinf(sigma):
        consistent = "scale: unknown, for no length is: this is consistency, not accuracy"
        return (f"{consistent}. A known distance between two points or markers gives it",)
    if sigma == 0.0:
        return ()
    sigma_of_reach = scale_std(outcome.stages[-1].fit, m.fitted)
    rows = "" if sigma_of_reach is None else f" ± {number(1e3 * sigma_of_reach, 2)} mm per m of reach;"
    return (f"scale: known to{rows} the known lengths alone allow ± {number(1e3 * sigma, 2)} mm per m",)


def next_command(outcome: Outcome, handover: ControllerExports, folder: str) -> str:
    """The command that corrects a program by a result; empty where that helps no controller.

    It helps none where data are few, the model is no better than the nominal one, or no place was measured.

    Args:
        outcome: The calibration.
        handover: What controllers can be given of it.
        folder: Where the result is.
    """
    nominal, *_, full = (export.error for export in handover.exports)
    if not outcome.verdict.for_controller or not full < nominal or handover.channel.name == INCLINATION.name:
        return ""
    ending = "nc" if set(outcome.robot.kinds) == {"prismatic"} else "script"
    limb = f" --of {outcome.robot.tip}" if outcome.robot.others else ""
    return f"aridcal compensate {folder} program.{ending} -o corrected.{ending}{limb}"


def tolerance_in_words(outcome: Outcome, asked: bool) -> list[tuple[bool, str]]:
    """What the region keeps within, of the position and of the rotation: whether that is good, and the sentence.

    Args:
        outcome: What was found.
        asked: Of what a tolerance was given for; else of the rest.
    """
    certainty = outcome.certainty
    parts = () if certainty is None else certainty.tolerances
    of_these = [part for part in parts if asked == (part.tolerance is not None)]
    if asked and not outcome.verdict.for_controller:
        return [
            (False, f"{part.of.capitalize()} within the tolerance: nobody can say, with so few rows.")
            for part in of_these
        ]
    return [_kept(part, certainty) for part in of_these if certainty]


def _kept(part: ToleranceAnswer, certainty: Certainty) -> tuple[bool, str]:
    """Whether the region keeps one quantity, position or rotation, within its bound, and the sentence on it."""
    unit, share, sure = "mrad" if part.of == "rotation" else "mm", f"{100 * SHARE:.0f} %", f"{100 * CONFIDENCE:.0f} %"
    where, bound = f"in {share} of {certainty.title}", f"{number(1e3 * part.bound)} {unit}"
    off = f"off by less than {bound} without the instrument's noise"
    if part.tolerance is None:
        if math.isinf(part.bound):
            return False, f"How far off the target's {part.of} is {where} cannot be said: {part.gap}."
        return True, f"In{where[2:]} the target's {part.of} is {off}, with {sure} confidence."
    tolerance = f"within the tolerance of {number(1e3 * part.tolerance)} {unit} {where}"
    rows = f" {part.rows_within:,} of {part.rows:,} {part.judges} read less, the instrument's noise included." * (
        part.rows > 0
    )
    if part.within:
        return True, f"{part.of.capitalize()} {tolerance}, with {sure} confidence: it is {off} there.{rows}"
    return False, f"{part.of.capitalize()} not {tolerance}: {'; '.join(part.reasons)}.{rows}"


def causes_in_words(outcome: Outcome) -> str:
    """What scatters beyond the instrument's channels, as sentences; nothing where nothing was found."""
    further = () if outcome.causes is None else outcome.causes.further
    joints = [c for c in further if c.kind == "joint"]
    said = [_joints_that_scatter(joints, outcome.channels)] if joints else []
    for c in further:
        unit, times = ("mm per m", 1e3) if c.unit == "m/m" else shown_unit(c.unit)
        value = plus_minus(times * c.value, times * c.std)
        if c.kind == "range":
            said.append(f"The {c.name} noise grows by {value} {unit} from the origin of the world frame.")
        if c.kind == "length":
            said.append(f"The {c.name} noise grows by {value} {unit} that is read.")
        if c.kind == "sight":
            said.append(f"About the line of sight from there the measured {c.name} scatters by {value} {unit} more.")
        if c.kind == "repeatability":
            said.append(
                f"Beside the noise that the rows state, the {c.name} scatters by {value} {unit} per axis in all of them alike: "
                "what the arm itself repeats by, or what the rows leave unsaid of their instrument."
            )
        if c.shape is not None:
            said.append(f"Part of what scatters is {_noise_of_shape(c, c.shape)}.")
        if c.rivals and c.kind != "joint":
            said.append(f"It may as well be {_either(c.rivals)}: these rows do not tell which.")
    return " ".join(said)


GROWS = {0: "", 1: ", and in proportion to the distance", 2: ", and by the square of the distance"}
"""How noise grows along lines of sight, in words, by the power."""


def _noise_of_shape(c: NoiseCause, shape: NoiseShape) -> str:
    """What lies along something, with its size and what it is likely to be."""
    unit, times = shown_unit(c.unit)
    size = f"{plus_minus(times * c.value, times * c.std)} {unit}"
    if shape.kind == "lever":
        assert shape.vector is not None
        lever = f"{number(1e3 * float(np.linalg.norm(shape.vector)))} mm"
        return f"the measured rotation ({size}), which moves the target on a lever of {lever}: a body of markers that is off it"
    axis = "" if shape.vector is None else f"({', '.join(fixed(x, 2) for x in shape.vector)})"
    if shape.kind == "direction":
        return f"{c.name} noise along {axis} of the world ({size})"
    if shape.kind == "own_axis":
        likely = ", as of a body of markers off the target" if shape.across and c.unit == "m" else ""
        return f"{c.name} noise {'across' if shape.across else 'along'} {axis} of the target ({size}){likely}"
    assert shape.point is not None
    begin = (
        "the origin of the world frame"
        if not shape.point.any()
        else f"({', '.join(fixed(x, 1) for x in shape.point)}) m"
    )
    at = f"{size} at {number(shape.typical)} m{GROWS[shape.power]}" if shape.power else size
    if shape.kind == "bearing":
        return f"{c.name} noise across the lines of sight from {begin} ({at}), as of an instrument that measures angles"
    along = f"along {axis} of the world" if axis else "along the lines of sight"
    return f"{c.name} noise {along} from {begin} ({at}), as of a camera's depth"


def _either(causes: Sequence[NoiseCause]) -> str:
    """Causes of which one may be it."""
    return " or ".join(_said_shortly(c) for c in causes)


def _said_shortly(c: NoiseCause) -> str:
    """One cause with its size."""
    if c.shape is not None:
        return _noise_of_shape(c, c.shape)
    unit, times = ("mm per m", 1e3) if c.unit == "m/m" else shown_unit(c.unit)
    size = f"{plus_minus(times * c.value, times * c.std)} {unit}"
    of = {
        "joint": f"the reading of {c.name}",
        "joints": "the readings of all revolute joints",
        "range": f"{c.name} noise that grows from the origin of the world frame",
        "sight": f"{c.name} noise about the line of sight from the origin of the world frame",
        "length": f"{c.name} noise that grows with the length",
        "repeatability": f"{c.name} noise alike in all rows",
    }
    return f"{of[c.kind]} ({size})"


def _joints_that_scatter(joints: Sequence[NoiseCause], channels: Channels) -> str:
    """A sentence on the readings of joints, those first that scatter the first channel most."""
    alike: dict[tuple[float, float, str], list[NoiseCause]] = {}
    for c in joints:
        alike.setdefault((c.value, c.std, c.unit), []).append(c)
    readings = [
        f"{enumeration([c.name for c in own])} ({plus_minus(1e3 * value, 1e3 * std)} "
        f"{SHOWN_UNIT[unit]}{' each' * (len(own) > 1)})"
        for (value, std, unit), own in alike.items()
    ]
    rivals = list({(r.kind, r.name): r for c in joints for r in c.rivals}.values())
    if rivals:
        return f"What scatters may be the reading of {', '.join(readings)}, or {_either(rivals)}: these rows do not tell which."
    share = np.sum([c.share for c in joints], axis=0)
    most = int(np.argmax(share > MAIN_SHARE)) if (share > MAIN_SHARE).any() else int(np.argmax(share))
    if len(alike) == len(joints) and joints[0].share[most] > MAIN_SHARE:
        rest = f" {'; '.join(readings[1:])} scatter less." if len(joints) > 1 else ""
        return f"Most of what scatters is the reading of {readings[0]}: were the joints read before standstill?{rest}"
    if share[most] > MAIN_SHARE:
        named = ", ".join(readings)
        advice = "were they read before standstill, or rounded in the table?"
        return f"Most of what scatters are the readings of the joints, {named}: {advice}"
    of = f"{100 * share[most]:.0f} % of the variance of the {channels[most].noun}"
    return f"Part of what scatters is the reading of {', '.join(readings)}: {of}."


def how_to_separate(a: Effect, b: Effect, robot: Robot, columns: Mapping[str, np.ndarray]) -> str:
    """A sentence on what to measure, so that two effects are no longer confounded.

    Args:
        a: The effect in the model.
        b: One that explains these data as well.
        robot: The chain that both act on.
        columns: Joint positions and measured columns of the rows, shape (N,) each.
    """
    own, other = list(a.covariates), list(b.covariates)
    only_other = [name for name in other if name not in own]
    only_own = [name for name in own if name not in other]
    for changing, kept in ((only_other, own), (only_own, other)):
        if changing:
            return _change_one(changing[0], kept, columns)
    follows = " and ".join(_words(name)[0] for name in own)
    between = _joints_between(a.where, b.where, robot, own)
    if between:
        return f"both depend on {follows}: at the same {follows}, turn {', '.join(between)} widely; they lie between the two."
    return (
        f"both depend on {follows} and act at the same place; only their shapes differ. Measure more of the range of "
        f"{follows}, in smaller steps."
    )


def _change_one(change: str, names: Sequence[str], columns: Mapping[str, np.ndarray]) -> str:
    """How to change one covariate while others stay the same."""
    what, how = _words(change)
    stays = " and ".join(_words(name)[0] for name in names)
    correlated = _correlated(change, names, columns)
    return f"measure rows in which {what} changes while {stays} stays the same: {how}{correlated}."


def _joints_between(a: str, b: str, robot: Robot, but: Sequence[str]) -> list[str]:
    """Joints between two places on the chain, without those named."""
    names = list(robot.names)
    first, last = sorted(_place(where, names) for where in (a, b))
    return [name for name in names[first:last] if name not in but]


def _place(where: str, names: list[str]) -> int:
    """Where on the chain: 0 before the first joint."""
    if where in names:
        return names.index(where) + 1
    return 0 if where == "world_base" else len(names) + 1


def _words(name: str) -> tuple[str, str]:
    """A covariate in words, and how to change it."""
    joint, _, load = name.rpartition(".")
    for ending, words in LOAD_WORDS.items():
        if joint and load.startswith(ending):
            return words.format(joint), f"keep {joint} where it is, and stretch, fold or load the arm beyond it"
    if name.endswith("_direction"):
        joint = name.removesuffix("_direction")
        return f"the direction in which {joint} approached", "reach the same configurations from both sides"
    for column, (words, how) in COVARIATE_WORDS.items():
        if name == column:
            return words, how
        if name.startswith(f"{column}_"):
            return name, how
    return name, f"move {name} over its range, in each of a few configurations of the other joints"


def _correlated(change: str, names: Sequence[str], columns: Mapping[str, np.ndarray]) -> str:
    """A clause on the column that went together with the one to be changed in these data."""
    for name in names:
        if change in columns and name in columns:
            with np.errstate(invalid="ignore"):
                r = float(np.corrcoef(columns[change], columns[name])[0, 1])
            if abs(r) > LEAST_CORRELATION_SAID:
                return f" (in these data the two are correlated: r = {r:.2f})"
    return ""
