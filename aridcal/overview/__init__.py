"""Pages on many calibrations."""
