"""Stiff and extreme cases, each in float32 against float64 (networks in bf16 too): `task=stability`."""

from ablate.numerics.stability.task import stability

__all__ = ["stability"]
