"""What is imported of the anatomy without a mesh."""

import subprocess
import sys

LIGHT = """
import sys
from ablate.anatomy.scene import FEWEST_TRIANGLES
from ablate.anatomy import Scene, SiteGrid, Structure, Tissue, content_hash
from ablate.anatomy import fetal_sites, load_tissues, validate_scene_folder
Scene((), load_tissues()["fat"], "fat"), fetal_sites()
print([name for name in ("trimesh", "scipy", "skimage", "torch", "mapbox_earcut") if name in sys.modules])
"""


def test_tissues_sites_and_scene_folders_need_no_mesh_library() -> None:
    result = subprocess.run([sys.executable, "-c", LIGHT], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
