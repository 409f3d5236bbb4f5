"""The pairs that a study reads: simulated or imported."""
