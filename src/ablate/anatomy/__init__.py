"""Tissues, meshes, built-in anatomies and scene folders."""

from ablate.anatomy.scene import Scene, Structure, Tissue

__all__ = ["Scene", "Structure", "Tissue"]
