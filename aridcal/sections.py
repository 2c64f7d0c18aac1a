"""The questions that a report answers, in their order, one function each; the fifth has its own module."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from aridcal.markup import Content, Html, bullets, counted, figures, fixed, number, table, tag
from aridcal.outcome import Outcome, Stage, errors, statistics
from aridcal.plots import coverage, field, histogram, panels
from aridcal.quality import accuracy, joint_kinds, joint_limits

ERRORS = {"position_mm": "position error [mm]", "rotation_mrad": "rotation error [mrad]"}
AXES = ("x [mm]", "y [mm]", "z [mm]", "rx [mrad]", "ry [mrad]", "rz [mrad]")
PARTS = {"test": "never used", "train": "fitted", "test_all": "never used, outliers too"}
PLUS = "+\u00a0"
MOST = 25  # lines of a list of rows
QUESTIONABLE = 0.03  # share of outliers above which the data are to blame, not the rows


def scored(outcome: Outcome) -> tuple[np.ndarray, str]:
    """Rows on which the calibration is judged, and what they are: those never used, if there are any."""
    parts = outcome.parts()
    return (parts["test"], "rows never used") if parts["test"].any() else (parts["train"], "rows that were fitted")


def distinct(outcome: Outcome) -> list[tuple[str, Stage]]:
    """The stages by name; neighbours that leave the same residual share a name."""
    found: list[tuple[str, Stage]] = []
    for stage in outcome.stages:
        name = stage.name
        if found and np.array_equal(found[-1][1].residual, stage.residual):
            name = f"{found.pop()[0]} = {name}"
        found.append((name, stage))
    return found


def steps(outcome: Outcome) -> list[tuple[str, np.ndarray]]:
    """From the nominal robot to the final model, one effect at a time: a name and all rows' residuals, shape (N, m)."""
    residuals = {s.name: s.residual for s in outcome.stages}
    for e in outcome.effects[:-1]:
        residuals[f"{PLUS}{e.effect.label}"] = e.reached
    final = residuals.pop("final")
    residuals[f"{PLUS}{outcome.effects[-1].effect.label} = final" if outcome.effects else "final"] = final
    found: list[tuple[str, np.ndarray]] = []
    for name, residual in residuals.items():
        if found and np.array_equal(found[-1][1], residual):
            name = f"{found.pop()[0]} = {name}"
        found.append((name, residual))
    return found


def data(outcome: Outcome) -> Iterator[Content]:
    """1: is the data sound?"""
    m, parts = outcome.measurements, outcome.parts()
    flagged, refused = int(outcome.outlier.sum()), len(m.refused)
    split = "as the table says" if m.split_given else "drawn by configuration, alike at each run"
    counts = {
        "read": len(m) + refused,
        "refused, because they cannot be used": refused,
        "flagged as outliers: neither fitted nor counted": flagged,
        "stale: measurement not renewed though the joints moved": int(outcome.stale.sum()),
        "fitted": int(parts["train"].sum()),
        f"never used, to judge the result ({split})": int(parts["test"].sum()),
    }
    files = ", ".join(path.name for path in m.files)
    yield table(["rows", "number"], [[what, f"{count:,}"] for what, count in counts.items()], f"Rows of {files}")
    if flagged > QUESTIONABLE * len(m):
        yield tag(
            "p",
            f"{100 * flagged / len(m):.0f} % of the rows are outliers. More than 3 % questions the measurement itself: "
            "look for a loose target, a late trigger, mixed-up files or a joint in the wrong unit first.",
            class_="look",
        )
    yield _repeats(outcome)
    if flagged:
        yield _flagged(outcome)
    if refused:
        yield tag("h3", "Refused rows")
        yield bullets([str(remark) for remark in m.refused], MOST, "more; result.json names them all")
    if outcome.notices:
        yield tag("h3", "Notices")
        yield bullets(outcome.notices, MOST, "more; result.json names them all")


