"""What changed between two calibrations, and what changes over months."""
