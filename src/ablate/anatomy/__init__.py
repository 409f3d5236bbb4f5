"""Tissues, meshes, built-in anatomies and scene folders."""

from ablate.anatomy.check import check_scene
from ablate.anatomy.fetal_abdomen import fetal_abdomen, fetal_sites
from ablate.anatomy.fetal_planes import fetal_planes
from ablate.anatomy.folder import load_scene, load_sites, validate_scene_folder
from ablate.anatomy.scene import ANATOMY_VERSION, Scene, Structure, Tissue, bounds_mm, content_hash
from ablate.anatomy.sites import SiteGrid
from ablate.anatomy.tissues import echogenicity_order, load_tissues

__all__ = [
    "ANATOMY_VERSION",
    "Scene",
    "SiteGrid",
    "Structure",
    "Tissue",
    "bounds_mm",
    "check_scene",
    "content_hash",
    "echogenicity_order",
    "fetal_abdomen",
    "fetal_planes",
    "fetal_sites",
    "load_scene",
    "load_sites",
    "load_tissues",
    "validate_scene_folder",
]
