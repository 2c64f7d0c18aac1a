"""A calibration as Python users have it: figures as DataFrames, poses and joints in the campaign's own dialect."""

from __future__ import annotations

import io
import json
import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from aridcal.files.query import Query, seeded
from aridcal.files.tables import AnyTable
from aridcal.files.yaml_file import decode, parse_yaml
from aridcal.jobs.apply.joint_commands import compensate
from aridcal.jobs.apply.target_poses import evenly, predict, read_query, uncertainty
from aridcal.jobs.calibrate.controllers import INDEX, by_region, controller_exports, index_document
from aridcal.jobs.calibrate.folder import result_document
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.pipeline import score
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.calibrate.verdict import NOISE_UNKNOWN, VERDICTS
from aridcal.pages.drawing.html import tag
from aridcal.pages.drawing.notebook_tables import ERROR_FORMAT, Verified, headline
from aridcal.pages.drawing.result_tables import (
    combination_table,
    effect_table,
    error_table,
    influence_table,
    iso_table,
    parameter_table,
    region_table,
    verification_table,
)
from aridcal.pages.drawing.scene import write_scene
from aridcal.pages.report.page import write_report
from aridcal.runs.repair_folder import recalibrate
from aridcal.runs.result_folder import write_folder
from aridcal.runs.rows_check import Check, check_rows
from aridcal.system.errors import AridcalError, CampaignError, shortened
from aridcal.system.progress import SHOWN_REMARKS, Page, working
from aridcal.system.reading.regular_files import RESULT, read_file
from aridcal.system.writing.whole_files import atomic_file

if TYPE_CHECKING:
    from aridcal.pages.drawing.notebook_plots import Plots


