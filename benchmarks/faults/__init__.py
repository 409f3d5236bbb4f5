"""The faults of the campaign `benchmarks/chaos.py`, a file a theme."""
