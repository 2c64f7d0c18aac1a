"""Disk, locks, signals, readers with limits, progress, errors: what every wing stands on."""
