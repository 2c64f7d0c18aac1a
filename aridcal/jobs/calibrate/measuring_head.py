"""The identified measuring head: its numbers, its mounting, and how well image points and ranges of single shots agree."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.stages import with_things_moved
from aridcal.engine.instruments.camera import predict_pixels
from aridcal.engine.instruments.camera_sonar import HEAD, Head, ShotPoses, reduced, unpacked
from aridcal.engine.rows.dataset import Dataset, with_places
from aridcal.jobs.calibrate.doty_answer import ClosedForm, closed_form
from aridcal.jobs.head1992.observations import Detections

WILD_MISFIT = 4.0
"""Times the usual misfit beyond which a shot counts less in the mean of all: noise alone does not reach it."""

DOUBTFUL_NOISE = 1.3
"""Ratio of measured to declared noise, either way, that is worth a notice: declared noise is good to about 30 %."""

LEAST_SHOTS = 20
"""Shots that tell a sonar's noise to 16 %."""

LENS_TOLERANCE = 1.0
"""[px] by which a declared lens may be off at an edge of the image: so near, fiducials are detected just as well."""

MOUNTING = "tip_target is the camera's mounting on the tip, T_tip_camera; head.yaml gives only its starting value"
"""Notice for every head."""


@dataclass(frozen=True)
class HeadNumber:
    """One number of the measuring head.

    Attributes:
        name: ``camera.k1``, ``sonar_2.bias`` for instance.
        unit: ``px``, ``m`` or ``1``.
        declared: As head.yaml has it.
        value: As identified.
        std: 1-sigma; None if it was not identified.
        status: ``identified`` or ``fixed``.
    """

    name: str
    unit: str
    declared: float
    value: float
    std: float | None
    status: str


@dataclass(frozen=True)
class MeasuringHead:
    """The identified measuring head.

    Attributes:
        numbers: All its numbers.
        misfit: RMS residual of shots after the fit of their poses, in sigmas: with the head as declared and as identified.
        ranges: RMS residual of each sonar, likewise, shape (2, S), [m].
        fiducials: Columns of the cache of detections in the images.
        mount: T_tip_camera as declared and as identified, shape (2, 4, 4).
        closed_form: The report's own answer on the same poses; None for an arm that is not the ARID's like.
        notices: Sentences that the user should read.
    """

    numbers: tuple[HeadNumber, ...]
    misfit: tuple[float, float]
    ranges: np.ndarray
    fiducials: dict[str, np.ndarray]
    mount: np.ndarray
    closed_form: ClosedForm | None
    notices: tuple[str, ...]


def identified_lens(geometric: Fit, final: Fit, detections: Detections) -> np.ndarray | None:
    """Intrinsics of the camera as identified, shape (9,), where fiducials should be looked for again with them; else None.

    Args:
        geometric: Constants of the arm, the head as declared.
        final: Fitted arm and head.
        detections: Detections in the images.
    """
    moved = with_things_moved(geometric, final)
    if moved is None or not detections.images:
        return None
    lens = Head.of_state(moved.states[HEAD][0]).intrinsics
    fx, fy, cx, cy = detections.intrinsics[:4]
    u, v = np.meshgrid(*(np.linspace(0.0, size - 1.0, 3) for size in detections.size))
    points = np.column_stack([(u.ravel() - cx) / fx, (v.ravel() - cy) / fy, np.ones(u.size)])
    declared, identified = (predict_pixels(np.eye(4), points, each)[0] for each in (detections.intrinsics, lens))
    return lens if np.abs(identified - declared).max() > LENS_TOLERANCE else None


def measuring_head(
    final: Fit, geometric: Fit, rows: Dataset, fitted: np.ndarray, detections: Detections
) -> MeasuringHead:
    """Sum up the measuring head after the fit.

    Args:
        final: Fitted arm and head.
        geometric: Constants of the arm, the head as in the final fit.
        rows: N shots.
        fitted: Rows that count, shape (N,) bool.
        detections: Detections in the images.
    """
    declared = Head.of_state(rows.instruments.things[HEAD].start[0])
    numbers = _numbers(final, declared)
    identified = replace(declared, phi=np.array([n.value for n in numbers]))
    shots = unpacked(rows.observed, len(declared.positions))
    shots_by_head = [reduced(shots, head) for head in (declared, identified)]
    misfit = _scatter(shots_by_head[0]), _scatter(shots_by_head[1])
    ranges = np.array([np.sqrt(np.mean(r.range_residuals**2, axis=0)) for r in shots_by_head])
    with_poses = with_places(rows, shots_by_head[1].position, shots_by_head[1].rotation)
    return MeasuringHead(
        numbers=numbers,
        misfit=misfit,
        ranges=ranges,
        fiducials={str(name): detections.fiducials[name].to_numpy() for name in detections.fiducials},
        mount=np.array([detections.mount, final.model.frames(final.theta)[1][0][1].homogeneous]),
        closed_form=closed_form(geometric, with_poses, fitted),
        notices=_notices(identified, misfit[1], ranges[1], len(rows)),
    )


def _numbers(final: Fit, declared: Head) -> tuple[HeadNumber, ...]:
    """All numbers of the head, from the coefficients that move them."""
    role = declared.role
    value, root = declared.phi.copy(), np.zeros((len(declared.phi), len(final.theta)))
    for k in np.flatnonzero(final.model.at_things).tolist():
        c = final.model.coefficients[k]
        for number in role.moved_by(c.where, c.component):
            value[number] += final.theta[k]
            root[number, k] = 1.0
    std = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", root, final.covariance, root), 0.0))
    return tuple(
        HeadNumber(
            name, unit, float(declared.phi[k]), float(value[k]), float(std[k]) if root[k].any() else None,
            "identified" if root[k].any() else "fixed",
        )
        for k, (name, unit) in enumerate(zip(declared.names, declared.units, strict=True))
    )  # fmt: skip


def _scatter(shots: ShotPoses) -> float:
    """RMS misfit of image points and ranges within shots, in sigmas; wild shots count less."""
    share = shots.misfit / np.maximum(shots.freedom, 1.0)
    usual = max(float(np.median(share)), 1.0)
    trust = np.minimum(1.0, WILD_MISFIT**2 * usual / np.maximum(share, np.finfo(float).tiny))
    return float(np.sqrt(trust @ shots.misfit / max(float(trust @ shots.freedom), 1.0)))


def _notices(head: Head, misfit: float, ranges: np.ndarray, shots: int) -> tuple[str, ...]:
    """Notices on the mounting, and on noise of the head that is not as declared."""
    notices = [MOUNTING]
    if misfit > DOUBTFUL_NOISE:
        notices.append(
            f"within single shots, image points and ranges scatter by {misfit:.1f} times their stated noise: the camera, "
            "the sonars or their std are not as head.yaml says, in a way that no effect of the head describes"
        )
    for k, rms in enumerate(ranges.tolist()):
        if shots >= LEAST_SHOTS and abs(np.log(rms / head.std)) > np.log(DOUBTFUL_NOISE):
            notices.append(f"sonar_{k + 1} scatters by {1e3 * rms:.2g} mm, not the stated {1e3 * head.std:.2g} mm")
    return tuple(notices)
