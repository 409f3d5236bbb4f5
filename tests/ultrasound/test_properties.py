"""What must hold of any scene of layers or odd bodies: impedances and losses over six decades, any pose."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ablate.anatomy import Scene, Structure, Tissue
from ablate.ultrasound import ConvexProbe, PlanMode, Simulator, SimulatorSettings

PROPERTY = settings(
    max_examples=25, deadline=None, derandomize=True, database=None, suppress_health_check=[HealthCheck.too_slow]
)
TINY = SimulatorSettings(
    scanlines=16, axial_samples=256, rays=4, layers=2, image_shape=(50, 69), axial_fwhm_mm=3.0, lateral_fwhm_mm=3.0
)
PENCIL = ConvexProbe(fov_deg=0.002, frequency_mhz=3.0)
AXIAL = replace(
    TINY, scanlines=4, rays=64, layers=1, aperture_mm=0.0, elevational_aperture_mm=0.0, lateral_fwhm_mm=1e-6
)


def decades(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers whose logarithm is uniform."""
    return st.floats(np.log10(low), np.log10(high)).map(lambda exponent: 10**exponent)


@st.composite
def tissues(draw: st.DrawFn, name: str = "t") -> Tissue:
    return Tissue(
        name,
        draw(st.floats(300, 5000)),
        draw(decades(1e-4, 1e2)),
        draw(st.one_of(st.just(0.0), decades(1e-4, 1e2))),
        draw(st.floats(0, 1)),
        draw(st.floats(-2, 2)),
        draw(st.floats(0, 2)),
        draw(st.floats(0.5, 2)),
        draw(st.sampled_from([0.0, 0.02, 1.0])),
        draw(st.sampled_from([0.0, 0.3])),
        draw(st.floats(0, 100)),
        draw(st.sampled_from([0.0, 3.0])),
    )


