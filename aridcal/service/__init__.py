"""What a calibration needs before and after: poses to measure next, checks, repairs."""
