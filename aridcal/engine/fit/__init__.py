"""Weighted least squares: starts, the identifiable set, noise, the nominal and the geometric stage."""
