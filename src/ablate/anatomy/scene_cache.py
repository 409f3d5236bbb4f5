"""Built scenes kept on disk, one file each; a file that does not hold what was written is built again."""

import hashlib
import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh

from ablate.anatomy.scene import Scene, Structure, content_hash
from ablate.anatomy.tissue import load_tissues
from ablate.storage import written_whole

logger = logging.getLogger(__name__)


def cached_scene(folder: str | Path | None, build: Callable[[], Scene], **parameters: object) -> Scene:
    """The scene of these parameters: read from `folder` if it is there, else built and written; only built for None.

    Both give the same scene, vertices bit for bit; its tissues must be those of the built-in table. The parameters are
    everything that decides what the scene is, including a version of the code that builds it. A file that cannot be
    read or written is logged as a warning.
    """
    if folder is None:
        return build()
    key = hashlib.sha256(repr(sorted(parameters.items())).encode()).hexdigest()[:16]
    path = Path(folder) / f"scene-{key}.npz"
    if path.exists():
        try:
            return _read(path)
        except Exception as error:  # zip, NumPy and trimesh raise many kinds for a file with a flipped bit
            logger.warning("%s: built again, because it cannot be read: %s", path, " ".join(str(error).split()))
    scene = build()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(path) as partial:
            _write(partial, scene)
    except OSError as error:
        logger.warning("%s: the built scene is not kept: %s", path, error)
    return scene


def _write(path: Path, scene: Scene) -> None:
    meshes = [structure.mesh for structure in scene.structures]
    with path.open("wb") as stream:
        np.savez(
            stream,
            vertices=np.concatenate([mesh.vertices for mesh in meshes]),
            faces=np.concatenate([mesh.faces for mesh in meshes]).astype(np.int32),
            counts=[(len(mesh.vertices), len(mesh.faces)) for mesh in meshes],
            names=[mesh.metadata["name"] for mesh in meshes],
            tissues=[structure.tissue.name for structure in scene.structures],
            scene=[scene.background.name, scene.name, content_hash(scene)],
        )


def _read(path: Path) -> Scene:
    table = load_tissues()
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as held:
        background, name, digest = (str(text) for text in held["scene"])
        ends = np.cumsum(held["counts"], axis=0)[:-1]
        vertices, faces = np.split(held["vertices"], ends[:, 0]), np.split(held["faces"], ends[:, 1])
        structures = []
        for points, corners, label, tissue in zip(vertices, faces, held["names"], held["tissues"], strict=True):
            mesh = trimesh.Trimesh(points, corners, process=False)
            mesh.metadata["name"] = str(label)
            structures.append(Structure(mesh, table[str(tissue)]))
    scene = Scene(tuple(structures), table[background], name)
    if content_hash(scene) != digest:
        raise ValueError("its content is not what was written")
    return scene