def _repeats(outcome: Outcome) -> Html:
    found = outcome.repeats
    if found is None:
        return tag(
            "p",
            "No configuration was measured twice, so nothing here tells the noise of robot and instrument from what "
            "the model lacks. Repeat a few poses next time.",
        )
    turn = f" and {number(1e3 * found.sigma.rotation)} mrad" if outcome.measurements.quaternion is not None else ""
    return tag(
        "p",
        f"{counted(found.groups, 'configuration')} measured more than once ({counted(found.rows, 'row')}). "
        f"Repeats scatter by {number(1e3 * found.sigma.position)} mm{turn} (1-sigma per axis). "
        "Repeatability RP as in ISO 9283, mean distance to the centre plus three standard deviations: "
        f"{number(1e3 * found.repeatability)} mm. No calibration can get below the repeats' scatter.",
    )


def _flagged(outcome: Outcome) -> list[Content]:
    rows = np.flatnonzero(outcome.outlier)
    why = ["stale" if outcome.stale[k] else "gross outlier" for k in rows]
    found: list[Content] = [_row_table(outcome, rows[:MOST], "why", why, "Outliers, after calibration")]
    if len(rows) > MOST:
        found.append(tag("p", tag("em", f"and {len(rows) - MOST:,} more; residuals.csv flags them all")))
    return found


def _row_table(outcome: Outcome, rows: np.ndarray, head: str, words: list[str], caption: str) -> Html:
    """Some rows, how far the final model misses them, and a word on each."""
    m, last = outcome.measurements, outcome.stages[-1].residual
    off = norms(last[rows])
    lines = [
        [
            f"{m.files[m.file[k]].name}, line {m.line[k]}",
            "never used" if m.test[k] else "fitted",
            word,
            *(number(values[i]) for values in off),
        ]
        for i, (k, word) in enumerate(zip(rows, words, strict=False))
    ]
    return table(["row", "part", head, *list(ERRORS.values())[: len(off)]], lines, caption, numbers=3)


def norms(residual: np.ndarray) -> list[np.ndarray]:
    """Position error [mm] and, for poses, rotation error [mrad] of each row."""
    return [1e3 * np.linalg.norm(residual[:, k : k + 3], axis=1) for k in range(0, residual.shape[1], 3)]


def separable(outcome: Outcome) -> Iterator[Content]:
    """2: what can be told apart?"""
    fit = outcome.stage("geometric").fit
    fits = {name: stage.fit for name, stage in distinct(outcome) if stage.name != "nominal"}
    facts = {
        "coefficients asked for": [f"{len(f.candidates):,}" for f in fits.values()],
        "identified (the rank)": [f"{len(f.theta):,}" for f in fits.values()],
        "condition number, each column scaled to length 1": [number(f.convergence.condition) for f in fits.values()],
        "steps to the minimum": [f"{f.convergence.steps:,}" for f in fits.values()],
        "step that the gradient still asks for, in sigmas": [number(f.convergence.gradient, 2) for f in fits.values()],
        "other starts that led to the same minimum": [
            f"{f.convergence.agreed} of {f.convergence.restarts}" if f.convergence.restarts else "none tried"
            for f in fits.values()
        ],
    }
    found: list[list[Content]] = [[what, *values] for what, values in facts.items()]
    yield table(["solution", *fits], found, "How the minimum was found")
    if not fit.redundant:
        yield tag("p", "Everything that was asked for can be told apart.")
        return
    yield tag(
        "p",
        f"{counted(len(fit.redundant), 'coefficient')} cannot be told from others by these measurements. They keep "
        "their nominal values, and the ones named beside them carry the sum. At the target nothing is lost.",
    )
    lines = [[tag("code", name), _partners(names)] for name, names in fit.redundant.items()]
    yield table(["keeps its nominal value", "cannot be told from"], lines, "Redundant coefficients", numbers=2)


def _partners(names: tuple[str, ...], most: int = 6) -> Content:
    if not names:
        return "anything: it hardly moves the target"
    shown = [part for name in names[:most] for part in (", ", tag("code", name))][1:]
    return [*shown, f" and {len(names) - most} more" if len(names) > most else ""]


