"""The outcome of a campaign, its figures and files; a calibration in use."""
