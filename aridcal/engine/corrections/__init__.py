"""Corrections: where x component x basis, and the table of their kinds."""
