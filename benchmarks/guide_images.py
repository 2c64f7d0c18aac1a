"""How many images being led saves where a camera on the flange sees a board and nothing else measures.

    python benchmarks/guide_images.py 10                  # draws of a UR10, a 7R, a SCARA and a gantry
    python benchmarks/guide_images.py 10 --first 20 --arm UR10
    python benchmarks/guide_images.py 2 --limit           # the fewest images of any choice, as ``guide.py limit``
    python benchmarks/guide_images.py 10 --faults         # camera or board moved, stale image: told within two images

The machines are those of ``guide.py``, the camera and the board those of ``hand_eye.py``: 24 corners, 0.2 px of noise, a known
lens. Where camera and board are is said to 3 mm and 10 mrad, and both are unknown. Random images are of random joints at
which the camera sees the board. Images tell neither where the base is nor where the tip is: errors are those of the tip's
place at 95 % of the region once both ends are laid over the true ones. The floor is what is left after 100 random images;
judged as in ``guide.py``: images from which on the error stays within twice the floor, led, at random and of plans made
beforehand from the places as they are said; the calibration that is delivered where it is said that the tolerance is kept; and
all that was said to be known.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pinocchio as pin
import yaml
from guide import (
    ARMS,
    COLUMNS,
    COUNTS,
    LIMIT_COLUMNS,
    PLAN_FITS,
    PLANS,
    Draw,
    Fewest,
    _gone_on,
    cell,
    delivered_poses,
    draws_of,
    fewest,
    judged,
    models,
    of,
    poses_now,
    print_draws,
    print_limits,
    seeds_of,
    smallest_plan,
)
from hand_eye import CORNERS, LENS, SIZE
from hand_eye import NOISE as PIXELS
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from aridcal.engine.instruments.camera import project
from aridcal.files.campaign import Campaign, load_campaign
from aridcal.jobs.guide.events import Alarm, Known, Next, Stop
from aridcal.jobs.guide.posterior import Posterior
from aridcal.jobs.guide.session import Session, session
from aridcal.jobs.plan.configurations import draw_candidates
from aridcal.jobs.plan.information import columns_of
from aridcal.jobs.plan.pose_design import PlanRequest, design
from aridcal.jobs.plan.prior_knowledge import beforehand
from aridcal.jobs.simulate.live import LiveArm

FLOOR_IMAGES, MOST_IMAGES = 100, 60
HINT_PLACE, HINT_TURN = 3e-3, 1e-2
BOARDS = {"UR10": (0.6, 0.2, 0.0), "7R": (0.45, 0.1, 0.0), "SCARA": (0.4, 0.1, -0.3), "gantry": (1.5, 1.0, -0.3)}
MARGIN = 5  # [px] from the edge of the image
LABELS = [f"c{k}" for k in range(len(CORNERS))]


@dataclass
class Eye:
    """A true machine with a camera on its flange, and a board before it.

    Attributes:
        arm: The machine.
        camera: T_tip_camera.
        board: T_base_board.
        noise: Draws the noise of the pixels.
    """

    arm: LiveArm
    camera: pin.SE3
    board: pin.SE3
    noise: np.random.Generator

    def tips(self, readings: np.ndarray) -> list[pin.SE3]:
        """T_base_tip of each of n readings, shape (n, columns)."""
        ((_, base),), ((_, target),) = self.arm.model.world_base, self.arm.model.tip_target
        R, p = self.arm.model.poses(self.arm.simulation.theta, self.arm.model.rows(readings))
        return [pin.SE3(base).inverse() * pin.SE3(*pose) * pin.SE3(target).inverse() for pose in zip(R, p, strict=True)]

    def image(self, readings: np.ndarray, shot: int, taken_at: np.ndarray | None = None) -> list[bytes]:
        """Lines of the table: the header, and a line for each corner that is seen, at these readings or at others."""
        at = readings if taken_at is None else taken_at
        seen = (self.tips(at[None])[0] * self.camera).inverse() * self.board
        corners = CORNERS @ seen.rotation.T + seen.translation
        pixels = project(corners, np.tile(LENS, (len(corners), 1))) + PIXELS * self.noise.standard_normal((24, 2))
        within = np.all((pixels > MARGIN) & (pixels < np.array(SIZE) - MARGIN), axis=1) & (corners[:, 2] > 0.0)
        rows = [
            [*readings.tolist(), "eye", label, shot, *pixel]
            for label, pixel, is_in in zip(LABELS, pixels, within, strict=True)
            if is_in
        ]
        columns = [*self.arm.simulation.robot.readings, "camera", "marker", "shot", "u", "v"]
        return pd.DataFrame(rows, columns=columns).to_csv(index=False).encode().strip().split(b"\n")


def workcell(folder: Path, arm: str, seed: int) -> Eye:
    """Draw a machine, its camera and its board; the campaign is written beside."""
    rng = np.random.default_rng([seed, 21])
    made = cell(folder, arm, "pose", seed).arm
    turn = pin.rpy.rpyToMatrix(*rng.uniform(-0.3, 0.3, 2), rng.uniform(-np.pi, np.pi))
    down = np.diag([1.0, -1.0, -1.0]) if arm in ("SCARA", "gantry") else np.eye(3)
    camera = pin.SE3(down @ turn, rng.uniform((-0.08, -0.08, 0.02), (0.08, 0.08, 0.1)))
    board = pin.SE3(pin.rpy.rpyToMatrix(0.02, -0.01, 0.3), np.array(BOARDS[arm]))
    pd.DataFrame({"marker": LABELS, **dict(zip("xyz", CORNERS.T, strict=True))}).to_csv(
        folder / "markers.csv", index=False
    )
    fx, fy, cx, cy, *distortion = LENS.tolist()
    lens = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "width": SIZE[0], "height": SIZE[1], "distortion": distortion}
    keys = yaml.safe_load((folder / "campaign.yaml").read_text())
    keys.pop("frames")
    keys["measurements"] = {"file": "measurements.csv", "kind": "pixels", "noise": {"pixel": PIXELS}}
    keys["instruments"] = {
        "cameras": {"eye": {**lens, "on": "tip", "identify": ["place"], **_nearly(camera, rng)}},
        "markers": {"file": "markers.csv", **_nearly(board, rng)},
    }
    (folder / "campaign.yaml").write_text(yaml.safe_dump(keys))
    return Eye(made, camera, board, np.random.default_rng([seed, 22]))


def _nearly(place: pin.SE3, rng: np.random.Generator) -> dict[str, Any]:
    """A place as a user measures it with a ruler."""
    turn = pin.rpy.matrixToRpy(place.rotation @ pin.rpy.rpyToMatrix(*(HINT_TURN * rng.standard_normal(3))))
    return {"xyz": (place.translation + HINT_PLACE * rng.standard_normal(3)).tolist(), "rpy": turn.tolist()}


def error(now: Session, eye: Eye) -> float:
    """95th percentile over the region of the tip's error now, [m]; see :func:`left`."""
    if now.posterior is None:
        return np.inf
    return left(*poses_now(now.posterior, now.region), now, eye)


