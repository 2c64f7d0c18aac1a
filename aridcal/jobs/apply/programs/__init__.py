"""Robot programs as they are: their targets read and corrected, every other byte kept."""
