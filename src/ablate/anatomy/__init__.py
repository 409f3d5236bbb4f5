"""Tissues, meshes, built-in anatomies and scene folders."""

from ablate.anatomy.scene import Scene, Structure, Tissue
from ablate.anatomy.tissues import echogenicity_order, load_tissues

__all__ = ["Scene", "Structure", "Tissue", "echogenicity_order", "load_tissues"]
