"""Many robots, or one many times: which are to be computed, on what engine, and what they have in common."""
