"""Readings for wanted poses: a solved model one configuration at a time, Newton's method for one pose and for many."""