def left(R: np.ndarray, p: np.ndarray, now: Session, eye: Eye) -> float:
    """95th percentile of what tips (n, 3, 3), (n, 3) are off by once base and tip are laid over the true ones, [m]."""
    off = np.array([tip.translation for tip in eye.tips(now.region)]) - p
    moves = np.array([np.hstack([np.eye(3), -pin.skew(at), turn]) for at, turn in zip(p, R, strict=True)]).reshape(
        -1, 9
    )
    rest = off.ravel() - moves @ np.linalg.lstsq(moves, off.ravel(), rcond=None)[0]
    return float(np.quantile(np.linalg.norm(rest.reshape(-1, 3), axis=1), 0.95))


def measured(now: Session, eye: Eye, readings: np.ndarray, shot: int, taken_at: np.ndarray | None = None) -> list[int]:
    """Put an image into the table, or that of other readings; the new lines."""
    head, *lines = eye.image(readings, shot, taken_at)
    if not now.table.head:
        now.table.add(head)
    return [k for line in lines for k in now.table.add(line)]


def fed(now: Session, eye: Eye, readings: np.ndarray, shot: int, taken_at: np.ndarray | None = None) -> list[object]:
    """Take an image, and what is said to it; a pose that shows no corner is rejected."""
    new = measured(now, eye, readings, shot, taken_at)
    return list(now.taken(new) if new else now.reject())


