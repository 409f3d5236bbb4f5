"""Small scene folders."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import trimesh
import yaml


def ball_folder(
    folder: Path, sites: Mapping[str, Any], radius_mm: float = 60, organ: trimesh.Trimesh | None = None
) -> Path:
    """Write a body of liver, or of fat around an organ of bone."""
    folder.mkdir()
    trimesh.creation.icosphere(3, radius=radius_mm).export(folder / "body.obj")
    structures = [{"mesh": "body.obj", "tissue": "liver" if organ is None else "fat"}]
    if organ is not None:
        organ.export(folder / "organ.obj")
        structures.append({"mesh": "organ.obj", "tissue": "bone"})
    (folder / "scene.yaml").write_text(yaml.safe_dump({"structures": structures, "sites": dict(sites)}))
    return folder
