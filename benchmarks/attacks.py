"""Hostile data: does what a calibration says of itself hold where the data are made to deceive it?

Example:
    python benchmarks/attacks.py --jobs 2
    python benchmarks/attacks.py --only bump slip --cases 20 --seed 3
    python benchmarks/attacks.py --replay 1010004

The data come from an arm of its own (``plain_arm.py``, ``plain_robots.py``) that shares no line with aridcal's model; what is
done to them is in ``faults.py``. Every case has its own seed. Even cases declare the noise, odd ones do not; of each four,
two measure poses and two positions; of each eight, four have the column ``time``, and of steps half of these have their
rows in another order.

The table has a row for each attack:

- ``floor``, ``structure``, ``few``: how often the verdict was noise_floor, structure_remains, not_enough_data.
- ``false``: effects named that have no true cause, in all cases.
- ``wrongly``: noise_floor said of a model that misses the noise-free truth by more than 0.7 sigma, or of one that its
  own held-out rows contradict.
- ``named``: the cause is named, as :func:`named` has it for each attack.
- ``whole``: a miss of at most 1.3 times the oracle's.
- ``miss / oracle``: median, 95 %, worst. A miss is the RMS per number, in sigma, of predicted minus true at 1,000
  configurations never measured, as the machine is after the last row. The oracle is a linear least squares fit of the plain
  arm to the same rows, which knows the fault's form and place, which rows are wild, and how rows scatter, but no amount.
  Of a bump it knows a smooth curve at the right joint, as stiff as the bump, but not the bump's place; a second line is against
  one that knows the place, too.
"""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from cases import run_cases
from faults import ATTACKS, SPACING, draw_case
from hostile import FIRST_LINE, Case, Cause
from scipy.spatial.transform import Rotation

from aridcal.calibration import Calibration
from aridcal.files.campaign import Campaign
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.calibrate.saving import calibration

OFF = 0.7  # miss in sigma at which nobody may say that only noise is left
WHOLE = 1.3  # times the oracle's miss within which a fault is found whole
PLACED = 0.02  # share of the rows by which a step may be placed wrongly
CLOSE = 0.15  # relative error of a number that still names it
WORSE = 1.05  # times the miss of the nominal robot with its frames fitted: no calibration may exceed it
PATIENCE = 300  # for one case, [s]
QUIET = ("clean", "copies")  # of which noise_floor is the right verdict
HEAD = "attack        cases failed floor struct few false wrongly  named  whole"
VERDICTS = {"noise_floor": "floor", "structure_remains": "structure", "not_enough_data": "few"}


@dataclass(frozen=True)
class Score:
    """How one case went.

    Attributes:
        attack: Its name.
        seed: Makes the case again.
        told: The data and what is wrong with them, in words.
        said: What was named, in words.
        verdict: The campaign's.
        false: Effects that have no true cause.
        contradicted: Whether the held-out rows contradict the model.
        named: Whether the cause was named.
        close: What else is asked of an answer, and whether it holds.
        miss: Of the final model, [sigma].
        oracle: Of the oracle, [sigma].
        placed: Of one that knows the place of a bump, too, [sigma].
        nominal: Of the nominal robot with its frames fitted, [sigma].
        seconds: Wall time.
    """

    attack: str
    seed: int
    told: str
    said: str
    verdict: str
    false: int
    contradicted: bool
    named: bool
    close: Mapping[str, bool]
    miss: float
    oracle: float
    placed: float
    nominal: float
    seconds: float

    @property
    def wrongly(self) -> bool:
        """True if the verdict promises what the model does not keep."""
        return self.verdict == "noise_floor" and (self.contradicted or self.miss > OFF)

    @property
    def whole(self) -> bool:
        """True if hardly more is missed than must be."""
        return self.miss <= WHOLE * self.oracle

    @property
    def good(self) -> bool:
        """True if nothing is to be looked at."""
        return self.named and not self.false and not self.wrongly and all(self.close.values())

    def line(self) -> str:
        """The case in one line."""
        marks = [f"FALSE {self.false}"] if self.false else []
        marks += ["NOT NAMED"] if not self.named else []
        marks += ["WRONGLY noise_floor"] if self.wrongly else []
        marks += [f"NOT {what}" for what, right in self.close.items() if not right]
        return (
            f"{', '.join(marks) or 'ok'}: {self.seed} {self.attack}: {self.told} -> {self.said} | {self.verdict} | "
            f"miss {self.nominal:.2f} -> {self.miss:.3f}, oracle {self.oracle:.3f} ({self.miss / self.oracle:.2f}) | "
            f"{self.seconds:.1f} s"
        )


