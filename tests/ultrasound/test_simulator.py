"""Frames as a whole: repeatable, finite, and the same whatever the plan leaves out."""

import time
from dataclasses import fields, replace

import numpy as np
import pytest
import torch
import trimesh

from ablate.anatomy import Scene, Structure, Tissue
from ablate.dataset.simulate import nudged
from ablate.ultrasound import PlanMode, Simulator
from ablate.ultrasound.stages import Stage, observe_stages, stage_times

BODY = Tissue("body", 1540, 1.6, 0.5, 0.6, 0.0, 0.8, texture_contrast_db=2.0)
BONE = Tissue("bone", 2600, 4.2, 5.0, 0.6, 0.0, 0.2, roughness=0.05, thickness_mm=0.1)


@pytest.fixture
def scene(gel, slab, ball) -> Scene:
    return Scene((slab(BODY, 3.0, 200.0), ball(BONE, (0.0, 0.0, 60.0), 10.0)), gel, "s")


def images_equal(a, b) -> bool:
    return all(
        (getattr(a, name) == getattr(b, name)).all()
        for name in ("segmentation", "attenuation", "image", "mask", "envelope")
    )


def test_same_seeds_same_frame(scene, probe, small, ahead) -> None:
    simulator = Simulator(scene, probe, small)
    first = simulator.render(ahead, seed=3)
    moved = ahead.copy()
    moved[0, 3] = 5.0
    simulator.render(moved)
    assert images_equal(first, simulator.render(ahead, seed=3))
    for kind in (np.int64, np.int32, np.uint8):
        assert images_equal(first, Simulator(scene, probe, small).render(ahead, seed=kind(3)))
    with pytest.raises(TypeError, match="integer"):
        simulator.render(ahead, seed=3.0)
    assert images_equal(first, Simulator(scene, probe, small).render(ahead, seed=3))


def test_an_image_alone_is_that_of_the_frame_and_makes_no_maps(scene, probe, small, ahead) -> None:
    simulator = Simulator(scene, probe, small)
    with stage_times() as taken:
        image = simulator.image(ahead, seed=3)
    maps = {Stage.pixel_labels, Stage.attenuation_labels, Stage.attenuation_sum, Stage.surface_maps}
    assert not maps & set(taken)
    assert Stage.tracing in taken
    assert (image == Simulator(scene, probe, small).render(ahead, seed=3).image).all()
    with pytest.raises(ValueError, match="seed"):
        simulator.image(ahead, seed=-1)


def test_an_empty_scene_is_all_background(empty, probe, small, ahead) -> None:
    settings = replace(small, noise_level_db=-75.0)
    frame = Simulator(empty, probe, settings).render(ahead)
    assert frame.envelope.max() == 0
    assert (frame.segmentation[frame.mask] == 1).all()
    np.testing.assert_allclose(frame.attenuation[frame.mask], 1, atol=1e-6)
    floor = 255 * (1 - 55 / 60)
    assert frame.image[frame.mask].mean() == pytest.approx(floor, abs=12)
    assert frame.image[~frame.mask].max() == 0


def test_nothing_is_cast_where_nothing_comes_back(slab, gel, probe, small, ahead) -> None:
    """Fluid of the gel's impedance and speed, with a loss: the image is that of the full plan."""
    lossy = replace(gel, name="lossy", attenuation_db_cm_mhz=1.0)
    scene = Scene((slab(lossy, 40.0, 60.0),), gel, "s")
    settings = replace(small, noise_level_db=-75.0)
    auto, full = (Simulator(scene, probe, replace(settings, plan=plan)) for plan in PlanMode)
    assert any(note.startswith("rays, scatterers") for note in auto.left_out)
    assert images_equal(auto.render(ahead), full.render(ahead))
    assert not any(note.startswith("rays") for note in Simulator(Scene((), BODY, "s"), probe, small).left_out)