@dataclass(frozen=True)
class JointRange:
    """Where a joint was measured.

    Attributes:
        name: Of the joint.
        limits: In words.
        seen: The range measured, in words.
        share: Its readings: 0 at the lower limit, 1 at the upper one.
        measured: Share of the range that lies between the readings; of one turn where the range is larger.
    """

    name: str
    limits: str
    seen: str
    share: np.ndarray
    measured: float


def _joint_ranges(outcome: Outcome) -> list[JointRange]:
    m, robot = outcome.measurements, outcome.robot
    used = m.readings[~m.test & ~outcome.outlier]
    found = []
    for name, kind, limits, q in zip(robot.readings, joint_kinds(robot), joint_limits(robot), used.T, strict=True):
        if kind == "continuous":
            q, limits = np.angle(np.exp(1j * q)), np.array([-np.pi, np.pi])
        limited = bool(np.isfinite(limits).all())
        low, high = limits if limited else (q.min(), q.max())
        words = _between(low, high, kind) if limited else "no limits"
        share = np.clip((q - low) / (high - low if high > low else 1.0), 0, 1)
        whole = high - low if kind == "prismatic" else min(high - low, 2 * np.pi)
        measured = min(float(np.ptp(q)) / whole, 1.0) if whole > 0 else 0.0
        found.append(JointRange(name, words, _between(q.min(), q.max(), kind), share, measured))
    return found


def _between(low: float, high: float, kind: str) -> str:
    return f"{_reading(low, kind)} … {_reading(high, kind)}"


def _reading(value: float, kind: str) -> str:
    return f"{fixed(value, 3)} m" if kind == "prismatic" else f"{fixed(math.degrees(value), 0)}°"


def narrow(outcome: Outcome) -> list[JointRange]:
    """Joints of which less than half of the range, or of one turn, was measured."""
    return [j for j in _joint_ranges(outcome) if j.measured < 0.5]


def enough(outcome: Outcome) -> Iterator[Content]:
    """3: is there enough data, in the right places?"""
    precision, joints = outcome.precision, _joint_ranges(outcome)
    in_mm = {"at the rows fitted": 1e3 * precision.position, "over the whole joint range": 1e3 * precision.reach}
    label = "1-sigma of the target, worst direction [mm]"
    shares = coverage(
        "coverage",
        "Histogram of each joint's readings between its limits",
        [j.name for j in joints],
        [j.share for j in joints],
        [j.limits for j in joints],
    )
    sigma = histogram("precision", f"Histogram of the {label}", in_mm, label)
    yield figures([
        ("Where each joint was measured, between its limits", shares),
        ("How well the calibrated target is known: the noise carried through to it", sigma),
    ])  # fmt: skip
    lines = [[tag("code", j.name), j.limits, j.seen, f"{100 * j.measured:.0f} %"] for j in joints]
    yield table(
        ["joint", "limits", "measured", "of the range, or of one turn"], lines, "Joint ranges of the rows fitted"
    )
    sigmas = {f"{name} [mm]": values for name, values in in_mm.items()}
    if outcome.measurements.quaternion is not None:
        sigmas["rotation, at the rows fitted [mrad]"] = 1e3 * precision.rotation
    chosen = [
        [name, *(number(statistics(values)[s]) for s in ("median", "p95", "max"))] for name, values in sigmas.items()
    ]
    yield table(["", "median", "95 % below", "max"], chosen, "1-sigma of the calibrated target in its worst direction")
    yield tag(
        "p",
        "This is what the noise of these measurements leaves open. It does not cover effects that the model lacks: "
        "sections 4 and 5 look for those.",
    )


