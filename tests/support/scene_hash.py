"""A hash of what a scene holds, with which tests compare scenes."""

import hashlib
from dataclasses import astuple

import numpy as np

from ablate.anatomy import Scene


def content_hash(scene: Scene) -> str:
    """SHA-256, hexadecimal, of a scene's vertices, faces, tissues and background, but not of its name.

    Vertices are rounded to little-endian float32, so that last bits of float64 do not change the hash.
    """
    digest = hashlib.sha256()
    digest.update(repr(astuple(scene.background)).encode())
    for structure in scene.structures:
        digest.update(repr(astuple(structure.tissue)).encode())
        vertices = np.ascontiguousarray(structure.mesh.vertices, dtype="<f4")
        faces = np.ascontiguousarray(structure.mesh.faces, dtype="<i8")
        digest.update(f"{vertices.shape}{faces.shape}".encode())
        digest.update(vertices.tobytes())
        digest.update(faces.tobytes())
    return digest.hexdigest()
