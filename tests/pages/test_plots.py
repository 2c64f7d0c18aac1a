"""Figures of the Python face: what the artists hold is what the result holds, with units, before and after."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import robots
from matplotlib._pylab_helpers import Gcf
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import aridcal
from aridcal.pages.drawing.notebook_plots import AFTER, BEFORE, plots_of_table


@pytest.fixture(scope="module")
def cal(tmp_path_factory: pytest.TempPathFactory) -> aridcal.Calibration:
    truth = robots.simulate(robots.arid(), 60, np.random.default_rng(3), noise=1e-4)
    rows = robots.table(truth)
    rows.loc[7, "x"] += 0.5  # a gross outlier
    folder = tmp_path_factory.mktemp("plots")
    return aridcal.calibrate(robots.write_campaign(folder, truth, rows, diagnosis={"enabled": False}))


def lines(panel: Axes) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Data of the lines before and after, by their colours."""
    found = {str(line.get_color()): line.get_data() for line in panel.lines}
    return {"before": found[BEFORE], "after": found[AFTER]}


def kept(cal: aridcal.Calibration) -> np.ndarray:
    """Rows that are no outliers, in the order of the table."""
    assert cal.outcome is not None and cal.outcome.outlier.sum() == 1
    order = cal.outcome.measurements.as_read
    return order[~cal.outcome.outlier[order]]


def residuals(cal: aridcal.Calibration, rows: np.ndarray) -> dict[str, np.ndarray]:
    assert cal.outcome is not None
    first, last = cal.outcome.stages[0], cal.outcome.stages[-1]
    return {"before": 1e3 * first.residual[rows], "after": 1e3 * last.residual[rows]}


def test_errors_are_the_distribution_of_those_of_held_out_rows(cal: aridcal.Calibration) -> None:
    position, rotation = cal.plot.errors().axes
    assert (position.get_xlabel(), rotation.get_xlabel()) == ("position error [mm]", "rotation error [mrad]")
    assert position.get_ylabel() == "held-out rows below [%]"
    rows = kept(cal)
    judged = rows[cal.outcome.measurements.test[rows]]
    for panel, part in ((position, slice(0, 3)), (rotation, slice(3, 6))):
        for when, (x, y) in lines(panel).items():
            wanted = np.sort(np.linalg.norm(residuals(cal, judged)[when][:, part], axis=1))
            np.testing.assert_allclose(x, wanted)
            np.testing.assert_allclose(y, 100 * np.arange(1, len(wanted) + 1) / len(wanted))
    for when, model in (("before", "nominal"), ("after", "final")):
        rms = cal.errors.loc[(model, "test"), "position_rms_mm"]
        assert f"{when}: RMS {rms:.3g} mm" in [text.get_text() for text in position.get_legend().get_texts()]


def test_residuals_are_each_number_of_each_row(cal: aridcal.Calibration) -> None:
    panels = cal.plot.residuals().axes
    assert [panel.get_ylabel() for panel in panels] == [
        "x [mm]",
        "y [mm]",
        "z [mm]",
        "rx [mrad]",
        "ry [mrad]",
        "rz [mrad]",
    ]
    rows = kept(cal)
    for k, panel in enumerate(panels):
        for when, (x, y) in lines(panel).items():
            np.testing.assert_allclose(y, residuals(cal, rows)[when][:, k])
            assert x.tolist() == [row for row in range(1, 61) if row != 8]


def test_each_joint_has_a_panel_of_errors_over_its_readings(cal: aridcal.Calibration) -> None:
    panels = cal.plot.joints().axes
    assert [panel.get_xlabel() for panel in panels] == ["joint_1 [m]", *(f"joint_{k} [deg]" for k in (2, 3, 4))]
    rows = kept(cal)
    readings = cal.outcome.measurements.readings[rows]
    for k, panel in enumerate(panels):
        assert panel.get_ylabel() == "error at the target [mm]"
        for when, (x, y) in lines(panel).items():
            np.testing.assert_allclose(x, readings[:, k] if k == 0 else np.degrees(readings[:, k]))
            np.testing.assert_allclose(y, np.linalg.norm(residuals(cal, rows)[when][:, :3], axis=1))


