"""Campaigns written: from a URDF and a table, or from a scenario with a known truth."""
