"""How far a calibration can be trusted: uncertainty where the robot works, and what a second fit says."""
