"""One run of a study: a machine simulated and calibrated, or a campaign calibrated from half of its rows."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aridcal.engine.rows.dataset import Dataset
from aridcal.files.campaign import Campaign, JobSettings
from aridcal.files.purposes import StudySettings
from aridcal.files.quantities import POSITION_COLUMNS, column_of
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.calibrate.folder import parameters
from aridcal.jobs.calibrate.key_figures import scored
from aridcal.jobs.calibrate.outcome import Outcome, errors
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.fleet.keys import inputs_of, key_of_version
from aridcal.jobs.fleet.run_record import DONE, FAILED, Row
from aridcal.jobs.simulate.scenario import Scenario, TrueNoise, Truth
from aridcal.jobs.simulate.simulation import Simulation, simulate
from aridcal.jobs.simulate.true_effects import TrueEffect
from aridcal.system.errors import AridcalError, CampaignError, nearest
from aridcal.system.progress import one_thread
from aridcal.system.reading.regular_files import SETTINGS, read_file
from aridcal.system.reading.table_files import FIRST_LINE

NO_EFFECT_SIZE = 1e-9
"""Times what a scenario states of an effect: none of it, but still drawn, so that nothing else is drawn otherwise."""


@dataclass(frozen=True)
class Case:
    """A case of a study: the rows and the size of the effect that its runs share.

    Attributes:
        rows: Measured, or drawn; 0 for half of a campaign's.
        size: Of the effect, times what the scenario states; NaN where none is varied.
    """

    rows: int
    size: float


@dataclass(frozen=True)
class Trial:
    """One run of one case.

    Attributes:
        path: Of the scenario or the campaign, absolute.
        case: Rows and size.
        run: Its number; the same run of another case has the same seed, and so the same machine.
        seed: Of everything that is drawn.
        key: Hash of all inputs, and the version.
    """

    path: str
    case: Case
    run: int
    seed: int
    key: str


def load_study(path: Path) -> Scenario | Campaign:
    """Read what a study repeats: a scenario, which has a truth, or a campaign, which has measurements.

    Raises:
        CampaignError: naming what is missing.
    """
    try:
        job: Scenario | Campaign = load_settings(path, Scenario)
    except CampaignError:
        if _has_truth(path):
            raise
        job = load_settings(path, Campaign)
    if job.study is None:
        raise CampaignError(f"{path}: the key 'study' is missing; add `study: {{runs: 100}}`")
    _check(job, job.study)
    return job


def _has_truth(path: Path) -> bool:
    """Whether a file is meant for a scenario."""
    text = read_file(path, CampaignError, SETTINGS).decode("utf-8", "replace")
    return any(line.startswith("truth:") for line in text.splitlines())


def _check(job: Scenario | Campaign, study: StudySettings) -> None:
    """Refuse a study that cannot be made."""
    if isinstance(job, Campaign):
        if study.sizes or study.effect:
            raise CampaignError(
                f"{job.path}: study.sizes and study.effect need a known truth, which a scenario has; delete them"
            )
        if study.rows:
            raise CampaignError(f"{job.path}: study.rows: a campaign is calibrated from halves of its rows; delete it")
        return
    if job.measurements.traits.of_head:
        raise CampaignError(f"{job.path}: `kind: camera_sonar` is not studied; its poses are, as `kind: pose`")
    if study.effect and not study.sizes:
        raise CampaignError(f"{job.path}: study.effect: says which effect `sizes` are of; add them, or delete it")
    if study.sizes:
        varied_effect(job, study)
    simulate(
        _with(job, job.truth.model_copy(update={"n": min(study.rows or (job.truth.n,))}))
    )  # refused here, not in each run


def varied_effect(scenario: Scenario, study: StudySettings) -> int:
    """Index of the true effect whose size is varied.

    Raises:
        CampaignError: there is none of that name, or several and none is named.
    """
    names = [f"{effect.where}.{effect.kind}" for effect in scenario.truth.effects]
    if study.effect is None:
        if len(names) == 1:
            return 0
        raise CampaignError(
            f"{scenario.path}: study.sizes: there are {len(names)} effects under `truth.effects`; say which one with "
            "`effect: WHERE.KIND`"
        )
    if study.effect not in names:
        raise CampaignError(
            f"{scenario.path}: study.effect: there is no {study.effect!r} under `truth.effects`"
            f"{nearest(study.effect, names)}"
        )
    return names.index(study.effect)


def search_in_words(job: Scenario | Campaign) -> str:
    """Effects that the runs of a study look for, in words; empty where there are none."""
    if not isinstance(job, Scenario) or not job.truth.effects:
        return ""
    study = job.study or StudySettings()
    effects = [job.truth.effects[varied_effect(job, study)]] if study.sizes else job.truth.effects
    return " and ".join(f"{effect.kind} at {effect.where}" for effect in effects)


def trials(job: Scenario | Campaign) -> dict[str, Trial]:
    """All runs of a study by their keys, those of all cases in turn."""
    study = job.study or StudySettings()
    if isinstance(job, Scenario):
        rows, sizes = study.rows or (job.truth.n,), study.sizes or (math.nan,)
        cases = [Case(n, size) for n in dict.fromkeys(rows) for size in dict.fromkeys(sizes)]
    else:
        cases = [Case(0, math.nan)]
    inputs = _inputs(job)
    by_key: dict[str, Trial] = {}
    for run, seed in enumerate(_seeds(study)):
        for case in cases:
            key = key_of_version(hashlib.sha256(f"{inputs} {case} {seed}".encode()).hexdigest())
            by_key[key] = Trial(str(job.path.absolute()), case, run, seed, key)
    return by_key


def _seeds(study: StudySettings) -> list[int]:
    """One for each run: more runs leave the first as they are."""
    return [int(s.generate_state(1)[0]) for s in np.random.SeedSequence(study.seed).spawn(study.runs)]


def _inputs(job: Scenario | Campaign) -> str:
    """Hash of all that a study depends on beside its own block, which only says what is done how often."""
    if isinstance(job, Campaign):
        return inputs_of(job).inputs
    text = job.model_copy(update={"study": None}).model_dump_json(exclude_unset=True)
    return inputs_of(_campaign(job, text)).inputs


def _campaign(scenario: Scenario, text: str = "") -> Campaign:
    """The campaign in a scenario, without its tables."""
    keys = {name: getattr(scenario, name) for name in JobSettings.model_fields if name != "study"}
    campaign = Campaign.model_construct().model_copy(update=keys)
    campaign._path, campaign._text = scenario.path, text
    return campaign


def run_trial(trial: Trial) -> Row:
    """Do one run."""
    started = time.perf_counter()
    row: Row = {
        "key": trial.key,
        "rows": trial.case.rows or None,
        "size": None if math.isnan(trial.case.size) else trial.case.size,
        "run": trial.run,
        "seed": trial.seed,
    }
    with one_thread():
        try:
            job = load_study(Path(trial.path))
            figures = _simulated(job, trial) if isinstance(job, Scenario) else _from_half(job, trial)
        except AridcalError as problem:
            figures = {"status": FAILED, "error": str(problem)}
    return row | figures | {"seconds": round(time.perf_counter() - started, 3)}


def _simulated(scenario: Scenario, trial: Trial) -> Row:
    """Simulate a machine, calibrate it, and compare the result with the truth."""
    study = scenario.study or StudySettings()
    effects = list(scenario.truth.effects)
    looked_for = effects
    if not math.isnan(trial.case.size):
        k = varied_effect(scenario, study)
        effects[k] = _scaled(effects[k], trial.case.size)
        looked_for = [effects[k]]
    changes = {"n": trial.case.rows, "seed": trial.seed, "effects": tuple(effects)}
    truth = scenario.truth.model_copy(update=changes)
    simulation = simulate(_with(scenario, truth))
    outcome = identify(_campaign(scenario).with_tables(simulation.tables))
    true_error = _true_error(scenario, truth, outcome)
    return _figures(outcome) | {"true_rms_mm": true_error} | _effects_found(outcome, looked_for, effects)


def _with(scenario: Scenario, truth: Truth) -> Scenario:
    return scenario.model_copy(update={"truth": truth})


def _scaled(effect: TrueEffect, size: float) -> TrueEffect:
    """An effect ``size`` times as large."""
    size = max(size, NO_EFFECT_SIZE)
    times = tuple(c.model_copy(update={"value": size * c.value, "std": size * c.std}) for c in effect.coefficients)
    return effect.model_copy(update={"coefficients": times})


def _true_error(scenario: Scenario, truth: Truth, outcome: Outcome) -> float | None:
    """How far the final model is from the truth at the rows that judge it, RMS [mm]; None for other kinds than poses.

    The same machine at the same configurations, measured without noise, says where the target really was.
    """
    if scenario.refers or not scenario.measurements.traits.tracked:
        return None
    exact = simulate(_with(scenario, truth.model_copy(update={"noise": TrueNoise(), "outliers": None})))
    rows, mask = outcome.measurements, scored(outcome)[0]
    true = _positions(exact, scenario)[rows.origin.line - FIRST_LINE]
    predicted = rows.position - outcome.stages[-1].residual[:, :3]
    return 1e3 * float(np.sqrt(np.mean(np.sum((true - predicted)[mask] ** 2, axis=1))))


def _positions(simulation: Simulation, scenario: Scenario) -> np.ndarray:
    """Positions in a simulated table, shape (N, 3), [m]."""
    names = [column_of(name, scenario.measurements, simulation.robot.readings) for name in POSITION_COLUMNS]
    return simulation.measurements[names].to_numpy(dtype=float)


def _from_half(campaign: Campaign, trial: Trial) -> Row:
    """Calibrate from a random half of the configurations that are fitted; all held-out rows judge."""
    outcome = identify(campaign, choose=half_of_rows(trial.seed))
    return _figures(outcome) | {"true_rms_mm": None} | _effects_found(outcome, (), ())


def half_of_rows(seed: int) -> Callable[[Dataset], Dataset]:
    """Choose half of the training rows, without replacement, rows that repeat a configuration together.

    A mean over half of n independent rows drawn without replacement scatters about that of all of them with variance s^2 / n,
    exactly as that of n rows drawn with replacement (Efron's bootstrap) does: s^2 / (n/2) (1 - 1/2). So do estimates that are
    means to first order (McCarthy 1969; Politis and Romano 1994, doi:10.1214/aos/1176325770). And no row comes twice: a
    bootstrap's copies would be taken for measurements that repeat to the last digit.
    """

    def choose(rows: Dataset) -> Dataset:
        configurations = np.unique(rows.repeats.configuration[rows.train])
        chosen = np.random.default_rng(seed).permutation(configurations)[: (len(configurations) + 1) // 2]
        return rows.select(rows.test | np.isin(rows.repeats.configuration, chosen))

    return choose


def _figures(outcome: Outcome) -> Row:
    """Errors of every stage on the rows that judge, in the first channel; constants; the verdict."""
    mask, first = scored(outcome)[0], outcome.channels[0]
    rms = {s.name: errors(s.residual, mask, outcome.channels)[first.key]["rms"] for s in outcome.stages}
    constants = [
        {key: parameter[key] for key in ("name", "value", "std", "unit")}
        for parameter in parameters(outcome.stage("geometric").fit)
        if parameter["status"] == "identified"
    ]
    return {
        "status": DONE,
        "error": None,
        "channel": first.key,
        **{name: float(value) if math.isfinite(value) else None for name, value in rms.items()},
        "verdict": outcome.verdict.word,
        "constants": constants,
    }


def _effects_found(outcome: Outcome, sought: Sequence[TrueEffect], true: Sequence[TrueEffect]) -> Row:
    """Whether the sought effects were named, or at least confounded with named ones; and the number of false ones."""
    accepted = [named for named in outcome.effects if not named.declared]
    names = [{(named.effect.kind, named.effect.where)} for named in accepted]
    alike = [{(e.kind, e.where) for e in named.confounded_with} for named in accepted]
    true_effects = {(effect.kind, effect.where) for effect in true}
    sought_effects = {(effect.kind, effect.where) for effect in sought}
    by_name = sought_effects <= set().union(*names)
    return {
        "named": by_name if sought_effects else None,
        "found": sought_effects <= set().union(*names, *alike) if sought_effects else None,
        "others": sum(not (of_name | other) & true_effects for of_name, other in zip(names, alike, strict=True)),
        "effects": [named.effect.label for named in accepted],
    }