def fits(outcome: Outcome) -> Iterator[Content]:
    """4: does the model fit?"""
    mask, words = scored(outcome)
    yield from _stage_tables(outcome)
    first, last = outcome.stages[0].residual[mask], outcome.stages[-1].residual[mask]
    names = {"before calibration": first, "after": last}
    yield tag("h3", f"Before and after, on {words}")
    drawn = []
    for k, (key, what) in enumerate(list(ERRORS.items())[: first.shape[1] // 3]):
        pair = {name: norms(residual)[k] for name, residual in names.items()}
        alt = f"Histogram of the {what} before and after calibration"
        drawn.append((what.capitalize(), histogram(key, alt, pair, what)))
    yield figures(drawn)
    yield _iso(outcome, mask, words)
    yield _halves(outcome)

    yield tag("h3", "Axis by axis")
    axes = AXES[: first.shape[1]]
    lines = [
        [name, *(number(v) for v in 1e3 * np.sqrt(np.mean(residual[mask] ** 2, axis=0)))]
        for name, residual in steps(outcome)
    ]
    yield table(["model", *axes], lines, f"RMS of the residual in the world's axes, {words}")
    order = np.arange(1.0, mask.sum() + 1)
    drawn = []
    for k, axis in enumerate(axes):
        pair = {name: 1e3 * residual[:, k] for name, residual in names.items()}
        alt = f"Residual {axis} row by row, before and after calibration"
        cloud = panels(f"axis-{k}", alt, order, pair, (f"number of the row, {words}", axis))
        drawn.append((f"Measured minus predicted: {axis}", cloud))
    yield figures(drawn)

    yield tag("h3", "Over the workspace")
    yield _workspace(outcome)
    worst = np.flatnonzero(mask)[np.argsort(-norms(last)[0], kind="stable")[:5]]
    readings = [_configuration(outcome, k) for k in worst]
    yield _row_table(outcome, worst, "configuration", readings, f"The worst of the {words}, after calibration")


def _stage_tables(outcome: Outcome) -> Iterator[Content]:
    parts = {name: mask for name, mask in outcome.parts().items() if mask.any()}
    if not (parts.get("test_all", outcome.outlier) & outcome.outlier).any():
        parts.pop("test_all", None)
    shown = {"rms": "RMS", "mean": "mean", "median": "median", "p95": "95 % below", "max": "max"}
    head = ["model"]
    for name, title in PARTS.items():
        if name in parts:
            head += [f"{title}: RMS", *list(shown.values())[1:]]
    for key, what in list(ERRORS.items())[: outcome.stages[0].residual.shape[1] // 3]:
        lines = [
            [name, *(number(errors(residual, parts[part])[key][s]) for part in PARTS if part in parts for s in shown)]
            for name, residual in steps(outcome)
        ]
        yield table(head, lines, what.capitalize())
    yield tag(
        "p",
        ["A position error is the length of a residual, a rotation error the angle of a residual rotation. "],
        [tag("code", "nominal"), " is the URDF as it came, with only the unknown frames fitted; "],
        [tag("code", "geometric"), " adds the constants, and is what ", tag("code", "calibrated.urdf"), " holds"],
        "; each line with a + adds one effect to all that stands above it, constants and effects fitted again together; "
        if outcome.effects
        else "; ",
        [tag("code", "final"), " is the whole model. Outliers are left out unless a line says otherwise."],
    )


def _iso(outcome: Outcome, mask: np.ndarray, words: str) -> Html:
    rows = outcome.measurements.select(mask)
    lines = []
    for name, residual in steps(outcome):
        found = statistics(1e3 * accuracy(outcome.robot, rows, residual[mask]))
        lines.append([name, *(number(found[s]) for s in ("mean", "p95", "max"))])
    caption = f"Pose accuracy AP [mm] as in ISO 9283, {words}"
    return table(["model", "mean", "95 % below", "worst pose"], lines, caption)


def _halves(outcome: Outcome) -> Html:
    measured, expected = outcome.precision.halves_measured, outcome.precision.halves_expected
    if not math.isfinite(measured):
        return tag("p", "There are too few rows to fit two halves of them apart and compare.")
    said = (
        f"Two halves of the rows, fitted apart, differ by {number(1e3 * measured)} mm RMS at the target; "
        f"noise alone would make {number(1e3 * expected)} mm. "
    )
    if halves_agree(outcome):
        return tag("p", said + "The difference is what noise explains.")
    return tag("p", said + "The difference is more than noise explains: the model does not fit everywhere.")


def halves_agree(outcome: Outcome) -> bool:
    """Whether two calibrations from one half of the rows each differ by what noise makes."""
    return outcome.precision.halves_measured <= 1.5 * outcome.precision.halves_expected


def _workspace(outcome: Outcome) -> Content:
    rows = ~outcome.outlier
    error = norms(outcome.stages[-1].residual[rows])[0]
    points = outcome.measurements.position[rows]
    drawn = []
    for a, b in ((0, 1), (0, 2), (1, 2)):
        labels = (f"{'xyz'[a]} of the world [m]", f"{'xyz'[b]} of the world [m]")
        alt = f"Position error after calibration over {labels[0]} and {labels[1]}"
        plot = field(f"field-{'xyz'[a]}{'xyz'[b]}", alt, points[:, [a, b]], error, labels, "mm")
        drawn.append((f"Position error after calibration, {'xyz'[a]}–{'xyz'[b]} plane", plot))
    return figures(drawn)


def _configuration(outcome: Outcome, row: int) -> str:
    readings = zip(outcome.measurements.readings[row], joint_kinds(outcome.robot), strict=True)
    return ", ".join(_reading(value, kind) for value, kind in readings)


def remains(outcome: Outcome) -> Iterator[Content]:
    """6: what remains, and where not to trust it?"""
    pose, noise = outcome.measurements.quaternion is not None, outcome.noise
    turn = f" and {number(1e3 * noise.rotation)} mrad" if pose else ""
    source = (
        "as declared in the campaign"
        if outcome.noise_source == "declared"
        else "estimated from what the model leaves, so anything that the model lacks makes every ± wider"
    )
    ranges = ", ".join(f"{j.name} ({j.seen})" for j in narrow(outcome))
    yield bullets([
        "Outside the joint ranges of section 3 the model extrapolates; aridcal.predict marks such rows. "
        + (f"Less than half of the range was measured of: {ranges}." if ranges else
           "At least half of every joint's range was measured."),
        f"Every ± is one standard deviation that the measurement noise makes: {number(1e3 * noise.position)} mm{turn} "
        f"per axis, {source}. It does not cover the instrument's own systematic error (scale, levelling), changes of "
        "the robot after the measurement, nor loads and temperatures other than those measured.",
        "The calibration belongs to the kind of joint values in the table. Reported and commanded joints of real arms "
        "differ by 0.1 to 0.2 mrad: feed it the kind that was recorded here.",
    ])  # fmt: skip
    yield tag("h3", "What to measure again after a change")
    redundant = outcome.stage("geometric").fit.redundant
    hidden = sorted({n.rsplit(".", 1)[0] for n, p in redundant.items() if _at_tip(p) and not _at_tip((n,))})
    yield table(
        ["changed", "measure again", "stays"],
        [
            [
                "measuring target or tool",
                ["a few poses with the wrist turned widely, to fit ", tag("code", "tip_target"), " anew"],
                "every constant in the URDF",
            ],
            [
                "robot base or tracker moved",
                ["a few poses spread over the workspace, to fit ", tag("code", "world_base"), " anew"],
                "every constant in the URDF",
            ],
            ["motor, gear, encoder, zero position, a collision", "the whole campaign", "nothing"],
        ],
        [
            "For the first two take ",
            tag("code", "calibrated.urdf"),
            " and ",
            tag("code", "parameters: {set: none}"),
            ": then only the frames are fitted",
        ],
        numbers=3,
    )
    if hidden:
        yield tag(
            "p",
            "Part of the errors of ", _codes(hidden), " is inside ", tag("code", "tip_target"), ", from which it "
            "cannot be told. So the measuring target's place is known, but the bare tip link's only as well as the "
            "nominal URDF.",
        )  # fmt: skip


def _at_tip(partners: tuple[str, ...]) -> bool:
    return any(name.startswith(("tip_target.", "tip_target[")) for name in partners)


def _codes(names: list[str]) -> Content:
    return [part for name in names for part in (", ", tag("code", name))][1:]
