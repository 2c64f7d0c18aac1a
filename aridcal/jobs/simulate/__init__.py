"""Campaigns with a known truth, from a scenario."""