def test_frames_have_the_promised_shapes_and_share_no_memory(scene, probe, small, ahead) -> None:
    simulator = Simulator(scene, probe, small)
    frame = simulator.render(ahead)
    arrays = frame.segmentation, frame.attenuation, frame.image, frame.mask
    assert [array.shape for array in arrays] == 4 * [small.image_shape]
    assert [array.dtype for array in arrays] == [np.uint8, np.float32, np.uint8, np.bool_]
    assert (frame.envelope.shape, frame.envelope.dtype) == ((1024, 64), np.float32)
    assert ((frame.segmentation > 0) == frame.mask).all()
    of_beam = [getattr(frame.beam, field.name) for field in fields(frame.beam)]
    assert [array.shape for array in of_beam] == [*5 * [small.beam_shape], (*small.beam_shape, 2), (0, 0)]
    types = np.uint8, np.float32, np.float32, np.float32, np.uint8, np.complex64, np.float32
    assert [array.dtype for array in of_beam] == list(types)
    kept = [array.copy() for array in (*arrays, *of_beam)]
    for array in (*arrays, *of_beam):
        array[:] = 0
    again = simulator.render(ahead)
    arrays = again.segmentation, again.attenuation, again.image, again.mask
    arrays += tuple(getattr(again.beam, field.name) for field in fields(again.beam))
    assert all((array == before).all() for array, before in zip(arrays, kept, strict=True))


def test_the_plan_changes_nothing(gel, slab, ball, probe, small, ahead) -> None:
    body = Tissue("body", 1540, 1.6, 0.5, 0.6, 0.0, 0.8, roughness=0.0)
    hard = Tissue("hard", 1540, 3.0, 0.5, 0.6, 0.0, 0.8, roughness=0.0)
    far = ball(Tissue("far"), (0.0, 0.0, 900.0), 50.0)
    scene = Scene((far, slab(body, 3.0, 200.0), ball(hard, (0.0, 0.0, 60.0), 10.0)), gel, "s")
    auto = Simulator(scene, probe, small, poses=[ahead])
    full = Simulator(scene, probe, replace(small, plan=PlanMode.full), poses=[ahead])
    assert full.left_out == ()
    notes = " ".join(auto.left_out)
    assert all(word in notes for word in ("1 of 3 structures", "refraction", "rough", "thickness", "texture"))
    assert images_equal(auto.render(ahead), full.render(ahead))


def test_a_pose_that_may_see_what_was_left_out_is_refused(gel, ball, probe, small, ahead) -> None:
    near, far = ball(BONE, (0.0, 0.0, 60.0), 10.0), ball(BONE, (0.0, 0.0, 900.0), 50.0)
    scene = Scene((near, far), gel, "s")
    simulator = Simulator(scene, probe, small, poses=[ahead])
    moved, nowhere = ahead.copy(), ahead.copy()
    moved[2, 3], nowhere[0, 3] = 750.0, -5e3
    for of_frame in (simulator.render, simulator.maps, simulator.beam_maps, simulator.scanline_tissues):
        with pytest.raises(ValueError, match="a structure that was left out is in reach; `poses` must hold all"):
            of_frame(moved)
    assert (Simulator(scene, probe, small).render(moved).segmentation == 2).any()
    assert images_equal(simulator.render(nudged(ahead, 20)), Simulator(scene, probe, small).render(nudged(ahead, 20)))
    nothing = Simulator(scene, probe, small, poses=[])
    with pytest.raises(ValueError, match="a structure that was left out is in reach"):
        nothing.render(ahead)
    assert set(np.unique(nothing.maps(nowhere)[0])) == {0, 1}


def test_threads_do_not_change_the_frame(scene, probe, small, ahead) -> None:
    frames = []
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            frames.append(Simulator(scene, probe, small).render(ahead))
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(1)
    assert images_equal(*frames)


def test_no_operation_of_a_frame_is_given_to_a_team_of_threads(scene, probe, small, ahead) -> None:
    """Its members would spin while one of them waits for a core that another program uses."""
    threads: set[int] = set()

    def observer(_, function, args):
        threads.add(torch.get_num_threads())
        return function(*args)

    try:
        torch.set_num_threads(2)
        with observe_stages(observer):
            simulator = Simulator(scene, probe, small)
            simulator.maps(ahead)
            simulator.render(ahead)
    finally:
        torch.set_num_threads(1)
    assert threads == {1}