@dataclass(frozen=True, repr=False, eq=False)
class Calibration:
    """A calibrated robot: its model, its figures, and its use.

    Tables come and go as the campaign's own do: its columns, units and orientation.

    Attributes:
        model: The model behind it, for arrays and for streams of commands; all that ``calibration.yaml`` holds.
        outcome: Everything behind the figures, row by row; None of a calibration that was loaded.
        folder: Where it was loaded from; None of one that was not.
    """

    model: SavedModel
    outcome: Outcome | None = None
    folder: Path | None = None

    @cached_property
    def result(self) -> dict[str, Any]:
        """All figures, as ``result.json`` holds them (docs/formats.md).

        Raises:
            AridcalError: of a loaded ``calibration.yaml`` without its ``result.json``.
        """
        if self.outcome is not None:
            return result_document(self.outcome)
        path = self._beside("result.json", "the figures are")
        try:
            return dict(json.loads(_text(path)))
        except (ValueError, TypeError, RecursionError) as error:
            raise AridcalError(f"{path}: cannot be read: {error}. Run identify again") from None

    @property
    def errors(self) -> pd.DataFrame:
        """Error of what was measured, [mm], [mrad] or [px]: a row for each model and part of the rows (train, test, test_all)."""
        return self._figures(error_table)

    @property
    def effects(self) -> pd.DataFrame:
        """Effects of the model beyond geometry, the largest gain first; before and after are on held-out rows."""
        return self._figures(effect_table)

    @property
    def parameters(self) -> pd.DataFrame:
        """Frames and corrections of the nominal constants by name, lengths in [mm] and angles in [mrad]."""
        return self._figures(parameter_table)

    @property
    def iso_9283(self) -> pd.DataFrame:
        """Poses that were measured more than once, by the definitions of ISO 9283: accuracies, repeatabilities, drifts."""
        return self._figures(iso_table)

    @property
    def influence(self) -> pd.DataFrame:
        """Rows without which the predicted target moves most, by file and row: by how much [mm], leverage and Cook's distance."""
        return self._figures(influence_table)

    @property
    def combinations(self) -> pd.DataFrame:
        """Combinations of constants that the rows tell independently, the best known first: shares by name, and ``std``."""
        return self._figures(combination_table)

    @property
    def regions(self) -> pd.DataFrame:
        """Each region's own URDF: where it holds, and its error, [m] and [rad]; empty where nothing varies by region.

        Raises:
            AridcalError: of a loaded calibration whose ``regions/index.yaml`` is damaged.
        """
        if self.outcome is not None:
            own = by_region(self.outcome)
            return region_table(index_document(self.outcome, own) if own is not None else {})
        path = (self.folder or Path()) / INDEX
        if not path.is_file():
            return region_table({})
        index, _ = parse_yaml(_text(path), path)
        try:
            return region_table(index)
        except (KeyError, TypeError, AttributeError) as error:
            raise AridcalError(f"{path}: is damaged ({shortened(repr(error))}). Run identify again") from None

    @cached_property
    def plot(self) -> Plots:
        """Figures of matplotlib: ``plot.errors()``, ``.joints()``, ``.residuals()`` and ``.workspace()``, before and after.

        Raises:
            AridcalError: of a loaded calibration without its ``residuals.csv``, or with a damaged one.
        """
        from aridcal.pages.drawing.notebook_plots import (  # matplotlib is slow to load, and few draw
            plots_of,
            plots_of_table,
        )

        if self.outcome is not None:
            return plots_of(self.outcome)
        path = self._beside("residuals.csv", "the residuals are")
        try:
            return plots_of_table(pd.read_csv(io.StringIO(_text(path))))
        except (KeyError, ValueError) as error:
            reason = shortened(f"{type(error).__name__}: {error}")
            raise AridcalError(f"{path}: is damaged ({reason}). Run identify again") from None

    def predict(self, queries: AnyTable, of: str | None = None, within: str | None = None) -> pd.DataFrame:
        """Predict the pose of the real target, or of a link of the robot, for each row of joint readings.

        Args:
            queries: A column for each joint and each covariate that an effect depends on.
            of: Link of the URDF whose pose is wanted; None: the target's.
            within: Link in whose frame that is; None: in the world's.

        Returns:
            The same rows and columns with the target's pose, its standard deviations ``std_x`` to ``std_rz``, and
            ``extrapolates``: True of rows unlike the calibration's own. Where a part is known by no reading, also ``told``.

        Raises:
            AridcalError: a column is missing, two orientations disagree, or no row can be predicted.
        """
        if within is not None and of is None:
            raise CampaignError("within says in which link's frame; name the link whose pose is wanted: of=LINK")
        with working() as progress:
            progress("predicting")
            model = self.model if of is None else self.model.of_link(of, within)
            query = read_query(model, queries)
            table = predict(model, query)
        _warn(query)
        return _with_numbers(table)

    def uncertainty(
        self, queries: AnyTable | None = None, tool: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> pd.DataFrame:
        """Uncertainty of the target: 1-sigma, by the noise of the measurements.

        Args:
            queries: As for :meth:`predict`; None: 512 configurations evenly over the measured joint ranges.
            tool: A point that moves with the target, in its axes, [m].

        Returns:
            The rows with ``sigma_mm`` in the worst direction, that direction ``worst_x`` to ``worst_z`` in world axes, ``rms_mm``
            of all axes together, ``rotation_mrad`` (of poses), and ``extrapolates``.

        Raises:
            AridcalError: as :meth:`predict`; or a point beside a target whose rotation was never measured.
        """
        query = read_query(self.model, evenly(self.model) if queries is None else queries)
        _warn(query)
        return _with_numbers(uncertainty(self.model, query, tool))

    def compensate(
        self, poses: AnyTable, seed: AnyTable | None = None, of: str | None = None, within: str | None = None
    ) -> pd.DataFrame:
        """Find the joints that bring the real target, or a link of the robot, to each of the wanted poses.

        Args:
            poses: A row for each pose; its columns of joints, if it has any, are where to start.
            seed: Rows whose joints are where to start instead: the controller's own solution, for instance.
            of: Link of the URDF that is to be there; the joints on the way to it move, all others stay.
            within: Link in whose frame the poses are, which stays where the table has it; None: in the world's.

        Returns:
            The same rows and columns with the joints, ``reached``, ``position_error`` (and ``rotation_error``) in the
            campaign's units, and ``extrapolates``.

        Raises:
            AridcalError: a column is missing, two orientations disagree, or no row can be commanded.
        """
        if within is not None and of is None:
            raise CampaignError("within says in which link's frame; name the link that is to be there: of=LINK")
        with working() as progress:
            progress("finding the commands")
            model = self.model if of is None else self.model.of_link(of, within)
            joints = model.final.model.robot.readings
            table = poses if seed is None else seeded(poses, seed, model.measurements, joints)
            query = read_query(model, table, poses=True)
            count = len(query.line)
            table = compensate(model, query, report=lambda rows: progress.part(rows, count, "rows"))
        _warn(query)
        return _with_numbers(table)

    def verify(self, measurements: AnyTable) -> Verified:
        """Score another day's measurements with the models as they are, and with both frames fitted anew.

        Args:
            measurements: In the columns and units of the campaign's own.

        Raises:
            AridcalError: the table needs mending, or this calibration was loaded.
        """
        with working() as progress:
            progress("scoring")
            scores = score(self._with_data("verify"), measurements)
        outliers = int(scores.outlier.sum())
        return Verified(scores.file, len(scores.measurements), outliers, verification_table(scores))

    def check(self, measurements: AnyTable, tolerance: float | None = None) -> Check:
        """Check by 5 to 20 new rows whether the calibration is still good, and if not, what moved.

        Args:
            measurements: In the columns and units of the campaign's own, or the path of another instrument's campaign.
            tolerance: Largest RMS position error that is still good, [m]; None: any contradiction by the rows counts.

        Raises:
            AridcalError: the rows need mending, or nothing can be said of a tolerance.
        """
        with working() as progress:
            progress("asking what moved")
            return check_rows(self.model, measurements, tolerance)

    def recalibrate(self, measurements: AnyTable, folder: str | Path) -> Calibration:
        """Mend the calibration with 5 to 20 new rows: what moved is fitted, all else kept.

        Args:
            measurements: As for :meth:`check`.
            folder: Where the whole result is written, with its lineage.

        Returns:
            The repaired calibration.

        Raises:
            AridcalError: nothing moved, the rows do not tell what moved, or this calibration was not loaded from a file.
        """
        if self.folder is None:
            raise AridcalError("`recalibrate` writes where a calibration comes from: save it, and load what was saved")
        with working() as progress:
            recalibrate(self.folder, measurements, Path(folder), progress)
        return Calibration(SavedModel.load(folder), folder=Path(folder))

    def report(self, path: str | Path | None = None) -> Page:
        """The report: the answer, and the reasons for it. A notebook shows it; with a path it is saved as well."""
        return self._page(
            "report.html", lambda outcome, target: write_report(outcome, controller_exports(outcome), target), path
        )

    def scene(self, path: str | Path | None = None) -> Page:
        """The robot and its errors in 3D. A notebook shows it; with a path it is saved as well."""
        return self._page("scene.html", write_scene, path)

    def save(self, folder: str | Path) -> None:
        """Write the result folder that ``aridcal identify`` writes: all its files, or none.

        A picture that cannot be drawn costs a warning and no file.

        Raises:
            AridcalError: the folder cannot be written, or this calibration was loaded.
        """
        outcome = self._with_data("save")
        with working() as progress:
            written = write_folder(outcome, Path(folder), progress)
        _warn_of(written.notices)

    def __repr__(self) -> str:
        if not self._has_figures:
            return self._title
        return "\n".join([self._title, self._headline.to_string(float_format=ERROR_FORMAT), *self._remarks])

    def _repr_html_(self) -> str:
        title = tag("p", tag("b", self._title))
        if not self._has_figures:
            return title
        table = self._headline.to_html(float_format=ERROR_FORMAT, border=0)
        remarks = "".join(tag("div", remark) for remark in self._remarks)
        return f"{title}{table}{remarks}"

    @property
    def _title(self) -> str:
        robot = self.model.final.model.robot.tree.name
        if not self._has_figures:
            return f"Calibration of {robot}: the model alone, without its figures"
        n = self._figures(lambda result: {key: int(result["n"][key]) for key in ("train", "test")})
        scored = f"{n['test']} held-out rows" if n["test"] else f"the {n['train']} rows that were fitted"
        return f"Calibration of {robot}: error on {scored}"

    @property
    def _has_figures(self) -> bool:
        return self.folder is None or (self.folder / "result.json").is_file()

    @property
    def _headline(self) -> pd.DataFrame:
        """Each model's error on the rows that count: those held out, if there are any."""
        part = "test" if self._figures(lambda result: result["n"]["test"]) else "train"
        return headline(self.errors[self.errors.index.get_level_values("rows") == part].droplevel("rows"))

    @property
    def _remarks(self) -> list[str]:
        """Lines below the table of errors: effects, verdict, notices."""
        return list(self._figures(_remarks))

    def _figures(self, make: Callable[[dict[str, Any]], Any]) -> Any:
        """The result of ``make`` on the figures, which may be damaged if the calibration was loaded."""
        try:
            return make(self.result)
        except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
            if self.outcome is not None:
                raise
            reason = shortened(f"{type(error).__name__}: {error}")
            raise AridcalError(f"{self.folder}: result.json is damaged ({reason}). Run identify again") from None

    def _page(self, name: str, write: Callable[[Outcome, Path], tuple[str, ...]], path: str | Path | None) -> Page:
        """A page made anew, or of a loaded calibration the folder's own; warns of what could not be drawn."""
        if self.outcome is None:
            source = _text(self._beside(name, f"{name} is"))
        else:
            with working() as progress, tempfile.TemporaryDirectory() as folder:
                progress(f"drawing {name}")
                notices = write(self.outcome, Path(folder) / name)
                source = (Path(folder) / name).read_text("utf-8")
            _warn_of(notices, stacklevel=4)
        if path is not None:
            with atomic_file(Path(path)) as stage:
                stage.write_text(source, encoding="utf-8", newline="\n")
        return Page(f"{name.removesuffix('.html')} of {self.model.final.model.robot.tree.name}", source)

    def _beside(self, name: str, what: str) -> Path:
        """A file of the folder from which the calibration was loaded."""
        path = (self.folder or Path()) / name
        if not path.is_file():
            raise AridcalError(
                f"{path}: there is no such file: {what} not in calibration.yaml. Load the whole result folder, or "
                "calibrate again"
            )
        return path

    def _with_data(self, method: str) -> Outcome:
        """The outcome, with the measurements behind it."""
        if self.outcome is None:
            raise AridcalError(
                f"{self.folder}: `{method}` needs the measurements behind a calibration, and this one was loaded: "
                f"`aridcal.calibrate(campaign)` has them"
            )
        return self.outcome


def _remarks(result: dict[str, Any]) -> list[str]:
    verdict = result["verdict"]
    effects = ", ".join(f"{effect['kind']} at {effect['where']}" for effect in result["effects"])
    notices = [f"note: {notice}" for notice in result["notices"][:SHOWN_REMARKS]]
    unknown = NOISE_UNKNOWN in result.get("reasons", [])
    words = "the rest may be noise; nobody has said how large that is" if unknown else VERDICTS[verdict].line
    return [f"effects: {effects or 'none'}", f"verdict: {verdict}: {words}", *notices]


def _text(path: Path) -> str:
    """A file of a result folder."""
    return decode(read_file(path, AridcalError, RESULT), path, AridcalError)


def _with_numbers(table: pd.DataFrame) -> pd.DataFrame:
    """A table that was read from csv, its columns of numbers made numbers."""
    for name in table.columns[[pd.api.types.is_string_dtype(dtype) for dtype in table.dtypes]]:
        try:
            table[name] = pd.to_numeric(table[name])
        except (ValueError, TypeError):
            continue
    return table


def _warn_of(notices: Sequence[str], stacklevel: int = 3) -> None:
    """Warn of pages that could not be drawn."""
    if notices:
        warnings.warn("\n".join(notices), stacklevel=stacklevel)


def _warn(query: Query) -> None:
    """Warn of rows without an answer, and of rows with an odd one."""
    odd = [remark for remark in query.notices if remark.row is not None]
    remarks = [str(remark) for remark in (*query.refused, *odd)]
    if len(remarks) > SHOWN_REMARKS:
        remarks[SHOWN_REMARKS:] = [f"and {len(remarks) - SHOWN_REMARKS} more remarks"]
    if remarks:
        warnings.warn("\n".join(remarks), stacklevel=3)
