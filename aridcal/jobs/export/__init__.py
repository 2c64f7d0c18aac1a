"""A calibrated model as code for those who run it: one description of it, and a printer for each language."""