def campaign(case: Case, folder: Path) -> Campaign:
    """What a user would write; the URDF is written, the table stays in memory."""
    s = case.scene
    urdf = folder / "robot.urdf"
    urdf.write_text(s.arm.urdf, encoding="utf-8")
    noise = {"position": float(s.sigma[0])} | ({"rotation": float(s.sigma[1])} if s.pose else {})
    keys: dict[str, Any] = {
        "format": 1,
        "robot": {"urdf": urdf, "tip": s.arm.tip, "gravity": s.arm.gravity.tolist()},
        "measurements": {
            "file": (folder / "rows.csv",),
            "kind": "pose" if s.pose else "position",
            "noise": noise if s.declared else {},
        },
    }
    if s.label is not None:
        keys["frames"] = {"tip_target": {"per": "station"}}
    return Campaign.model_validate(keys).with_tables([case.table])


def judge(case: Case) -> Score:
    """Calibrate, and compare what is said with the truth."""
    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        outcome = identify(campaign(case, Path(folder)))
        found = Calibration(calibration(outcome), outcome)
        result = found.result
        table = found.predict(case.query)
    seconds = time.perf_counter() - started
    p = table[["x", "y", "z"]].to_numpy(float)
    s, effects = case.scene, result["effects"]
    turned = table[["qx", "qy", "qz", "qw"]].to_numpy(float) if s.pose else np.tile((0.0, 0.0, 0.0, 1.0), (len(p), 1))
    miss = case.miss(Rotation.from_quat(turned).as_matrix(), p)
    kind = f"{s.family}, {'poses' if s.pose else 'positions'}, noise {'declared' if s.declared else 'unknown'}"
    words = [f"{e['kind']} at {e['where']} {'/'.join(e['motion'])}{_at(e)}" for e in effects]
    readings = result["noise"].get("joint_readings", {})
    words += [f"{name} scatters by {1e3 * v['value']:.2f} mrad" for name, v in readings.items()]
    right, close = named(case, result, miss)
    false = sum(not any(says(e, cause) for cause in s.causes) for e in effects)
    return Score(
        case.attack, case.seed, f"{kind}{', time' if s.timed else ''}; {s.said}", " + ".join(words) or "nothing",
        result["verdict"], false, case.contradicted, right, close, miss,
        case.oracle if np.isnan(case.curve) else case.curve, case.oracle, case.nominal, seconds,
    )  # fmt: skip


def _at(effect: Mapping[str, Any]) -> str:
    at = effect.get("at")
    return f" from row {at['row']}" if at else ""


def says(effect: Mapping[str, Any], cause: Cause) -> bool:
    """Whether an effect is a true one, or says that it cannot be told from it."""
    others = [effect, *effect.get("confounded_with", ())]
    return any(e["kind"] in cause.kinds and e["where"] == cause.where for e in others)


def placed(case: Case, effect: Mapping[str, Any], cause: Cause) -> bool:
    """Whether a step is where it truly is, within 2 % of the rows in order of measuring."""
    at = effect.get("at")
    if cause.row is None or not at:
        return False
    if case.scene.timed and at.get("time") is not None:
        row = int(np.searchsorted(case.scene.time, at["time"] - 1e-6))
    else:
        row = int(np.flatnonzero(case.order == at["row"] - FIRST_LINE)[0])
    return abs(row - cause.row) <= PLACED * case.scene.n


def named(case: Case, result: Mapping[str, Any], miss: float) -> tuple[bool, dict[str, bool]]:
    """Whether a result says what is the matter, and what else of it is right.

    - A step: a ``shift`` at the right place and row; of two, both. A bump, a drift or a payload: the kind and the place.
    - Held-out rows that contradict: any verdict but noise_floor. A base that wanders: that, or an effect of the base.
    - A joint that scatters: it scatters most of all in ``noise.joint_readings``; of all joints: each that moves the target
      by more than the instrument's noise is there.
    - Wild rows: all of them are flagged, and there is no effect.
    - Markers of one body, few poses: the final model is no worse than the nominal one.
    - Nothing, or noise of another kind: no effect.
    """
    s, effects, verdict = case.scene, result["effects"], result["verdict"]
    if case.contradicted:
        return verdict != "noise_floor", {}
    if s.scatter.any():
        return _scatter_named(case, result)
    if s.label is not None:
        return miss <= WORSE * case.nominal, {}
    if case.wild:
        flagged = {row["row"] - FIRST_LINE for row in result["n"].get("outlier_rows", ())}
        return set(case.wild) <= flagged and not effects, {}
    if not s.causes:
        return not effects, {"noise_floor": verdict == "noise_floor"} if case.attack in QUIET else {}
    own = [[e for e in effects if says(e, cause)] for cause in s.causes]
    if case.attack == "walk":
        return any(own) or verdict != "noise_floor", {}
    pairs = list(zip(s.causes, own, strict=True))
    if any(cause.row is not None for cause in s.causes):
        right = all(any(placed(case, e, cause) for e in found) for cause, found in pairs)
        return right, {"at the right place": all(own)}
    close = {}
    for cause, found in pairs:
        if cause.value is not None:
            values = [e["coefficients"][0]["value"] for e in found if e["kind"] in cause.kinds]
            close["value within 15 %"] = any(abs(v / cause.value - 1.0) <= CLOSE for v in values)
    return all(own), close


