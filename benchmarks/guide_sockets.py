"""How many touches being led saves where a ball is held in sockets and nothing else measures.

    python benchmarks/guide_sockets.py 10                  # draws of a UR10, a 7R, a SCARA and a gantry
    python benchmarks/guide_sockets.py 10 --first 20 --arm UR10
    python benchmarks/guide_sockets.py 2 --limit           # the fewest touches of any choice, as ``guide.py limit``

The machines are those of ``guide.py``. Six sockets stand anywhere in reach, in three pairs whose lengths are known to 0.01 mm;
their places are not known. A touch is the joints that hold the ball of the true machine in a socket, noise of 0.05 mm in it.
Random touches are of a random socket from random joints. What is led begins with three touches each of one socket after the
other until poses are proposed; a socket that is then asked for is touched once. Sockets do not tell where the base is: errors are
those of the target's place at 95 % of the region once the two are laid over each other. The floor is what is left after 200
random touches; judged as in ``guide.py``: rows from which on the error stays within twice the floor, and the truth where the
tolerance is said to be kept. Nothing can be planned beforehand, as nobody knows where the sockets are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from guide import (
    ARMS,
    COLUMNS,
    COUNTS,
    FLOOR_ROWS,
    LIMIT_COLUMNS,
    MOST_ROWS,
    NOISE,
    Draw,
    Fewest,
    cell,
    draws_of,
    fewest,
    judged,
    models,
    poses_now,
    print_draws,
    print_limits,
    seeds_of,
)
from scipy.spatial.transform import Rotation

from aridcal.engine.inverse.reachable import draw_readings, inner_limits
from aridcal.files.campaign import Campaign, load_campaign
from aridcal.jobs.guide.events import Known, Next, Stop
from aridcal.jobs.guide.session import Session, session
from aridcal.jobs.simulate.live import LiveArm

PAIRS, LENGTH_STD = 3, 1e-5
STEPS, EXACT, NUDGE = 30, 1e-9, 1e-6


@dataclass
class Ball:
    """A true machine with a ball at its tip, and sockets around it.

    Attributes:
        arm: The machine.
        sockets: Place of each by its name, (3,), [m] in the base.
        noise: Draws how far the ball is off the middle of a socket.
    """

    arm: LiveArm
    sockets: dict[str, np.ndarray]
    noise: np.random.Generator

    def places(self, readings: np.ndarray) -> np.ndarray:
        """Where the ball is in the base, shape (n, 3), [m]."""
        _, p = self.arm.model.poses(self.arm.simulation.theta, self.arm.model.rows(readings))
        ((_, base),) = self.arm.model.world_base
        return np.asarray((p - base.translation) @ base.rotation)

    def touch(self, start: np.ndarray, name: str) -> np.ndarray | None:
        """Joints near a start, shape (columns,), that hold the ball in a socket; None if there are none within the limits."""
        low, high = inner_limits(self.arm.simulation.robot)
        wanted = self.sockets[name] + NOISE["position"]["position"] * self.noise.standard_normal(3)
        q = start.copy()
        for _ in range(STEPS):
            at, *moved = self.places(np.vstack([q, q + NUDGE * np.eye(len(q))]))
            if np.linalg.norm(wanted - at) < EXACT:
                break
            q = q + np.linalg.pinv((np.array(moved) - at).T / NUDGE, rcond=1e-3) @ (wanted - at)
        else:
            return None
        return q if np.all((low <= q) & (q <= high)) else None

    def anywhere(self, name: str, rng: np.random.Generator) -> np.ndarray:
        """Joints at random that hold the ball in a socket, shape (columns,)."""
        while True:
            q = self.touch(draw_readings(self.arm.simulation.robot, 1, rng, inner_limits)[0], name)
            if q is not None:
                return q

    def line(self, readings: np.ndarray, name: str) -> tuple[bytes, bytes]:
        """A row of the table: the header, and the line."""
        frame = pd.DataFrame([[*readings.tolist(), name]], columns=[*self.arm.simulation.robot.readings, "point"])
        head, row, _ = frame.to_csv(index=False).encode().split(b"\n")
        return head, row


def workcell(folder: Path, arm: str, seed: int) -> Ball:
    """Draw a machine and its sockets; the campaign is written beside."""
    rng = np.random.default_rng([seed, 11])
    made = cell(folder, arm, "position", seed).arm
    ball = Ball(made, {}, np.random.default_rng([seed, 12]))
    robot = made.simulation.robot
    places = ball.places(draw_readings(robot, 2 * PAIRS, rng, inner_limits))
    ball.sockets.update({f"s{k}": place for k, place in enumerate(places)})
    ends = [(f"s{2 * k}", f"s{2 * k + 1}") for k in range(PAIRS)]
    keys = yaml.safe_load((folder / "campaign.yaml").read_text())
    keys["measurements"] = {"file": "measurements.csv", "kind": "point", "noise": NOISE["position"]}
    target = made.simulation.frames["tip_target"].translation + 0.002 * rng.standard_normal(3)
    keys["frames"] = {"tip_target": {"xyz": target.tolist()}}
    keys["instruments"] = {
        "lengths": [
            {
                "between": [one, two],
                "length": float(
                    np.linalg.norm(ball.sockets[one] - ball.sockets[two]) + LENGTH_STD * rng.standard_normal()
                ),
                "std": LENGTH_STD,
            }
            for one, two in ends
        ]
    }
    (folder / "campaign.yaml").write_text(yaml.safe_dump(keys))
    return ball


def error(now: Session, ball: Ball) -> float:
    """95th percentile over the region of the target's error, the base laid over the true one, [m]."""
    if now.posterior is None:
        return np.inf
    _, p = poses_now(now.posterior, now.region)
    true = ball.places(now.region)
    p, true = p - p.mean(axis=0), true - true.mean(axis=0)
    turn, _ = Rotation.align_vectors(true, p)
    return float(np.quantile(np.linalg.norm(turn.apply(p) - true, axis=1), 0.95))


