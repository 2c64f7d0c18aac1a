"""Rounding, and the ends of loops: numbers that bound sums and decide nothing of what is found.

What decides stands in :mod:`aridcal.engine.levels` and beside what it decides.
"""

from __future__ import annotations

TINY = 1e-300
"""Stands for nothing where a logarithm or a division needs something."""

RIDGE = 1e-13
"""A thousand roundings. Added to the unit diagonal of balanced equations, so that columns that nearly coincide factorise; a step
of this share of the coefficients is the last."""

RANK = 1e-12
"""Share of the largest below which a singular value, a gain or a step [m, rad] is rounding."""

FLOOR = 1e-12
"""[m] or [rad]: residuals below it are rounding, also where data are exact."""

MOST_ITERATIONS = 60
"""Steps of an iteration that ends before: Gauss-Newton takes five, variances three, bounds of a likelihood a dozen."""

STEP_HALVINGS = 40
"""Times that a step is halved: what then does not improve is rounding."""

ROUNDS = 10
"""Times that two things which depend on each other are found in turn, if they have not settled before: two or three are usual."""