def _scatter_named(case: Case, result: Mapping[str, Any]) -> tuple[bool, dict[str, bool]]:
    s, noise = case.scene, result["noise"]
    readings = {name: v["value"] for name, v in noise.get("joint_readings", {}).items()}
    clear = {
        name: v
        for k, (name, v) in enumerate(zip(s.arm.names, s.scatter, strict=True))
        if v > 0.0 and np.sqrt(np.mean(s.moved(k, np.full(len(s.q), v)) ** 2)) >= 1.0
    }
    instrument = 1e-3 * np.array([noise["position_mm"], noise.get("rotation_mrad", 0.0)][: 2 if s.pose else 1])
    close = {
        "scatter within 15 %": all(abs(readings.get(n, 0.0) / v - 1.0) <= CLOSE for n, v in clear.items()),
        "instrument within 15 %": bool(np.all(np.abs(instrument / s.sigma[: len(instrument)] - 1.0) <= CLOSE)),
    }
    if len(clear) == 1:
        return bool(readings) and max(readings, key=lambda n: readings[n]) in clear, close
    return set(clear) <= set(readings), close


def _run(seed: int) -> Score | str:
    signal.signal(signal.SIGALRM, _too_long)
    signal.alarm(PATIENCE)
    try:
        return judge(draw_case(seed))
    except Exception as problem:  # a crash is a result, and must not end the others
        return f"FAILED: {seed} {list(ATTACKS)[seed // SPACING % 100]}: {type(problem).__name__}: {problem}"
    finally:
        signal.alarm(0)


def _too_long(*_: object) -> None:
    raise TimeoutError(f"more than {PATIENCE} s")


def report(scores: Sequence[Score], failed: Sequence[str], seconds: float) -> None:
    """Print the table."""
    print(f"\n{HEAD}   miss / oracle: median, 95 %, worst   miss [sigma]   s a case")
    for attack in ATTACKS:
        rows = [s for s in scores if s.attack == attack]
        lost = sum(f" {attack}: " in line for line in failed)
        if not rows:
            continue
        n = len(rows)
        count = {key: sum(s.verdict == key for s in rows) for key in VERDICTS}
        ratio = np.percentile([s.miss / s.oracle for s in rows], [50, 95, 100])
        print(
            f"{attack:13}{n + lost:6}{lost:7}{count['noise_floor']:6}{count['structure_remains']:7}"
            f"{count['not_enough_data']:4}{sum(s.false for s in rows):6}{sum(s.wrongly for s in rows):8}"
            f"{100 * sum(s.named for s in rows) / (n + lost):6.0f}%{100 * sum(s.whole for s in rows) / (n + lost):6.0f}%"
            f"{ratio[0]:14.2f}{ratio[1]:9.2f}{ratio[2]:9.2f}{np.median([s.miss for s in rows]):16.3f}"
            f"{np.mean([s.seconds for s in rows]):11.1f}"
        )
        for what in dict.fromkeys(key for s in rows for key in s.close):
            print(f"{'':13}{sum(s.close.get(what, False) for s in rows)} of {n}: {what}")
        if any(s.placed != s.oracle for s in rows):
            near = np.array([s.miss / s.placed for s in rows])
            print(f"{'':13}over the oracle that knows the place: {np.median(near):.2f}, {np.percentile(near, 95):.2f}, "
                  f"{near.max():.2f}; within {WHOLE}: {np.mean(near <= WHOLE):.0%}")  # fmt: skip
    wrongly = sum(s.wrongly for s in scores)
    print(f"noise_floor said wrongly: {wrongly} of {len(scores)}; failed: {len(failed)}; {seconds:.0f} s")


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=50, help="of each attack")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=tuple(ATTACKS), help="attacks to run")
    parser.add_argument("--replay", type=int, metavar="SEED", help="one case")
    parser.add_argument("--verbose", action="store_true", help="a line for every case, not only for those to look at")
    arguments = parser.parse_args(argv)
    seeds = [
        1_000_000 * arguments.seed + SPACING * a + k
        for a, attack in enumerate(ATTACKS)
        for k in range(arguments.cases)
        if arguments.only is None or attack in arguments.only
    ]
    if arguments.replay is not None:
        seeds, arguments.verbose = [arguments.replay], True
    started = time.perf_counter()
    scores, failed = run_cases(_run, seeds, arguments.jobs, arguments.verbose)
    report(scores, failed, time.perf_counter() - started)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
