"""The built-in anatomy as a whole: who lies in whom, its layers, its resolution, its seeds and its probe sites."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import trimesh

from ablate.anatomy import fetal_abdomen, fetal_sites
from ablate.anatomy.meshes.check import warn_of_overlaps

FLESH = ("body and head", "left leg", "right leg", "left arm", "right arm")


def test_abdominal_wall_of_the_mother(scene, mesh_of) -> None:
    """Depths under the skin where a needle goes straight in beside the midline, at the navel."""
    depth = {}
    for name in ("skin", "subcutaneous fat", "abdominal wall", "abdominal cavity", "uterus", "amniotic cavity"):
        cut = trimesh.intersections.mesh_plane(mesh_of(scene, name), np.array([1.0, 0, 0]), np.array([30.0, 0, 0]))
        near = cut.reshape(-1, 3)
        near = near[(np.abs(near[:, 2] - 5.0) < 12.0) & (near[:, 1] < -70)]
        depth[name] = near[:, 1].mean()
    thickness = -np.diff([-depth[name] for name in depth])
    assert thickness[0] == pytest.approx(2.0, abs=0.6)
    assert 13 < thickness[1] < 20
    assert 7 < thickness[2] < 15
    assert 5 < thickness[4] < 11
    body = mesh_of(scene, "skin").extents
    assert 290 < body[0] < 320
    assert 220 < body[1] < 260
    assert body[2] > 300


@pytest.mark.parametrize(
    ("inner", "outer"),
    [
        ("brain", "subarachnoid space"),
        ("thalami", "brain"),
        ("cavum septi pellucidi", "septa pellucida"),
        ("choroid plexus", "lateral ventricles"),
        ("subarachnoid space", "skull"),
        ("skull", "body and head"),
        ("heart chambers", "heart"),
        ("heart", "mediastinum"),
        ("lungs", "mediastinum"),
        ("liver", "abdominal contents"),
        ("umbilical vein", "umbilical vein wall"),
        ("stomach", "stomach wall"),
        ("kidneys", "body and head"),
        ("scapulae", "body and head"),
        ("ribs", "trunk muscles and diaphragm"),
        ("placental vessels", "placenta"),
        ("placental lakes", "placenta"),
        ("cord vessels", "umbilical cord"),
    ],
)
def test_parts_lie_in_their_wholes(scene, mesh_of, inner: str, outer: str) -> None:
    inside = mesh_of(scene, outer).contains(mesh_of(scene, inner).vertices[::7])
    assert inside.mean() > 0.97  # the rest is the corners that a coarse grid cuts


@pytest.mark.parametrize(
    ("triangles", "seed"), [pytest.param(300_000, 0, marks=pytest.mark.slow), (30_000, 1), (30_000, 2)]
)
def test_bones_lie_in_flesh_and_everything_in_the_mother(built, mesh_of, triangles: int, seed: int) -> None:
    scene = built(triangles, seed)
    thin = ("other limb bones",) if triangles < 300_000 else ()  # a coarse grid has no fingers
    flesh = [mesh_of(scene, name) for name in FLESH]
    for structure in scene.structures:
        points = structure.mesh.vertices[::11]
        if structure.tissue.name == "fetal_bone" and structure.mesh.metadata["name"] not in thin:
            inside = np.logical_or.reduce([mesh.contains(points) for mesh in flesh])
            assert inside.mean() > 0.97, structure.mesh.metadata["name"]
    skin = mesh_of(scene, "skin").bounds
    low, high = (np.array([s.mesh.bounds for s in scene.structures])[:, i] for i in (0, 1))
    assert (low >= skin[0]).all()
    assert (high <= skin[1]).all()


def test_names_tell_structures_apart(scene) -> None:
    names = [s.mesh.metadata["name"] for s in scene.structures]
    assert len(set(names)) == len(names)


def test_default_is_the_papers_size() -> None:
    structures = fetal_abdomen().structures
    count = [len(s.mesh.faces) for s in structures]
    cut = next(i for i, s in enumerate(structures) if s.mesh.metadata["name"] == "umbilical cord")
    assert sum(count) == pytest.approx(675_000, rel=0.05)
    assert sum(count[:cut]) == pytest.approx(275_000, rel=0.05)


def test_too_few_triangles_and_negative_seeds_are_refused() -> None:
    with pytest.raises(ValueError, match="triangles must be at least 4000, not 100"):
        fetal_abdomen(100)
    with pytest.raises(ValueError, match="seed must be at least 0, not -1"):
        fetal_abdomen(4_000, seed=-1)


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_no_walls_coincide_and_no_pieces_overlap(built, caplog: pytest.LogCaptureFixture, seed: int) -> None:
    """Therefore no simulator looks at them again."""
    scene = built(30_000, seed)
    assert scene.looked_at
    warn_of_overlaps(replace(scene))
    assert not caplog.records


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_sites_look_at_the_fetus_of_every_pregnancy(built, mesh_of, seed: int) -> None:
    """Straight in from most sites of the grid lies the fetus or its limbs, within the depth of the image."""
    scene, sites = built(30_000, seed), fetal_sites()
    skin = mesh_of(scene, "skin")
    fetus = trimesh.util.concatenate([mesh_of(scene, name) for name in FLESH])
    middle = skin.bounds.mean(axis=0)
    seen = []
    for height, angle in product(sites.heights_mm, np.deg2rad(sites.angles_deg)):
        outward = np.array([np.sin(angle), -np.cos(angle), 0.0])
        start = np.array([middle[0], middle[1], height]) + 250.0 * outward
        contact = skin.ray.intersects_location([start], [-outward], multiple_hits=False)[0][0]
        offset = fetus.vertices - contact
        depth = -offset @ outward
        aside = np.linalg.norm(offset + depth[:, None] * outward, axis=1)
        within_fan = (np.hypot(depth + 40.0, aside) < 190.0) & (aside < np.tan(np.deg2rad(35)) * (depth + 40))
        seen.append((within_fan & (depth > 0)).mean() > 0.15)
    assert len(seen) >= 50
    assert np.mean(seen) > 0.95


def test_what_a_pregnancy_lacks_is_no_structure() -> None:
    """The placenta of seed 10 has no vessels."""
    scene = fetal_abdomen(4_000, seed=10)
    assert all(len(structure.mesh.faces) for structure in scene.structures)
    assert len(scene.structures) == len(fetal_abdomen(4_000, seed=0).structures) - 1
