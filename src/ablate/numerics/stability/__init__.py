"""Stiff and extreme cases, in float32 against float64 and networks in bf16 too, that `task=stability` and tests run."""