def measured(now: Session, ball: Ball, readings: np.ndarray, name: str) -> list[int]:
    """Put the touch of a socket into the table; the new line."""
    head, line = ball.line(readings, name)
    if not now.table.head:
        now.table.add(head)
    return list(now.table.add(line))


def _at_random(campaign: Campaign, ball: Ball, rng: np.random.Generator) -> Session:
    """A session with random touches, none of them looked at yet."""
    now = session(campaign, ball.arm.simulation.robot, None)
    for _ in range(FLOOR_ROWS):
        name = str(rng.choice(list(ball.sockets)))
        measured(now, ball, ball.anywhere(name, rng), name)
    return now


def limit(arm: str, folder: Path, seed: int) -> Fewest:
    """Touches until twice the sigma of 200 random ones is kept: random, greedy, and the bound."""
    ball, rng = workcell(folder, arm, seed), np.random.default_rng([seed, 13])
    return fewest(_at_random(load_campaign(folder / "campaign.yaml"), ball, rng), rng)


def draw(arm: str, folder: Path, seed: int) -> Draw:
    """One draw."""
    ball, rng = workcell(folder, arm, seed), np.random.default_rng([seed, 13])
    campaign, robot = load_campaign(folder / "campaign.yaml"), ball.arm.simulation.robot
    names = list(ball.sockets)
    at_random = _at_random(campaign, ball, rng)
    random = [error(at_random, ball) for _ in models(at_random, COUNTS)]
    tolerance = 2.0 * random[-1]
    now = session(campaign, robot, tolerance)
    events: list[object] = list(now.taken([]))
    led: list[float] = []
    claims: list[bool] = []
    stop, said, within = 0, False, False
    while len(led) < MOST_ROWS:
        following = events[-1]
        if isinstance(following, Stop):
            stop, said = len(led), following.why == "tolerance"
            within = said and led[-1] <= tolerance
            break
        assert isinstance(following, Next)
        if following.joints:
            name = following.labels["point"]
            q = ball.touch(np.array(list(following.joints.values())), name)
            if q is None:
                events = list(now.reject())
                continue
        else:
            name = following.labels.get("point", names[len(led) // 3 % len(names)])
            q = ball.anywhere(name, rng)
        events = list(now.taken(measured(now, ball, q, name)))
        led.append(error(now, ball))
        claims += [led[-1] <= event.position for event in events if isinstance(event, Known)]
    return Draw(*judged(led, random, COUNTS, lambda _: np.nan), stop, said, within, float(np.mean(claims)))


def main() -> None:
    parser = draws_of(__doc__)
    parser.add_argument("--limit", action="store_true")
    arguments = parser.parse_args()
    print(f"{'':20s} {LIMIT_COLUMNS}" if arguments.limit else f"{'':28s} {COLUMNS}", flush=True)
    for arm in arguments.arm or ARMS:
        if arguments.limit:
            print_limits(f"{arm} sockets", seeds_of(arguments), partial(limit, arm))
            continue
        print_draws(f"{arm} sockets", seeds_of(arguments), partial(draw, arm))


if __name__ == "__main__":
    main()
