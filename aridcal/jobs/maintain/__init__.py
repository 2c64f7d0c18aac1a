"""What a calibration needs later: checks with few rows, and repairs."""
