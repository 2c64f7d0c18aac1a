"""A campaign that is being measured: what is said to each row, which pose is next, when it is enough."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import FRAME_COMPONENTS, MOUNTING_FRAMES, ROW_ORDER, Coefficient
from aridcal.engine.instruments.channels import columns
from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.collisions import Bodies
from aridcal.engine.rows.dataset import Dataset
from aridcal.files.campaign import Campaign
from aridcal.files.counting import counting
from aridcal.files.orientations import column_of
from aridcal.jobs.guide.accuracy import AXES, DRAWS, Beside, bound
from aridcal.jobs.guide.early_rows import Suppositions, is_young, weigh
from aridcal.jobs.guide.events import Alarm, Event, Known, Next, RowRead, Stop, Why
from aridcal.jobs.guide.growing_table import GrowingTable
from aridcal.jobs.guide.judgement import FALSE_ALARM, Inflation, Verdict, beside_others, verdict
from aridcal.jobs.guide.movement import FrameMovement, movement
from aridcal.jobs.guide.next_pose import (
    AHEAD,
    PLACES,
    Pool,
    ahead,
    best_first,
    drawn,
    gain_ahead,
    more_of,
    pool,
    reaches,
    region_columns,
    told_by,
    worth,
)
from aridcal.jobs.guide.posterior import Posterior, before_rows, begun, fitted, inverse, moved_by, with_suspects
from aridcal.jobs.guide.row_reading import RowsSoFar, no_rows, rows_so_far
from aridcal.jobs.guide.shown_effects import left_out
from aridcal.jobs.guide.table_facts import Oddity, in_other_units, not_renewed, oddities, refusal
from aridcal.jobs.plan.configurations import Candidates, offers
from aridcal.jobs.plan.information import whitened
from aridcal.jobs.plan.prior_knowledge import NothingStated, bodies, from_nothing
from aridcal.jobs.plan.target_region import region_readings
from aridcal.system.errors import CampaignError, NotOfThisRobot

WINDOW = 5
"""Rows back to which a slip is looked for: one that is too small for two rows shows within some more."""

GROWN = 1.15
"""Share by which rows of one batch grow until the fit is made anew within it: what is linear about a fit lasts that long."""

REPEAT_UNDECLARED, REPEAT_DECLARED = 8, 25
"""Rows after which an earlier pose is measured again: where the noise is not declared it is told by such rows alone; elsewhere
they say now and then that nothing moved."""

POOL_LASTS = 10
"""Rows after which other configurations are drawn."""

HARDLY = 0.05
"""Share by which ten more rows must make the target better known to be worth their time."""

FORESEEN = 100
"""Rows beyond which it is not said how many more the tolerance takes: so far ahead it was seen to be wrong by factors."""

FEWEST_BESIDE = 12.0
"""Numbers predicted without which nothing is said to be within a tolerance."""

BELATED = 1e-6
"""Probability of a good row to be off as much beside all others, below which it is called bad after all: asked of all rows again
and again, so that it must be rarer than :data:`FALSE_ALARM`."""

TURN_BACK = 0.05
"""Probability from which on a row that was off agrees with the others after all."""

SLIPPED = 3.0
"""Times the likeliest size of a slip that each of its six numbers may have."""

FRAMES_IN_DOUBT = 60.0
"""Numbers measured, ten poses, up to which a row that is off may be good, and the frames found before it wrong: they are
sought again with it."""

WITNESSES = 12
"""Work: Earlier rows near a pose to which a way is sought, to measure one of them again."""

CHECKS = 5
"""Poses that check a calibration."""


NO_LENGTH = (
    "; no length is known, so that nothing tells how large the arm is: measure how far two of the points are apart, and state it "
    "under `instruments.lengths`"
)
"""What touches lack where nobody says where the points are."""


@dataclass
class Session:
    """What has been measured so far, and what is said to it; it is changed by :meth:`taken`.

    Attributes:
        campaign: What is measured.
        robot: The nominal chain.
        tolerance: What the target is to be known to in 95 % of the region, [m]; None: as well as can be.
        table: Lines so far.
        read: Them as rows.
        good: Which measurements are in use, by the index of their first line.
        around: Shapes that can touch each other.
        prior: What was known before any row; None where nobody says where all is that rows refer to.
        region: Readings where the target is to be known, shape (R, columns); none until anything is known.
        rng: Draws configurations.
        posterior: What is known now; None while rows are too few to say where the frames are.
        inflation: By how much rows are off more than predicted.
        beside: How far predictions were off.
        candidates: Configurations to choose from.
        drawn_at: Measurements when these were drawn.
        drawn_with: Whether frames were known then.
        repeated_at: Rows in use when a pose was last measured again.
        rejected: Poses that the user does not want now.
        first_points: Points of which the model knew when it began: poses are drawn of these.
        point_by_hand: Point that the user was asked to bring the arm to; "" if none.
        skipped_points: Points to which the arm cannot be brought.
        proposed: The last pose that was proposed.
        suspect: Line of a row that is off, to be settled by the next one.
        slips: Line of the first row after each slip, and the frames that may have moved.
        off: Lines of rows that are off for no reason that they show themselves.
        called_off: Those of them that were taken for good until later rows showed otherwise.
        stopped: True after the end.
        fitted_rows: Rows of the last fit.
    """

    campaign: Campaign
    robot: Robot
    tolerance: float | None
    table: GrowingTable
    read: RowsSoFar
    good: dict[int, bool]
    around: Bodies
    prior: Posterior | None
    region: np.ndarray
    rng: np.random.Generator
    posterior: Posterior | None = None
    inflation: Inflation = field(default_factory=Inflation)
    beside: Beside = field(default_factory=Beside)
    candidates: Candidates | None = None
    drawn_at: int = 0
    repeated_at: int = 0
    rejected: tuple[np.ndarray, ...] = ()
    first_points: frozenset[str] = frozenset()
    point_by_hand: str = ""
    skipped_points: set[str] = field(default_factory=set)
    suspect: int | None = None
    slips: tuple[tuple[int, tuple[str, ...]], ...] = ()
    off: set[int] = field(default_factory=set)
    called_off: set[int] = field(default_factory=set)
    proposed: np.ndarray | None = None
    drawn_with: bool = False
    stopped: bool = False
    fitted_rows: int = 0

    # -- rows ---------------------------------------------------------------------------------------------------------------

    def taken(self, new: Sequence[int]) -> list[Event]:
        """What is said to new lines of the table.

        Args:
            new: Their indices; none: what is said before any.

        Raises:
            AridcalError: the table does not fit the campaign.
        """
        events: list[Event] = []
        if new:
            self.read = rows_so_far(self.campaign, self.robot, self.table, self.read)
            if self.read.rows is None and len(self.table.rows) >= FEW_BAD:
                raise CampaignError(f"{self.campaign.path}: none of the rows can be used: {self.read.refused[new[0]]}")
            self.suspect = None
            for k in self._heads(new):
                events += self._row(k)
            self.skipped_points -= self._labels()
            events += self._afterwards(new)
            self.rejected = ()
            self.point_by_hand = ""
        return [*events, *self._ahead()]

    def _heads(self, new: Sequence[int]) -> list[int]:
        """Those of new lines that begin a measurement, or are no row: the other rows of an image come with its first."""
        if not self._images:
            return list(new)
        within = set(self.read.lines.tolist()) - set(self.read.index.tolist())
        return [k for k in new if k not in within]

    def _row(self, k: int) -> list[Event]:
        """Judge the measurement that begins with a line beside all before it."""
        line = self.table.line(k)
        place = np.flatnonzero(self.read.index == k)
        if self.read.rows is None or not len(place):
            odd = refusal(line, self.read.refused.get(k, "cannot be used"))
            self.good[k] = False
            return [RowRead(line, False, (odd.words,)), Alarm(line, odd.what, odd.words, odd.do)]
        at = int(place[0])
        rows = self.read.rows
        lines = np.array([self.table.line(int(j)) for j in self.read.index])
        usable = np.array([self.good.get(int(j), False) for j in self.read.index])
        odd_ones = list(oddities(rows, at, lines, usable))
        bad = any(odd.bad for odd in odd_ones)
        if not bad and self.posterior is not None:
            more = self._beside_others(k, at, rows)
            odd_ones += more
            bad = any(odd.bad for odd in more)
        self.good[k] = not bad
        slip = [] if self.posterior is None else self._moved(at, rows)
        if slip:  # then the row is good after all
            odd_ones = [odd for odd in odd_ones if odd.what != "outlier"]
        count = len(self.read.lines_of(at)) if self._images else 1
        events: list[Event] = [RowRead(line, self.good[k], tuple(odd.words for odd in odd_ones), count)]
        events += [Alarm(line, odd.what, odd.words, odd.do) for odd in odd_ones]
        events += slip
        if self.posterior is None:
            events += self._begin(line)
        elif sum(self.good.values()) > GROWN * self.fitted_rows:
            self._fit()
        return events

    def _beside_others(self, k: int, at: int, rows: Dataset) -> list[Oddity]:
        """Judge a row by its residual."""
        assert self.posterior is not None
        if not self._knows()[at]:
            return []  # a label that is new: the model begins anew with it
        F, r = self._columns(np.array([at]))
        judged = verdict(self.posterior, F[0], r[0], self.inflation)
        if not judged.off:
            self._add(F, r, judged)
            return []
        if self._begun_wrong(k) or self._is_unsure(at):
            return []
        line = self.table.line(k)
        for words, other in in_other_units(rows, at) if self._places else ():
            G, s = self.posterior.columns(other, np.arange(len(other)))
            if verdict(self.posterior, G[0], s[0], self.inflation).probability > TURN_BACK:
                return [
                    Oddity(
                        "unit",
                        f"row {line} is as if it were written in {words}",
                        "check the unit in which the driver writes, and measure it again",
                        True,
                    )
                ]
        stale = not_renewed(rows, at, self.read.shift(at), float(self.posterior.setup.sigma[0]))
        if stale:
            return [
                Oddity(
                    "stale",
                    f"row {line}: {stale}",
                    "wait until arm and instrument are still, and measure it again",
                    True,
                )
            ]
        self.suspect = k
        self.off.add(k)
        again = self._witness(at, rows)
        what = "the camera or the board" if self._images else "the tripod or the target"
        do = (
            f"measure row {self.table.line(again)} again: if it is off, too, {what} moved; if not, row {line} was a bad reading"
            if again is not None
            else f"measure the next pose: if it is off, too, {what} moved; if not, row {line} was a bad reading"
        )
        return [Oddity("outlier", f"row {line} is off by {self._size(judged)}", do, True)]

    @property
    def _places(self) -> bool:
        """Whether rows measure the target's own place."""
        return self.campaign.measurements.traits.places

    def _columns(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns and residuals of some measurements at the last fit, in sigmas; see :meth:`Posterior.columns`."""
        assert self.posterior is not None
        return self.posterior.columns(*self.read.some(numbers))

    def _begun_wrong(self, k: int) -> bool:
        """Whether frames sought again with an early row explain it and all before it; they are then gone on with."""
        before, rows_of_fit, good = self.posterior, self.fitted_rows, dict(self.good)
        used = [j for j, is_good in self.good.items() if is_good or j in self.off]
        assert before is not None
        if len(used) * self._numbers > FRAMES_IN_DOUBT or self.slips:
            return False
        self.good = good | dict.fromkeys([*used, k], True)
        self.posterior = None
        self._begin(0)
        at = int(np.flatnonzero(self.read.index == k)[0])
        if self.posterior is not None and self._suppositions([]).spoiling(FALSE_ALARM) != at:
            self.off -= {*used, k}
            return True
        self.posterior, self.fitted_rows, self.good = before, rows_of_fit, good
        return False

    @property
    def _young(self) -> bool:
        """Whether rows are so few that a bad one hides."""
        assert self.posterior is not None
        return is_young(self.posterior, sum(self.good.values()) * self._numbers)

    def _suppositions(self, more: Sequence[int]) -> Suppositions:
        """Leave each row in use out in turn, and some more; rows by their numbers among those read."""
        assert self.posterior is not None
        used = self._in_use()
        rows = np.union1d(used, np.array(more, dtype=int))
        answer = weigh(self.posterior, np.isin(rows, used), *self._columns(rows), self._frames())
        moves = tuple(replace(move, first=int(rows[move.first])) for move in answer.moves)
        return replace(answer, rows=rows[answer.rows], moves=moves)

    def _frames(self) -> dict[str, np.ndarray]:
        """Columns of each frame, camera and board that can move, at most six."""
        assert self.posterior is not None
        roles = self.posterior.setup.model.instruments.things.values()
        placed = (*MOUNTING_FRAMES, *(name for t in roles if not t.role.many for name in t.names))
        return {where: some for where in placed if len(some := self._open(where))}

    def _open(self, where: str) -> np.ndarray:
        """Columns of the components of a place that are unknown, at most six."""
        assert self.posterior is not None
        names, things = self.posterior.setup.model.names, self.posterior.things
        numbers = [things + names.index(name) for c in FRAME_COMPONENTS if (name := f"{where}.{c}") in names]
        return np.array(numbers, dtype=int)

    def _is_unsure(self, at: int) -> bool:
        """Whether a row that is off among few may be good, and another bad: the rows to come tell. It is then in use."""
        if not self._young or self._suppositions([at]).spoiling(FALSE_ALARM) == at:
            return False
        assert self.posterior is not None
        F, r = self._columns(np.array([at]))
        self.posterior = self.posterior.with_rows(F, r)
        return True

    def _add(self, F: np.ndarray, r: np.ndarray, judged: Verdict) -> None:
        """Let a good row count."""
        assert self.posterior is not None
        self.inflation = self.inflation.with_row(judged)
        off = self._off(F, judged)
        if off is not None:
            self.beside = self.beside.with_row(*off)
        self.posterior = self.posterior.with_rows(F, r)

    @property
    def _numbers(self) -> int:
        """Numbers that a measurement tells of where the target is: of an image those of a body."""
        assert self.posterior is not None
        if self._images:
            return len(FRAME_COMPONENTS)
        return sum(channel.size for channel in self.posterior.setup.patterns.channels)

    def _off(self, F: np.ndarray, judged: Verdict) -> tuple[np.ndarray, np.ndarray] | None:
        """By how much a row was off at the target, [m] along each axis, and the variances of that; None if not told."""
        assert self.posterior is not None
        setup = self.posterior.setup
        spread = judged.spread / self.inflation.variance
        if self._images:
            G = self._as_if_moved(F[0])
            if G is None:
                return None
            G = G[np.any(F[0] != 0.0, axis=1)]
            solve = np.linalg.pinv(G)
            return solve @ judged.error, np.diag(solve @ spread @ solve.T)
        first = columns(setup.patterns.channels)[0]
        measured = np.any(F[0] != 0.0, axis=1)
        if not measured[first].all() or len(judged.error) < first.stop:
            return None
        sigma = setup.sigma[0]
        return judged.error[first] * sigma, np.diag(spread)[first] * sigma**2

    def _as_if_moved(self, F: np.ndarray) -> np.ndarray | None:
        """Columns of an image, F (p, D), as if camera, board or the last joint were elsewhere, shape (p, 3).

        Not turned besides: turns look like moves from so near, and of both together an image tells little.
        """
        places = (self._open(where) for where in (*self._frames(), *reversed(self.robot.names)))
        whole = next((some for some in places if len(some) == len(FRAME_COMPONENTS)), None)
        return None if whole is None else F[:, whole[:AXES]]

    def _size(self, judged: Verdict) -> str:
        """How far off a row is, in words."""
        assert self.posterior is not None
        channels = self.posterior.setup.patterns.channels
        parts = []
        if not self._images and len(judged.error) == sum(channel.size for channel in channels):
            for channel, part, sigma in zip(channels, columns(channels), self.posterior.setup.sigma, strict=True):
                parts.append(f"{np.linalg.norm(judged.error[part]) * sigma * channel.scale:.3g} {channel.shown}")
        return f"{', '.join(parts)}, {judged.sigmas:.1f} sigma".lstrip(", ")

    def _witness(self, at: int, rows: Dataset) -> int | None:
        """The line of an earlier good row that the arm gets to from this pose, to be measured again; None if there is none."""
        earlier = [j for j in range(at) if self.good.get(int(self.read.index[j]))]
        earlier.sort(key=lambda j: float(np.abs(rows.readings[j] - rows.readings[at]).max()))
        now = self._now()
        for j in earlier[:WITNESSES] if now is not None else []:
            if now is not None and reaches(now, rows.readings[at], rows.readings[j], 0):
                return int(self.read.index[j])
        return None

    def _moved(self, at: int, rows: Dataset) -> list[Event]:
        """Look whether a frame moved within the last rows."""
        assert self.posterior is not None
        # Not of touches: things whose places nobody knows give way like frames, and clean rows had a slip in 45.
        if self._young and not self.campaign.measurements.traits.touches:
            off = self.off - self.called_off
            recent = [j for j in range(max(0, at - WINDOW + 1), at + 1) if int(self.read.index[j]) in off]
            early = self._suppositions(recent).movement()
            return self._slip(early, rows, at) if early else []
        judged = [j for j in range(max(0, at - WINDOW + 1), at + 1) if self._judges(int(self.read.index[j]))]
        judged = [j for j, known in zip(judged, self._knows()[judged], strict=True) if known]
        if len(judged) < 2 or all(self.good[int(self.read.index[j])] for j in judged):
            return []
        F, r = self._columns(np.array(judged))
        found: list[FrameMovement] = []
        before = self.posterior
        in_use = [self.good[int(self.read.index[j])] for j in judged]
        for first in range(len(judged) - 1, -1, -1):
            if in_use[first]:
                before = before.with_rows(F[first : first + 1], r[first : first + 1], -1.0)
            if first == len(judged) - 1:
                continue
            parts = [np.any(row != 0.0, axis=1) for row in F[first:]]
            flat = np.concatenate([row[part] for row, part in zip(F[first:], parts, strict=True)])
            residual = np.concatenate([row[part] for row, part in zip(r[first:], parts, strict=True)])
            error = residual - flat @ before.step
            spread = self.inflation.variance * (np.eye(len(error)) + flat @ before.covariance @ flat.T)
            by_frame = {where: flat[:, some] for where, some in self._frames().items()}
            split = np.split(error, np.cumsum([int(part.sum()) for part in parts])[:-1])
            answer = movement(split, spread, by_frame, judged[first])
            found += [answer] if answer else []
        if not found:
            return []
        best = max(found, key=lambda one: one.odds)
        return self._slip(best, rows, at)

    def _slip(self, best: FrameMovement, rows: Dataset, at: int) -> list[Event]:
        """Go on with a frame that is elsewhere since a row."""
        assert self.posterior is not None
        first = int(self.read.index[best.first])
        line = self.table.line(first)
        step = Basis("step", (ROW_ORDER,), (line - 0.5,))
        more = [
            Coefficient(where, c, step)
            for where in best.frames
            for c in FRAME_COMPONENTS
            if f"{where}.{c}" in self.posterior.setup.model.names
        ]
        for j in self.read.index[best.first : at + 1].tolist():
            self.good[j] = self.good[j] or self._judges(j)
        self.posterior = moved_by(self.posterior, more, SLIPPED * best.size)
        self.slips = (*self.slips, (first, best.frames))
        self.suspect = None
        self._fit()
        words = {"world_base": "the tripod (or the robot's base)", "tip_target": "the target"}
        words |= {name: f"the camera {name}" for name in self.campaign.instruments.cameras}
        names = " or ".join(words.get(where, f"the {where.replace('_', ' ')}") for where in best.frames)
        return [
            Alarm(
                line,
                "slip",
                f"{names} moved before row {line}: since then all rows are off alike",
                "fasten it where it is now and go on: rows before and after are both used, each with its own place; do not "
                "put it back",
            )
        ]

    def _judges(self, k: int) -> bool:
        """Whether a line says anything of slips: it is good, or off for no other reason."""
        return self.good.get(k, False) or k in self.off

    def serving(self) -> list[int]:
        """Lines that are rows for the full search, which judges by itself which rows are outliers."""
        heads = self.read.index[self.read.of].tolist()
        return [k for k, head in zip(self.read.lines.tolist(), heads, strict=True) if self._judges(head)]

    def _knows(self) -> np.ndarray:
        """Measurements of which the model knows all that they refer to, shape (n,) bool."""
        rows = self.read.every
        assert self.posterior is not None and rows is not None
        model = self.posterior.setup.model
        knows = np.ones(len(rows), dtype=bool)
        if rows.labels.target is not None:
            knows &= np.isin(rows.labels.target.astype(str), [str(name) for name, _ in model.tip_target])
        if rows.blocks[0].traits.touches:  # not the model's own points: a fit takes in all that the table names
            return knows & np.isin(rows.labels.refers[:, 0], [*self.first_points])
        for k, role in enumerate(rows.blocks[0].traits.roles):
            things = model.instruments.things.get(role.name)
            if things is not None:
                knows &= np.isin(rows.labels.refers[:, k], ["", *things.names])
        return np.asarray(np.bincount(self.read.of, ~knows) == 0)

    # -- fits ---------------------------------------------------------------------------------------------------------------

    def _in_use(self) -> np.ndarray:
        """Numbers of the measurements in use that the model knows."""
        good = np.array([self.good.get(int(k), False) for k in self.read.index], dtype=bool)
        return np.flatnonzero(good if self.posterior is None else good & self._knows())

    def _begin(self, line: int) -> list[Event]:
        """Find frames and things from the rows so far, if they are enough."""
        some = self._in_use()
        if not len(some):
            return []
        rows, _ = self.read.some(some)
        prior = None if self.prior is None else self.prior.setup
        try:
            setup = begun(self.campaign, self.robot, self.around, prior, rows)
        except NotOfThisRobot as error:
            if len(some) < FEW_STRANGE:
                return []
            return [Alarm(line, "robot", str(error), "check the campaign, or let `aridcal init` read this table")]
        if setup is not None:
            if not len(self.region):
                self.region = region_readings(setup, None, self.rng)[:PLACES]
            self.posterior = before_rows(setup)
            self.first_points = frozenset(
                [*rows.labels.refers[:, 0].tolist(), *setup.patterns.labels.refers[:, 0].tolist()]
            )
            self._fit()
            self._fit()  # in the noise and the sizes that the first one suggests
        return []

    def _fit(self) -> None:
        """Fit all rows in use anew."""
        assert self.posterior is not None
        some = self._in_use()
        self.posterior = fitted(self.posterior, self.read.some(some)[0])
        self.fitted_rows = len(some)

    def _afterwards(self, new: Sequence[int]) -> list[Event]:
        """Fit anew after a batch, and look at earlier rows again."""
        if self.posterior is None:
            return []
        if any(
            self.good.get(int(k)) for k in self.read.index[~self._knows()]
        ):  # with what is new the model begins anew
            before, self.posterior = self.posterior, None
            self.candidates = None  # those so far are not of what is new
            self._begin(0)
            self.posterior = self.posterior or before
        self._fit()
        return self._belated(set(new))

    def _belated(self, new: set[int]) -> list[Event]:
        """Rows that turn out bad beside those after them, and rows that turn out good."""
        assert self.posterior is not None
        events: list[Event] = []
        worst = self._spoiling(self._in_use())
        while worst is not None:
            events += self._called_off(worst)
            worst = None if self.posterior is None else self._spoiling(self._in_use())
        if self.posterior is None:
            return events
        changed = False
        for j in np.setdiff1d(np.flatnonzero(self._knows()), self._in_use()).tolist():
            k = int(self.read.index[j])
            if k in self.off and k not in new:
                F, r = self._columns(np.array([j]))
                if verdict(self.posterior, F[0], r[0], self.inflation).probability > TURN_BACK:
                    self.good[k], changed = True, True
                    self.off.discard(k)
        if changed:
            self._fit()
        return events

    def _spoiling(self, used: np.ndarray) -> int | None:
        """The row in use that does not fit all others, by its number; None if there is no such row."""
        assert self.posterior is not None
        if not len(used):
            return None
        if self._young:
            return self._suppositions([]).spoiling(BELATED)
        probability = beside_others(self.posterior, *self._columns(used), self.inflation)
        worst = int(np.argmin(probability))
        return int(used[worst]) if probability[worst] < BELATED else None

    def _called_off(self, at: int) -> list[Event]:
        """Go on without a row that does not fit the rest."""
        k = int(self.read.index[at])
        line = self.table.line(k)
        words = f"row {line} does not fit the rest"
        alarm = Alarm(line, "outlier", words, f"measure row {line} again, or delete it: it is left out")
        young, before, slips = self._young, dict(self.good), self.slips
        self.called_off.add(k)
        self.off.add(k)
        self.good[k] = False
        if not young:
            self._fit()
            return [alarm, RowRead(line, False, (words,))]
        moved = self._judged_anew(before)
        again = [
            RowRead(self.table.line(j), good, () if good else (words if j == k else "it does not fit the rest",))
            for j, good in self.good.items()
            if good != before[j]
        ]
        known = {self.table.line(first) for first, _ in slips}
        return [alarm, *again, *(slip for slip in moved if slip.row not in known)]

    def _judged_anew(self, before: Mapping[int, bool]) -> list[Alarm]:
        """Judge all rows again, one after another, as if those that were called off had never been; slips that this tells.

        Args:
            before: Which lines were in use: the others, but for those that were off beside other rows, stay out of it.
        """
        refused = {j for j, good in before.items() if not good and j not in self.off} | self.called_off
        self.good, self.off, self.slips, self.suspect = {}, set(), (), None
        self.posterior, self.inflation, self.beside = None, Inflation(), Beside()
        events: list[Event] = []
        for j in before:
            if j in refused:
                self.good[j] = False
            else:
                events += self._row(j)
        self.off |= self.called_off
        if self.posterior is not None:
            self._fit()
        return [event for event in events if isinstance(event, Alarm) and event.what == "slip"]

    # -- what is known, and what is next --------------------------------------------------------------------------------------

    def known(self, coming: np.ndarray | None = None) -> Known:
        """How well the target is known now.

        Args:
            coming: Information that the next rows bring, :data:`AHEAD` of them, shape (D, D); None: how many more it takes is
                not said.
        """
        count = sum(self.good.values())
        if self.posterior is None:
            return Known(count, np.inf, np.inf)
        moves = region_columns(self.posterior.setup, self.posterior.things, self.region)
        off = left_out(self.posterior)

        def position(covariance: np.ndarray, beside: Beside, share: float) -> float:
            beyond = beside.drawn(DRAWS, np.random.default_rng(0))
            return bound(moves[:, :3], self.inflation.variance * covariance, beyond, share * off)

        covariance = self.posterior.covariance
        turns = self.campaign.measurements.traits.oriented
        now = position(covariance, self.beside, 1.0)
        rotation = bound(moves[:, 3:], self.inflation.variance * covariance, np.zeros(DRAWS), off) if turns else np.inf

        def later(n: int) -> float:
            assert self.posterior is not None and coming is not None
            then = inverse(self.posterior.information + n / AHEAD * coming)
            shares = [
                np.einsum("rid,de,rie->", moves[:, :3], of, moves[:, :3], optimize=True) for of in (then, covariance)
            ]
            return position(then, self.beside.after(n), float(np.sqrt(shares[0] / shares[1])))

        more = None if coming is None or self.suspect is not None else self._more(now, later)
        return Known(count, now, rotation, more)

    def _more(self, now: float, later: Callable[[int], float]) -> int | None:
        """Rows that the tolerance takes beside those so far, if they tell as much as the next ones do.

        None if these are more than :data:`FORESEEN`, or before predictions were tried.

        Args:
            now: What is kept within now, [m].
            later: The same after so many rows more.
        """
        if self.tolerance is None or self.beside.numbers < FEWEST_BESIDE:
            return None
        if now <= self.tolerance:
            return 0
        if later(FORESEEN) > self.tolerance:
            return None
        fewest, most = 0, FORESEEN
        while most - fewest > 1 + fewest // 10:
            middle = (fewest + most) // 2
            fewest, most = (fewest, middle) if later(middle) <= self.tolerance else (middle, most)
        return most

    def here(self) -> np.ndarray | None:
        """Readings of the last row, shape (columns,)."""
        rows = self.read.rows
        return None if rows is None else rows.readings[-1]

    def _ahead(self) -> list[Event]:
        """What is known, and what comes next, or that it is enough."""
        now = self._now()
        if now is None:
            return [self._anywhere()]
        some = self._pool(now)
        if self.posterior is None:
            return [self._next(now, some)]
        coming = ahead(some, self.posterior)
        known = self.known(coming)
        enough = self._enough(known, gain_ahead(some, self.posterior, coming)) if self.suspect is None else None
        untouched = self._untouched() if self.suspect is None else None
        if enough and (enough[0] == "tolerance" or untouched is None):
            self.stopped = True
            return [known, Stop(*enough, known, self.checks())]
        return [known, self._next(now, some) if untouched is None else self._by_hand(*untouched)]

    def _untouched(self) -> tuple[str, str] | None:
        """A point of which nobody knows yet where it is, and the one whose distance from it the campaign states; None: all are.

        Without its rows the distance says nothing, and distances are all that sockets tell of an arm's size.
        """
        assert self.posterior is not None
        if not self.campaign.measurements.traits.touches:
            return None
        known = {
            label for title in offers(self.posterior.setup).titles for label in title.values()
        } | self.skipped_points
        pairs = [length.between for length in self.campaign.instruments.lengths]
        ends = [ends for one, two in pairs for ends in ((one, two), (two, one)) if ends[0] not in known]
        return min(ends, key=lambda pair: pair[1] not in known, default=None)

    def _labels(self) -> set[str]:
        """Points that rows refer to."""
        return set() if self.read.rows is None else set(self.read.rows.labels.refers.ravel().tolist())

    def _by_hand(self, point: str, other: str) -> Next:
        """A touch of a point that only the user can find."""
        self.point_by_hand = point
        column = column_of(
            self.campaign.measurements.traits.roles[0].name, self.campaign.measurements, self.robot.readings
        )
        return Next(
            {},
            f"bring the arm to {point} yourself: nobody knows yet where it is, and the campaign states how far it is from "
            f"{other}; poses there are proposed from then on (reject: it cannot be had)",
            {column: point},
        )

    def _anywhere(self) -> Next:
        """What to measure while nobody knows where anything is: the user's own choice of pose."""
        traits = self.campaign.measurements.traits
        what = (
            "the target in a point, each point in three poses" if traits.touches else "an image that shows the markers"
        )
        return Next(
            {},
            f"bring the arm there yourself, as nobody says yet where things are: measure {what}, turned about all axes and far "
            "from the last; poses are proposed once rows tell where things are",
        )

    def _enough(self, known: Known, gain: float) -> tuple[Why, str] | None:
        """Why it is enough, if it is; ``gain`` is what ten more rows bring, see :func:`gain_ahead`."""
        told = self.beside.numbers >= FEWEST_BESIDE
        if self.tolerance is not None and told and known.position <= self.tolerance:
            return "tolerance", (
                f"{self.subject} is within {1e3 * known.position:.3g} mm in 95 % of the region, with 95 % confidence; "
                f"asked were {1e3 * self.tolerance:.3g} mm"
            )
        reachable = self.tolerance is not None and known.more is not None
        if told and not reachable and gain < HARDLY:
            beyond = (
                ""
                if self.tolerance is None
                else f"; {1e3 * self.tolerance:.3g} mm would take more than {FORESEEN} {self.measured} more, if it can be had "
                "at all"
            )
            return "nothing to gain", (
                f"ten more {self.measured} would make {self.subject} less than {100 * HARDLY:.0f} % "
                f"better known: it is within {1e3 * known.position:.3g} mm{beyond}{NO_LENGTH if self._lacks_length else ''}"
            )
        return None

    @property
    def _images(self) -> bool:
        """Whether images are measured."""
        return self.campaign.measurements.traits.images

    @property
    def measured(self) -> str:
        """What is counted."""
        return "images" if self._images else "rows"

    @property
    def subject(self) -> str:
        """What is known: images tell neither where the base nor where the tip is."""
        return "the arm between base and tip" if self._images else "the target"

    @property
    def _lacks_length(self) -> bool:
        """Whether nothing says how large the arm is: touches of points whose places and distances nobody knows."""
        instruments = self.campaign.instruments
        return self.campaign.measurements.traits.touches and self.prior is None and not instruments.lengths

    def asked(self) -> list[Event]:
        """The stop that the user asked for."""
        self.stopped = True
        known = self.known()
        words = "nothing can be said yet of how well it is known"
        if known.position < np.inf:
            words = (
                f"{self.subject} is within {1e3 * known.position:.3g} mm in 95 % of the region, with 95 % confidence"
            )
        return [Stop("asked", words, known, self.checks())]

    def reject(self) -> list[Event]:
        """Another pose in place of the last one that was proposed."""
        if self.point_by_hand:
            self.skipped_points.add(self.point_by_hand)
            self.point_by_hand = ""
        elif self.proposed is not None:
            self.rejected = (*self.rejected, self.proposed)
        self.suspect = None
        self.repeated_at = sum(self.good.values())
        now = self._now()
        return [self._anywhere() if now is None else self._next(now, self._pool(now))]

    def _now(self) -> Posterior | None:
        """What is known, if anything; until frames are, where the poses so far were measured tells what they are worth."""
        if self.posterior is not None or self.read.rows is None or self.prior is None:
            return self.posterior or self.prior
        rows, some = self.read.rows, self._in_use()
        readings = rows.readings[some]
        titles = offers(self.prior.setup)
        of = [next((n for n, t in enumerate(titles.titles) if self._is_of(rows, j, t)), 0) for j in some.tolist()]
        patterns = [titles.patterns[n] for n in of]
        measured = Candidates(
            readings,
            np.ones_like(readings),
            np.array(of, dtype=int),
            np.concatenate([np.zeros(0, dtype=int), *patterns]),
            np.repeat(np.arange(len(of)), [len(part) for part in patterns]),
        )
        if not len(of):
            return self.prior
        F = whitened(self.prior.setup, measured)
        return self.prior.with_rows(F, np.zeros(F.shape[:2]))

    def _is_of(self, rows: Dataset, j: int, title: Mapping[str, str]) -> bool:
        """Whether a row measured what a title says."""
        target = [] if rows.labels.target is None else [str(rows.labels.target[j])]
        return set(title.values()) <= {*rows.labels.refers[j].tolist(), *target}

    def _pool(self, now: Posterior) -> Pool:
        """Configurations to choose from."""
        count = len(self.read.index)
        if (
            self.candidates is None
            or count >= self.drawn_at + POOL_LASTS
            or (self.posterior is not None) != self.drawn_with
        ):
            self.candidates = drawn(now, self.rng)
            self.drawn_at = count
            self.drawn_with = self.posterior is not None
        elif self._images and count > self.drawn_at:
            self.candidates = more_of(self.candidates, now, self.rng)
            self.drawn_at = count
        return pool(now, self.candidates, self.region, self.here())

    def _next(self, now: Posterior, some: Pool) -> Next:
        """The pose to measure next."""
        rows, here = self.read.rows, self.here()
        if self.suspect is not None and rows is not None:
            at = int(np.flatnonzero(self.read.index == self.suspect)[0])
            again = self._witness(at, rows)
            if again is not None:
                j = int(np.flatnonzero(self.read.index == again)[0])
                off = self.table.line(self.suspect)
                why = f"row {self.table.line(again)} again: is row {off} a bad reading, or did something move?"
                return self._said(rows.readings[j], why, self._labels_of(rows, j))
        repeat = self._repeat(now)
        if repeat is not None and rows is not None:
            why = (
                f"row {self.table.line(int(self.read.index[repeat]))} again: it tells the noise, and that nothing moved"
            )
            return self._said(rows.readings[repeat], why, self._labels_of(rows, repeat))
        gain = worth(some, now)
        gain = np.where(self._wanted(now, some), gain, gain - 1.0)
        titles = offers(now.setup).titles
        order = best_first(some, gain, now, here, self.rejected)
        k, unseen = next(order, None), ""
        if k is None:  # no straight way to any: the best pose, and the user finds the way
            k = next(best_first(some, gain, now, None, self.rejected), None)
            unseen = "; no straight way of the joints was found: see to it yourself"
        if k is None:
            self.rejected = ()
            self.candidates = None
            return self._next(now, self._pool(now))
        places = " and ".join(told_by(some, k, now))
        better = 100 * float(max(worth(some, now)[k], 0.0))
        why = f"makes {self.subject} {better:.2g} % better known; tells most of {places}{unseen}"
        return self._said(some.candidates.readings[k], why, titles[int(some.candidates.offer[k])])

    def _wanted(self, now: Posterior, some: Pool) -> np.ndarray:
        """Configurations of things that fewest rows are of, until the model begins, shape (C,) bool."""
        titles = offers(now.setup).titles
        every = np.ones(len(some.candidates.readings), dtype=bool)
        rows = self.read.rows
        if self.posterior is not None or len(titles) < 2 or rows is None:
            return every
        labels = [next(iter(title.values()), "") for title in titles]
        seen = [
            *rows.labels.refers[:, 0].tolist(),
            *([] if rows.labels.target is None else rows.labels.target.tolist()),
        ]
        counts = np.array([seen.count(label) for label in labels])
        return np.isin(some.candidates.offer, np.flatnonzero(counts == counts.min()))

    def _repeat(self, now: Posterior) -> int | None:
        """An earlier good row to measure again, if it is time for that and the arm gets there."""
        count, rows, here = sum(self.good.values()), self.read.rows, self.here()
        if rows is None or here is None or self.posterior is None:
            return None
        declared = all(sigma is not None for sigma in rows.sigma)
        if count < self.repeated_at + (REPEAT_DECLARED if declared else REPEAT_UNDECLARED):
            return None
        self.repeated_at = count
        good = [j for j in range(len(rows)) if self.good.get(int(self.read.index[j]))]
        number = rows.repeats.configuration
        once = [j for j in good if np.sum(number == number[j]) == 1]
        for j in sorted(once[: max(1, len(once) // 2)], key=lambda j: float(np.abs(rows.readings[j] - here).max())):
            if reaches(now, here, rows.readings[j], 0):
                return j
        return None

    def _labels_of(self, rows: Dataset, j: int) -> Mapping[str, str]:
        """What a row measured, by column, where there are several things."""
        now = self._now()
        titles = () if now is None else offers(now.setup).titles
        return next((title for title in titles if title and self._is_of(rows, j, title)), {})

    def _said(self, readings: np.ndarray, why: str, labels: Mapping[str, str]) -> Next:
        """A pose in the campaign's columns and units."""
        self.proposed = readings
        settings = self.campaign.measurements
        named = {column_of(name, settings, self.robot.readings): word for name, word in labels.items()}
        return Next(self._in_columns(readings), why, named)

    def _in_columns(self, readings: np.ndarray) -> dict[str, float]:
        """Readings, shape (columns,), in the campaign's columns and units."""
        settings = self.campaign.measurements
        cells = counting(settings, self.robot.readings, self.robot.kinds).cells(readings[None])[0]
        names = [settings.columns.get(name, name) for name in self.robot.readings]
        return {name: round(float(cell), 6) for name, cell in zip(names, cells, strict=True)}

    @property
    def units(self) -> dict[str, str]:
        """Units of the joints' columns."""
        settings = self.campaign.measurements
        names = [settings.columns.get(name, name) for name in self.robot.readings]
        usual = [settings.units.length if kind == "prismatic" else settings.units.angle for kind in self.robot.kinds]
        return {name: settings.units.columns.get(name, unit) for name, unit in zip(names, usual, strict=True)}

    def checks(self) -> tuple[Mapping[str, float], ...]:
        """Poses that check the calibration: far from each other, and from all that was measured."""
        rows = self.read.rows
        places = self.region
        taken = list(rows.readings) if rows is not None else []
        chosen: list[Mapping[str, float]] = []
        for _ in range(min(CHECKS, len(places))):
            far = np.full(len(places), np.inf)
            for pose in taken:
                far = np.minimum(far, np.linalg.norm(places - pose, axis=1))
            best = int(np.argmax(far))
            taken.append(places[best])
            chosen.append(self._in_columns(places[best]))
        return tuple(chosen)


FEW_BAD = 3
"""Rows of which not one can be used: the table is not as the campaign says."""

FEW_STRANGE = 8
"""Rows from which it is told that they are not of this robot: a bad one among three looks like that."""


def session(campaign: Campaign, robot: Robot, tolerance: float | None) -> Session:
    """The session of a campaign before any row.

    Args:
        campaign: What is to be measured.
        robot: The nominal chain.
        tolerance: See :class:`Session`.

    Raises:
        AridcalError: rows of its kind cannot be planned, or something needs mending.
    """
    if len(campaign.blocks) > 1 or len(campaign.measurements.files) != 1:
        raise CampaignError(
            f"{campaign.path}: measurements: one table is followed while it grows; write a campaign with one block and one file"
        )
    traits = campaign.measurements.traits
    if not (traits.tracked or traits.touches or traits.images):
        raise CampaignError(
            f"{campaign.path}: measurements.kind: poses, positions, touches of points and images of markers are guided; plan "
            "others with `aridcal design`, measure, and run `aridcal identify` now and then"
        )
    rng = np.random.default_rng(0)
    around = bodies(campaign.design.keep_out or (), robot)
    try:
        setup = from_nothing(campaign, robot, around)
    except NothingStated:
        lenses = [name for name, camera in campaign.instruments.cameras.items() if {*camera.identify} - {"place"}]
        if traits.images and lenses:
            # Three images begin with any lens: what was said then had frames that slipped although nothing moved.
            raise CampaignError(
                f"{campaign.path}: instruments.cameras.{lenses[0]}: its lens is to be found, and nobody says where camera and "
                "markers are: say nearly where (`xyz`, `rpy` of both), or give the lens and `identify: [place]`"
            ) from None
        prior, region = None, np.zeros((0, len(robot.readings)))
    else:
        setup = with_suspects(setup, rng)
        region = region_readings(setup, None, rng)[:PLACES]
        setup = replace(setup, patterns=setup.patterns.with_origin(order=np.full(len(setup.patterns), np.inf)))
        prior = before_rows(setup)
    dialect = campaign.measurements.table.dialect
    table = GrowingTable(dialect.begins, dialect.comment)
    return Session(campaign, robot, tolerance, table, no_rows({}), {}, around, prior, region, rng)