@st.composite
def layered(draw: st.DrawFn) -> Scene:
    """Up to four slabs, some within others, in a background of any kind."""
    faces = sorted(draw(st.lists(st.integers(2, 700), min_size=2, max_size=8, unique=True)))
    structures = []
    for i in range(len(faces) // 2):
        near, far = (0.2 * face + 0.037 for face in faces[2 * i : 2 * i + 2])
        mesh = trimesh.creation.box((300.0 + i, 300.0 + i, far - near)).apply_translation((0, 0, (near + far) / 2))
        structures.append(Structure(mesh, draw(tissues(f"t{i}"))))
    return Scene(tuple(structures), draw(tissues("background")), "layers")


@st.composite
def bodies(draw: st.DrawFn) -> Scene:
    """Up to four closed meshes of any form that cross each other, about and around the probe."""
    structures = []
    for i in range(draw(st.integers(1, 4))):
        mesh = trimesh.creation.icosphere(draw(st.integers(0, 2)), radius=draw(decades(0.5, 200)))
        rng = np.random.default_rng(draw(st.integers(0, 2**32)))
        mesh.vertices *= rng.uniform(draw(st.floats(0.01, 1)), 1, (len(mesh.vertices), 1))  # spikes and dents
        mesh.apply_translation(draw(st.tuples(*[st.floats(-100, 100)] * 3)))
        structures.append(Structure(mesh, draw(tissues(f"t{i}"))))
    return Scene(tuple(structures), draw(tissues("background")), "bodies")


@st.composite
def poses(draw: st.DrawFn) -> np.ndarray:
    """Any rotation, and a place within a metre."""
    angles = draw(st.tuples(*[st.floats(-np.pi, np.pi)] * 3))
    pose = trimesh.transformations.euler_matrix(*angles)
    pose[:3, 3] = draw(st.tuples(*[st.floats(-1000, 1000)] * 3))
    return pose


pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # of probes in bone or gas


@PROPERTY
@given(layered() | bodies(), st.integers(0, 2**63 - 1))
def test_frames_are_finite_and_maps_are_maps(scene: Scene, seed: int) -> None:
    frame = Simulator(scene, settings=TINY).render(np.eye(4), seed)
    assert np.isfinite(frame.envelope).all()
    assert frame.envelope.min() >= 0
    assert np.isfinite(frame.attenuation).all()
    assert 0 <= frame.attenuation.min() <= frame.attenuation.max() <= 1
    for of_surfaces in (frame.beam.interfaces, frame.beam.illumination):
        assert 0 <= of_surfaces.min() <= of_surfaces.max() <= 1  # which NaN is not
    assert ((frame.segmentation > 0) == frame.mask).all()
    assert frame.segmentation.max() <= len(scene.tissues)


@PROPERTY
@given(layered())
def test_planned_equals_full(scene: Scene) -> None:
    auto, full = (
        Simulator(scene, settings=replace(TINY, plan=plan), poses=[np.eye(4)]).render(np.eye(4)) for plan in PlanMode
    )
    for name in ("segmentation", "attenuation", "image", "mask", "envelope"):
        np.testing.assert_array_equal(getattr(auto, name), getattr(full, name))
    for name in ("interfaces", "illumination"):
        np.testing.assert_array_equal(getattr(auto.beam, name), getattr(full.beam, name))


@PROPERTY
@given(layered(), st.data())
def test_labels_know_nothing_of_acoustics(scene: Scene, data: st.DataObject) -> None:
    def other(tissue: Tissue) -> Tissue:
        return data.draw(tissues(tissue.name))

    changed = {tissue: other(tissue) for tissue in scene.tissues}
    structures = tuple(replace(s, tissue=changed[s.tissue]) for s in scene.structures)
    twin = Scene(structures, changed[scene.background], "other tissues")
    a, b = (Simulator(s, settings=TINY).maps(np.eye(4))[0] for s in (scene, twin))
    np.testing.assert_array_equal(a, b)


@PROPERTY
@given(layered(), poses())
def test_labels_move_with_scene_and_probe(scene: Scene, pose: np.ndarray) -> None:
    """Up to pixels whose centre is nearer to a wall than float32 tells: walls lie 0.007 mm from the nearest row."""
    moved = tuple(replace(s, mesh=s.mesh.copy().apply_transform(pose)) for s in scene.structures)
    here = Simulator(scene, settings=TINY).maps(np.eye(4))[0]
    there = Simulator(Scene(moved, scene.background, "moved"), settings=TINY).maps(pose)[0]
    np.testing.assert_array_equal(here, there)


@PROPERTY
@given(layered())
def test_attenuation_only_falls_along_a_line(scene: Scene) -> None:
    """One pixel to a sample: the image's only column is the middle scanline."""
    shape = replace(AXIAL, image_shape=(AXIAL.axial_samples, 1))
    column = Simulator(scene, PENCIL, shape).maps(np.eye(4))[1][:, 0]
    assert (np.diff(column) <= 2**-23).all()


@PROPERTY
@given(layered(), st.integers(0, 1000))
def test_energy_never_grows(scene: Scene, path_seed: int) -> None:
    """Illumination only falls with depth, and the squares of the echoes sum to no more than was sent.

    Of rays that meet R_1, R_2, ... the echo of the k-th is |R_k| times the product of 1 - R_j^2 before it, so the sum
    of squares is at most 1. Of smooth surfaces scanlines are alike, and the aperture adds nothing. A background that
    scatters is insonified like every tissue.
    """
    background = replace(scene.background, scatterer_density=0.5, scatterer_sd=1.0, texture_contrast_db=0.0)
    flat = tuple(
        replace(s, tissue=replace(s.tissue, roughness=0.0, thickness_mm=0.0, texture_contrast_db=0.0))
        for s in scene.structures
    )
    one = Simulator(Scene(flat, background, "flat"), PENCIL, replace(AXIAL, path_seed=path_seed))
    traced = one._prepare(np.eye(4))
    (returned,) = traced.sets
    assert ((returned.surfaces**2).sum(axis=1) <= 1 + 1e-5).all()
    amplitude = one._chain.speckle.insonify(traced.lines, returned.level_db, seed=0).amplitude
    illumination = amplitude[0].astype(float)
    assert (np.diff(illumination) <= 1e-6 * illumination[:, :1]).all()
    assert illumination.max() <= 10 ** (TINY.scatterer_level_db / 20) * (1 + 1e-5)