def errors_of(campaign: Campaign, eye: Eye, poses: np.ndarray, counts: Sequence[int]) -> list[float]:
    """The true error after so many images of some poses, see :func:`models`."""
    now = session(campaign, eye.arm.simulation.robot, None)
    for shot, readings in enumerate(poses):
        measured(now, eye, readings, shot)
    return [error(now, eye) for _ in models(now, counts)]


def draw(arm: str, folder: Path, seed: int) -> Draw:
    """One draw."""
    eye = workcell(folder, arm, seed)
    campaign, robot = load_campaign(folder / "campaign.yaml"), eye.arm.simulation.robot
    prior = session(campaign, robot, None).prior
    assert prior is not None
    poses = draw_candidates(prior.setup, FLOOR_IMAGES, 1, np.random.default_rng([seed, 23])).readings
    counts = [n for n in COUNTS if n <= len(poses)]
    random = errors_of(campaign, eye, poses, counts)
    plans = [count for count in PLANS if count <= MOST_IMAGES]

    def plan(tolerance: float) -> float:
        def keeps(count: int) -> bool:
            planned = design(beforehand(campaign, robot), PlanRequest(count)).readings
            return errors_of(campaign, eye, planned, (count // 2, *PLAN_FITS * (count,)))[-1] <= tolerance

        return smallest_plan(keeps, plans)

    tolerance = 2.0 * random[-1]
    now = session(campaign, robot, tolerance)
    events: list[object] = list(now.taken([]))
    led: list[float] = []
    claims: list[bool] = []
    stop, said, within = 0, False, False
    while len(led) < MOST_IMAGES and isinstance(events[-1], Next):
        before = len(now.table.rows)
        events = fed(now, eye, of(events[-1]), len(led))
        if len(now.table.rows) == before:
            continue
        led.append(error(now, eye))
        claims += [led[-1] <= event.position for event in events if isinstance(event, Known)]
        if isinstance(events[-1], Stop):
            stop, said = len(led), events[-1].why == "tolerance"
            within = said and left(*delivered_poses(folder, now, now.region), now, eye) <= tolerance
    return Draw(*judged(led, random, counts, plan, plans), stop, said, within, float(np.mean(claims)))


FAULTS = {"none": set(), "camera": {"slip"}, "board": {"slip"}, "stale": {"stale"}}
ALARMS, POWER = 1 / 500, 0.95


def least_sigmas() -> float:
    """Sigmas by which a move of a known thing at a known image must show to be told with :data:`POWER`, with so few false alarms.

    The most powerful test of six numbers that nobody knows, by a noncentral chi-square (Neyman and Pearson 1933 bound any other).
    """
    threshold = chi2.isf(ALARMS, 6)
    return float(np.sqrt(brentq(lambda shown: ncx2.sf(threshold, 6, shown) - POWER, 1e-3, 1e3)))


def shown_by(before: Posterior, now: Session, without: Eye, eye: Eye, first: int) -> float:
    """Sigmas by which what moved before an image shows in that one and those after it, beside all that is open of the rest.

    With s by how far the corners moved and F the columns of these rows, s' (1 + F Sigma F')^-1 s is its square.
    """
    assert now.read.every is not None
    some = np.flatnonzero(now.read.of >= first)
    rows = now.read.every.select(some)
    shift = []
    for reading, label in zip(rows.readings, rows.labels.refers[:, -1], strict=True):
        corner = CORNERS[[LABELS.index(str(label))]]
        seen = [(e.tips(reading[None])[0] * e.camera).inverse() * e.board for e in (without, eye)]
        there, here = (project(corner @ T.rotation.T + T.translation, LENS[None])[0] for T in seen)
        shift.append((here - there) / PIXELS)
    F, _ = columns_of(before.setup, rows)
    flat, s = F.reshape(-1, F.shape[2]), np.concatenate(shift)
    return float(np.sqrt(s @ np.linalg.solve(np.eye(len(s)) + flat @ before.covariance @ flat.T, s)))


@dataclass(frozen=True)
class Told:
    """What one draw of a fault came to.

    Attributes:
        told: Within two images.
        named: By its name.
        shown: Sigmas by which it shows in these; NaN of what is no move.
        clean: Images before it.
        alarms: Among these.
    """

    told: bool
    named: bool
    shown: float
    clean: int
    alarms: int


def fault(folder: Path, arm: str, what: str, seed: int) -> Told:
    """One draw."""
    eye = workcell(folder, arm, seed)
    rng = np.random.default_rng([seed, 24])
    at, shift = int(rng.integers(12, 22)), rng.normal(size=3)
    shift *= rng.uniform(5e-4, 3e-3) / np.linalg.norm(shift)
    now = session(load_campaign(folder / "campaign.yaml"), eye.arm.simulation.robot, None)
    events: list[object] = list(now.taken([]))
    alarms: list[tuple[int, Alarm]] = []
    n, last, without, before = 1, np.zeros(0), replace(eye), now.posterior
    while n <= at + 2:
        following = events[-1]
        if isinstance(following, Stop):
            (following,) = _gone_on(now)
        assert isinstance(following, Next)
        if n == at:
            before = now.posterior
            if what == "camera":
                eye.camera = pin.SE3(without.camera.rotation, without.camera.translation + shift)
            if what == "board":
                eye.board = pin.SE3(without.board.rotation, without.board.translation + shift)
        readings, count = of(following), len(now.table.rows)
        events = fed(now, eye, readings, n, last if n == at and what == "stale" else readings)
        if len(now.table.rows) > count:
            alarms += [(n, event) for event in events if isinstance(event, Alarm)]
            n, last = n + 1, readings
    late = [alarm for number, alarm in alarms if number >= at] if FAULTS[what] else []
    named = any(alarm.what in FAULTS[what] for alarm in late)
    clean = at - 1 if FAULTS[what] else at + 2
    moved = what in ("camera", "board") and before is not None
    shown = shown_by(before, now, without, eye, at - 1) if moved and before is not None else np.nan
    return Told(bool(late), named, shown, clean, sum(number <= clean for number, _ in alarms))


def faults(arms: list[str], seeds: range) -> None:
    """Faults put in between the 12th and the 22nd image, and none."""
    least = least_sigmas()
    print(f"a move that shows by less than {least:.1f} sigma: no test tells 95 % of them with one false alarm in 500")
    print("arm     fault   told  as      told of those that show  images without a fault  alarms", flush=True)
    for arm in arms:
        for what in FAULTS:
            draws = []
            for seed in seeds:
                with tempfile.TemporaryDirectory() as name:
                    draws.append(fault(Path(name), arm, what, seed))
            show = [draw for draw in draws if not draw.shown < least]
            print(
                f"{arm:7s} {what:7s} {sum(d.told for d in draws):3d}/{len(draws)} {sum(d.named for d in draws):3d}/{len(draws)} "
                f"{sum(d.told for d in show):12d}/{len(show)} {sum(d.clean for d in draws):20d} "
                f"{sum(d.alarms for d in draws):14d}   not told, sigma: "
                f"{', '.join(f'{d.shown:.1f}' for d in draws if not d.told and FAULTS[what]) or 'none'}",
                flush=True,
            )


def limit(arm: str, folder: Path, seed: int) -> Fewest:
    """Images until twice the sigma of 100 random ones is kept: random, greedy, and the bound."""
    eye = workcell(folder, arm, seed)
    now = session(load_campaign(folder / "campaign.yaml"), eye.arm.simulation.robot, None)
    assert now.prior is not None
    rng = np.random.default_rng([seed, 23])
    for shot, readings in enumerate(draw_candidates(now.prior.setup, FLOOR_IMAGES, 1, rng).readings):
        measured(now, eye, readings, shot)
    return fewest(now, rng)


def main() -> None:
    parser = draws_of(__doc__)
    parser.add_argument("--faults", action="store_true")
    parser.add_argument("--limit", action="store_true")
    arguments = parser.parse_args()
    if arguments.faults:
        faults(arguments.arm or list(ARMS), seeds_of(arguments))
    elif arguments.limit:
        print(f"{'':20s} {LIMIT_COLUMNS}", flush=True)
        for arm in arguments.arm or ARMS:
            print_limits(f"{arm} images", seeds_of(arguments), partial(limit, arm))
    else:
        print(f"{'':28s} {COLUMNS}", flush=True)
        for arm in arguments.arm or ARMS:
            print_draws(f"{arm} images", seeds_of(arguments), partial(draw, arm))


if __name__ == "__main__":
    main()
