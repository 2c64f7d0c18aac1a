"""Covariates that effects may depend on: measured, or derived from measurements, at the rows' readings."""

from __future__ import annotations

import numpy as np

from aridcal.engine.corrections.catalogue import UntestableEffect, barred_joints, usable_columns
from aridcal.engine.corrections.effect import ROW_ORDER
from aridcal.engine.corrections.effect_kind import ObservedRows
from aridcal.engine.corrections.labels import LABEL_COLUMN, MOST_LABELS, label_column, label_columns, labels_in
from aridcal.engine.corrections.loads import covariate_table
from aridcal.engine.model.model import Model
from aridcal.engine.model.placements import references
from aridcal.engine.model.predictions import rows_of_data
from aridcal.engine.rows.dataset import Dataset


def covariates_and_exclusions(model: Model, rows: Dataset) -> tuple[ObservedRows, list[UntestableEffect]]:
    """Covariates of rows for candidate effects, and the effects that cannot be tested; the model knows its surroundings."""
    derived = {name: rows.covariates[name] for name in rows.origin.derived}
    usable, barred_columns = usable_columns({name: v for name, v in rows.covariates.items() if name not in derived})
    frames = rows_of_data(model, rows)
    measured = {name: rows.conditions[name] for name in (*usable, ROW_ORDER)}
    for mass in model.around.masses:
        payload = rows.covariates.get(mass)
        if payload is not None and not np.isnan(payload).any():
            measured[mass] = payload  # it counts in the loads even where it is always the same
    table = covariate_table(
        model.robot, rows.readings, measured, model.around, frames.world, {".gravity_", ".payload_"}
    )
    gravity = np.atleast_2d(model.around.gravity)[0]
    table |= model.sight_columns(rows.readings, gravity, frames.tip, frames.route)
    # A derived side of approach is for backlash alone: no other effect may depend on it.
    table |= {name: derived[name] for name in usable_columns(derived)[0]}
    labels = [label_column(label) for label in labels_in(rows.labels.station)]
    if len(labels) > MOST_LABELS:
        barred_columns.append(
            UntestableEffect(
                f"deviations by {LABEL_COLUMN}", f"there are {len(labels)} labels, and {MOST_LABELS} at the most"
            )
        )
        labels = []
    table |= label_columns(labels, rows.labels.station)
    observed = ObservedRows(
        robot=model.robot,
        table=table,
        measured=tuple(usable),
        orientations=rows.sees_turns,
        stated_components=model.instruments.held,
        referred={
            (role, name): len(np.unique(rows.repeats.configuration[referring]))
            for role, name, referring in references(rows)
        },
        labels=tuple(labels),
        masses=model.around.masses,
    )
    return observed, barred_columns + barred_joints(observed)
