"""Measured rows as one data set: what they refer to, which repeat others, which are held out."""