def test_the_workspace_has_one_colour_for_one_error_before_and_after(cal: aridcal.Calibration) -> None:
    before, after, bar = cal.plot.workspace().axes
    assert (before.get_title(), after.get_title(), bar.get_ylabel()) == ("before", "after", "error at the target [mm]")
    rows = kept(cal)
    places = cal.outcome.at_target.places[rows]
    thinnest = int(np.argmin(np.ptp(places, axis=0)))
    seen = [k for k in range(3) if k != thinnest]
    assert before.get_xlabel() == f"{'xyz'[seen[0]]} [m]" and before.get_ylabel() == f"{'xyz'[seen[1]]} [m]"
    clouds = [panel.collections[0] for panel in (before, after)]
    assert clouds[0].norm is clouds[1].norm and clouds[0].cmap.name == "cividis"
    for when, cloud in zip(("before", "after"), clouds, strict=True):
        size = np.linalg.norm(residuals(cal, rows)[when][:, :3], axis=1)
        order = np.argsort(size)
        np.testing.assert_allclose(cloud.get_array(), size[order])
        np.testing.assert_allclose(cloud.get_offsets(), places[order][:, seen])


def test_figures_are_matplotlibs_own_without_pyplot_and_show_themselves_in_a_notebook(cal: aridcal.Calibration) -> None:
    figures = [getattr(cal.plot, name)() for name in ("workspace", "residuals", "joints", "errors")]
    assert all(isinstance(figure, Figure) for figure in figures)
    assert len({type(figure)._repr_png_ for figure in figures}) == 1
    assert figures[-1]._repr_png_().startswith(b"\x89PNG")
    assert not Gcf.figs


def test_a_loaded_calibration_draws_what_its_files_hold_and_says_what_it_cannot(
    cal: aridcal.Calibration, tmp_path: Path
) -> None:
    cal.save(tmp_path / "results")
    loaded = aridcal.load(tmp_path / "results")
    for name in ("errors", "residuals"):
        for mine, theirs in zip(getattr(loaded.plot, name)().axes, getattr(cal.plot, name)().axes, strict=True):
            for when, data in lines(theirs).items():
                np.testing.assert_allclose(lines(mine)[when], data, rtol=1e-7, atol=1e-9)
    for name in ("joints", "workspace"):
        with pytest.raises(aridcal.AridcalError, match=rf"`plot\.{name}` needs the measurements"):
            getattr(loaded.plot, name)()
    (tmp_path / "results" / "residuals.csv").write_text("file,row\na,1\n")
    with pytest.raises(aridcal.AridcalError, match=r"residuals\.csv: is damaged"):
        _ = aridcal.load(tmp_path / "results").plot
    (tmp_path / "results" / "residuals.csv").unlink()
    with pytest.raises(aridcal.AridcalError, match="there is no such file"):
        _ = aridcal.load(tmp_path / "results").plot


def test_rows_of_several_kinds_have_a_panel_for_each_with_its_own_unit() -> None:
    table = pd.DataFrame(
        {"split": ["train"] * 3, "outlier": 0}
        | {f"{stage}_wire_l": [size, size, np.nan] for stage, size in (("nominal", 2e-3), ("final", 1e-4))}
        | {f"{stage}_eye_{axis}": [np.nan, np.nan, 3.0] for stage in ("nominal", "final") for axis in "uv"}
    )
    panels = plots_of_table(table).errors().axes
    assert [panel.get_xlabel() for panel in panels] == ["wire distance error [mm]", "eye pixel error [px]"]
    assert panels[0].get_ylabel() == "fitted rows below [%]"  # none are held out
    assert lines(panels[0])["before"][0].tolist() == [2.0, 2.0]
    np.testing.assert_allclose(lines(panels[1])["after"][0], [np.hypot(3.0, 3.0)])
