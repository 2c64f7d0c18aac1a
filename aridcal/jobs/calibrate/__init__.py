"""From a campaign to its outcome, its figures and its files."""