def test_a_gpu_that_is_not_there_is_refused_before_the_scene_is_looked_at(small, tissue, monkeypatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    hole = trimesh.creation.box((50, 50, 50))
    hole.faces = hole.faces[1:]
    with pytest.raises(ValueError, match="device=cuda: this machine has no usable GPU, allowed are cpu and auto"):
        Simulator(Scene((Structure(hole, tissue),), tissue, "s"), None, replace(small, device="cuda"))


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")
def test_a_gpu_draws_the_same_image(scene, probe, small, ahead) -> None:
    here, there = (Simulator(scene, probe, replace(small, device=device)).render(ahead) for device in ("cpu", "cuda"))
    assert (np.abs(here.image.astype(int) - there.image) <= 1).mean() > 0.999


def test_tissue_is_insonified_up_to_an_opaque_surface(slab, probe, small, ahead) -> None:
    """A mirror of gas at any place between two nodes; lines that meet it obliquely receive no echo of it."""
    body = Tissue("body", 1540, 1.6, 0.5, 0.6, 0.0, 0.8, roughness=0.0)
    gas = Tissue("gas", 330, 4e-4, 0.0, 0.0, 0.0, 0.0, roughness=0.0, specularity=1e6)
    settings = replace(small, axial_samples=3072, axial_fwhm_mm=0.2)
    free, faced = (
        Simulator(scene, probe, settings).render(ahead).envelope
        for scene in (Scene((), body, "s"), Scene((slab(gas, 50.3, 400.0),), body, "s"))
    )
    depth = (np.arange(3072) + 0.5) * 150 / 3072
    cosine = np.cos(np.radians(np.linspace(-35, 35, 64)[:20]))
    surface = (50.3 + 40) / cosine - 40
    near = (depth[:, None] > surface - 0.4) & (depth[:, None] < surface - 0.2)
    change_db = 20 * np.log10(faced[:, :20][near].mean() / free[:, :20][near].mean())
    assert change_db == pytest.approx(0, abs=0.5)


@pytest.mark.parametrize("where", ["in bone", "past the scene"])
def test_a_probe_that_sees_nothing_is_told_once(gel, slab, ball, probe, small, ahead, where) -> None:
    bone = Tissue("bone", 3200, 6.0, 7.0, 0.6, 0.0, 0.1)
    structure = slab(bone, -30.0, 400.0) if where == "in bone" else ball(bone, (0.0, 0.0, -300.0), 50.0)
    simulator = Simulator(Scene((structure,), gel, "s"), probe, small)
    with pytest.warns(UserWarning, match="bone" if where == "in bone" else "looks past the scene"):
        frame = simulator.render(ahead)
    simulator.render(ahead, seed=1)
    simulator.render(np.diag([-1.0, -1.0, 1.0, 1.0]))  # a second warning would be an error
    assert frame.segmentation[frame.mask].min() == (2 if where == "in bone" else 1)


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        (np.eye(3), r"shape \(4, 4\)"),
        (np.full((4, 4), np.nan), "finite"),
        (np.diag([1.0, 1.0, 2.0, 1.0]), "orthonormal"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "determinant"),
        (np.eye(4) + np.diag([0.5], -3), "row"),
    ],
)
def test_poses_that_are_not_rigid(empty, probe, small, pose, message) -> None:
    with pytest.raises(ValueError, match=message):
        Simulator(empty, probe, small).render(pose)


def test_equal_poses_have_equal_images(scene, probe, small) -> None:
    noisy = replace(small, noise_level_db=-40.0)
    pose = np.where(np.eye(4) == 0, -0.0, np.eye(4))
    assert np.signbit(pose).any()
    images = [Simulator(scene, probe, noisy).render(each).image for each in (np.eye(4), pose)]
    np.testing.assert_array_equal(*images)


def test_every_stage_is_timed_and_the_frame_is_the_same(scene, probe, small) -> None:
    simulator = Simulator(scene, probe, small)
    unobserved = simulator.render(np.eye(4))
    moved = np.eye(4)
    moved[0, 3] = 1.0
    simulator.render(moved)
    with stage_times() as taken:
        start = time.perf_counter()
        timed = simulator.render(np.eye(4))
        whole = 1e3 * (time.perf_counter() - start)
    assert np.array_equal(unobserved.image, timed.image)
    counts = {name: len(taken[name]) for name in Stage}
    of_maps = (Stage.illumination, Stage.aperture, Stage.probe_rays, Stage.tracing, Stage.surface_echoes, Stage.clutter)
    assert counts == dict.fromkeys(Stage, 1) | dict.fromkeys((Stage.scan_conversion, *of_maps), 2)
    total = sum(sum(times) for times in taken.values())
    assert 0 < total <= whole
    simulator.render(moved)
    assert total == sum(sum(times) for times in taken.values()), "nothing is timed after the context"
