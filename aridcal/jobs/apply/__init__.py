"""A calibration in use: target poses, joint commands, robot programs."""
