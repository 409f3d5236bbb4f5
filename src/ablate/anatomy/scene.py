"""A scene: closed surfaces, the tissue in each, and the tissue around them; and built scenes kept on disk."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ablate.anatomy.tissue import Tissue, load_tissues
from ablate.storage import check_archive, written_whole

if TYPE_CHECKING:
    import trimesh

ANATOMY_VERSION = 4  # of the built-in anatomy, the tissue table and mesh repair: raised when a scene changes
FEWEST_TRIANGLES = 4_000  # of the built-in anatomy

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Structure:
    """One closed surface and the tissue inside it; vertices in mm, winding irrelevant.

    Raises
    ------
    TypeError
        When the mesh is no `trimesh.Trimesh` (trimesh loads files of several parts as a `trimesh.Scene`) or the
        tissue is no `Tissue`.
    """

    mesh: trimesh.Trimesh
    tissue: Tissue

    def __post_init__(self) -> None:
        import trimesh  # only here: whoever needs no mesh does not load the mesh library

        if not isinstance(self.mesh, trimesh.Trimesh):
            raise TypeError(f"structure: mesh must be a trimesh.Trimesh, not {type(self.mesh).__name__}")
        if not isinstance(self.tissue, Tissue):
            raise TypeError(f"structure: tissue must be a Tissue, not {self.tissue!r}; load_tissues() has them")


@dataclass(frozen=True)
class Scene:
    """Structures in a background: where structures overlap, the later one owns the point.

    Without structures the scene is all background. Structures or a background of another kind are a TypeError.

    Attributes
    ----------
    body : (4, 4) float64
        Rigid transform from the body's axes, which its scatterers and textures are fixed to, to the world's, mm. It is
        the identity unless the scene is one that was `moved`.
    guessed : str
        What was guessed of its tissues, for whoever sees its first picture; empty where nothing was.
    end_walls : tuple of (4, 4) float64
        Where structures are closed because the volume ends that they were made from, as `volumes.ends.end_walls`.

    Examples
    --------
    >>> import trimesh
    >>> from ablate.anatomy import load_tissues
    >>> tissues = load_tissues()
    >>> cyst = Structure(trimesh.creation.icosphere(radius=10.0), tissues["urine"])
    >>> scene = Scene((cyst,), background=tissues["liver"], name="cyst")
    >>> [tissue.name for tissue in scene.tissues]
    ['liver', 'urine']
    """

    structures: tuple[Structure, ...]
    background: Tissue
    name: str
    body: np.ndarray = field(default_factory=partial(np.eye, 4), compare=False, repr=False)
    guessed: str = field(default="", compare=False, repr=False)
    end_walls: tuple[np.ndarray, ...] = field(default=(), compare=False, repr=False)
    looked_at: bool = field(default=False, init=False, compare=False, repr=False)  # whether `warn_of_overlaps` did

    def __post_init__(self) -> None:
        object.__setattr__(self, "structures", tuple(self.structures))
        if not all(isinstance(structure, Structure) for structure in self.structures):
            raise TypeError("scene: structures must be a tuple of Structure")
        if not isinstance(self.background, Tissue):
            raise TypeError(f"scene: background must be a Tissue, not {self.background!r}; load_tissues() has them")

    def moved(self, motion: np.ndarray) -> Scene:
        """The scene after a rigid motion, (4, 4) float, mm in the world: scatterers and textures move with the body."""
        structures = []
        for structure in self.structures:
            mesh = structure.mesh.copy()
            mesh.apply_transform(motion)
            structures.append(Structure(mesh, structure.tissue))
        walls = tuple(wall @ np.linalg.inv(motion) for wall in self.end_walls)
        body = np.asarray(motion, np.float64) @ self.body
        return replace(self, structures=tuple(structures), body=body, end_walls=walls)

    @cached_property
    def tissues(self) -> tuple[Tissue, ...]:
        """Background first, then by first use; `Frame.segmentation` is an index into this plus one."""
        return tuple(dict.fromkeys((self.background, *(s.tissue for s in self.structures))))

    @cached_property
    def structure_tissues(self) -> tuple[int, ...]:
        """Index in `tissues` of the tissue of each structure."""
        index = {tissue: i for i, tissue in enumerate(self.tissues)}
        return tuple(index[s.tissue] for s in self.structures)


def bounds_mm(meshes: Iterable[trimesh.Trimesh]) -> np.ndarray:
    """Lower and upper corner of the box around all meshes, (2, 3) float64, mm; zeros where there is none."""
    bounds = np.array([mesh.bounds for mesh in meshes])
    return np.stack([bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)]) if len(bounds) else np.zeros((2, 3))


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
        meshes = [structure.mesh for structure in scene.structures]
        with written_whole(path) as partial, partial.open("wb") as stream:
            np.savez(
                stream,
                vertices=np.concatenate([mesh.vertices for mesh in meshes]),
                faces=np.concatenate([mesh.faces for mesh in meshes]).astype(np.int32),
                counts=[(len(mesh.vertices), len(mesh.faces)) for mesh in meshes],
                names=[mesh.metadata["name"] for mesh in meshes],
                tissues=[structure.tissue.name for structure in scene.structures],
                scene=[scene.background.name, scene.name],
            )
    except OSError as error:
        logger.warning("%s: the built scene is not kept: %s", path, error)
    return scene


def _read(path: Path) -> Scene:
    import trimesh

    table = load_tissues()
    check_archive(path)
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as held:
        background, name = (str(text) for text in held["scene"][:2])
        ends = np.cumsum(held["counts"], axis=0)[:-1]
        vertices, faces = np.split(held["vertices"], ends[:, 0]), np.split(held["faces"], ends[:, 1])
        structures = []
        for points, corners, label, tissue in zip(vertices, faces, held["names"], held["tissues"], strict=True):
            mesh = trimesh.Trimesh(points, corners, process=False)
            mesh.metadata["name"] = str(label)
            structures.append(Structure(mesh, table[str(tissue)]))
    return Scene(tuple(structures), table[background], name)
