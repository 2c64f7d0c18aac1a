"""How sure is sure enough: one level for each kind of proof, whatever it is asked of.

Each has a row in ``docs/thresholds.md``.
"""

from __future__ import annotations

DOUBT = 0.05
"""Chance that a check beside other evidence may leave, and that a promise to the user may: one in twenty."""

LENIENT = 0.01
"""Chance where a mistake costs little: one more gear beside several that err, another search with flagged rows in use."""

RARE = 1e-3
"""Chance of one question asked once: of a thousand clean calibrations one gets a wrong answer."""

STRONG = 3.0
"""[nat] between two explanations from which the better one is said to be so: odds of 20 to 1, strong evidence (Kass and Raftery
1995). What is closer is a tie."""

PRICE = 1.0
"""[nat] for each number that shapes what effects are believed to be, or that may as well stay nominal, as Akaike (1974)
charges."""

PLAINLY = 2.0
"""Standard errors of a check beside a likelihood: one by one, noise passes one in 44."""

SURELY = 3.0
"""Standard errors of what is asked of a dozen: noise passes one in 60 times."""

CERTAINLY = 4.0
"""Standard errors that chance hardly makes."""

CHOOSING_FOLDS = 5
"""Parts of the rows that are held back in turn, where effects are chosen: four fifths stay to fit with. Convention."""

JUDGING_FOLDS = 10
"""The same where what was chosen is judged once more: nine tenths stay to fit with. Convention."""

SLIGHT = 1e-3
"""Share of its size by which a load or a covariate may differ and not change, and what a motion moves is not moved."""

FAINT_LEVER_SHARE = 0.05
"""Share of the median lever below which a row says nothing of a motion."""

FEWEST_NOISE_ROWS = 40
"""Rows from which the noise is asked what it is made of: variances are then known to 20 %."""

FEWEST_TOGETHER = 5
"""Rows that are compared with all others as one group: a sigma is then known to a third."""

STILL = 1e-3
"""[rad] or [m]: a joint whose readings cover less did not move; of a sliding one any effect is then a constant."""

SEVERAL = 2
"""Of one sort, from which something is said of all of them: effects of a family, flagged rows, rows that share a reading."""
