"""What was measured of the target: kinds of measurements, the mirror image of corrections."""
