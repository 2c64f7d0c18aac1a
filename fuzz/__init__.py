"""Fuzzing of every reader: inputs that nobody would write, by the million."""
