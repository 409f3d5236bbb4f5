"""Views against the simulator itself; one set of triangles for every probe."""

import gc
import os
import re
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh

import ablate
from ablate.anatomy import Scene, Structure, Tissue, load_tissues
from ablate.command.compose import jobs_of
from ablate.networks import Generator, GeneratorSpec
from ablate.pretrained import NAMES, load
from ablate.training import TrainingPrecision
from ablate.training.inference import chosen_precision
from ablate.ultrasound import Display, Simulator
from ablate.ultrasound.probe import pixel_polar
from ablate.ultrasound.surfaces import geometry as surfaces
from ablate.viewer.fast_generator import FastGenerator
from ablate.viewer.generators import first_fitting, open_generator, pickable
from ablate.viewer.scene_renderer import SceneRenderer, coarse
from ablate.viewer.session import Quality, ViewerState
from ablate.viewer.trained import Trained
from support.viewed_body import BODY, STATE


@pytest.mark.parametrize("display", [None, Display()])
def test_at_rest_it_is_the_simulators_frame_bit_for_bit(display: Display | None) -> None:
    views = SceneRenderer(BODY, STATE.pose[None]).render(replace(STATE, display=display), Quality.full)
    frame = Simulator(BODY, STATE.probe, STATE.simulator).render(STATE.pose, STATE.seed)
    np.testing.assert_array_equal(views.target, frame.image)
    np.testing.assert_array_equal(views.segmentation, frame.segmentation)
    np.testing.assert_array_equal(views.attenuation, frame.attenuation)
    np.testing.assert_array_equal(views.mask, frame.mask)
    assert {"target", "maps"} == views.ms.keys()


def test_moving_it_has_the_same_maps_and_a_coarser_image() -> None:
    engine = SceneRenderer(BODY, STATE.pose[None])
    moving, rest = engine.render(STATE, Quality.coarse), engine.render(STATE, Quality.full)
    segmentation, attenuation = Simulator(BODY, STATE.probe, STATE.simulator).maps(STATE.pose)
    np.testing.assert_array_equal(moving.segmentation, segmentation)
    np.testing.assert_array_equal(moving.attenuation, attenuation)
    frame = Simulator(BODY, STATE.probe, coarse(STATE.simulator)).render(STATE.pose, STATE.seed)
    np.testing.assert_array_equal(moving.target, frame.image)
    assert (moving.target != rest.target).any()


def test_depth_and_frequency_change_without_building_embree_again(monkeypatch: pytest.MonkeyPatch) -> None:
    built, build = [], surfaces.Geometry.__init__

    def counted(geometry: surfaces.Geometry, *given: Any) -> None:
        built.append(1)
        build(geometry, *given)

    engine = SceneRenderer(BODY, STATE.pose[None])
    monkeypatch.setattr(surfaces.Geometry, "__init__", counted)
    engine.render(STATE, Quality.full)
    for probe in (replace(STATE.probe, depth_mm=90.0), replace(STATE.probe, frequency_mhz=5.0)):
        views = engine.render(replace(STATE, probe=probe), Quality.full)
        alone = Simulator(BODY, probe, STATE.simulator).render(STATE.pose, STATE.seed)
        np.testing.assert_array_equal(views.target, alone.image)
        np.testing.assert_array_equal(views.attenuation, alone.attenuation)
    assert len(built) == 3  # of the engine one, of the two simulators beside it one each


def test_triangles_of_another_scene_are_refused() -> None:
    other = Scene(BODY.structures, Tissue("gel"), "other")
    with pytest.raises(ValueError, match="beside: a simulator of scene 'other'"):
        Simulator(BODY, beside=Simulator(other))


def test_a_dynamic_range_that_cannot_be_is_refused_when_it_is_chosen() -> None:
    with pytest.raises(ValueError, match=r"dynamic_range_db=-5.*allowed are"):
        Display(dynamic_range_db=-5.0)


def test_gain_is_added_to_echoes_and_noise_alike() -> None:
    """10 dB more are 12.75 grey levels more of a display of 200 dB, on which nothing is black or white."""
    engine, plain, louder = (
        SceneRenderer(BODY, STATE.pose[None]),
        Display(dynamic_range_db=200.0),
        Display(10.0, dynamic_range_db=200.0),
    )
    frames = [engine.render(replace(STATE, display=d), Quality.full) for d in (plain, louder)]
    mask = frames[0].mask
    before, after = (frame.target[mask].astype(float) for frame in frames)
    assert before.min() > 0
    assert after.max() < 255
    right = np.abs(after - before - 12.75) <= 1  # both are rounded
    assert right.mean() > 0.995, "all but what is black before scan conversion, in the shadow of the bone"


def test_tgc_sliders_brighten_their_depth_alone() -> None:
    engine = SceneRenderer(BODY, STATE.pose[None])
    shown = [engine.render(replace(STATE, display=Display(tgc_db=(0, 0, db))), Quality.full).target for db in (0, 20)]
    depth = pixel_polar(STATE.probe, STATE.simulator.image_shape)[0] / STATE.probe.depth_mm
    plain, deep = (image.astype(float) for image in shown)
    np.testing.assert_array_equal(plain[depth < 0.45], deep[depth < 0.45])
    assert (deep - plain)[(depth > 0.95) & (depth < 1) & (plain > 0)].mean() > 40  # 20 dB of 60 are 85 of 255


def test_controls_of_a_finished_image_are_those_of_the_simulator() -> None:
    image = np.array([[0, 60, 120, 180]], np.uint8)
    settings = ViewerState(np.eye(4)).simulator
    shown = Display(gain_db=6.0, dynamic_range_db=40.0).shown(image, np.zeros(image.shape), settings)
    level_db = (image[0] / 255 - 1) * 60 + 6
    expected = np.clip(255 * (level_db / 40 + 1), 0, 255)
    np.testing.assert_allclose(shown[0, 1:], expected[1:], atol=0.5)
    assert shown[0, 0] == 0


def test_a_run_that_is_gone_is_said_in_a_note(tmp_path: Path) -> None:
    views = SceneRenderer(BODY, STATE.pose[None]).render(replace(STATE, runs=(tmp_path / "gone",)), Quality.full)
    assert views.generated == (None,)
    assert "this run is gone" in views.notes["generated 0"]
    assert views.target.any()


def test_a_probe_in_the_air_is_rendered_without_a_warning() -> None:
    away = STATE.pose.copy()
    away[1, 3] -= 500
    views = SceneRenderer(BODY, STATE.pose[None]).render(replace(STATE, pose=away), Quality.full)
    assert set(np.unique(views.segmentation)) == {0, 1}


def test_a_network_that_comes_with_the_package_renders_and_says_what_it_does_not_know() -> None:
    offered = pickable(Path("nowhere"))
    shipped = [f"comes with ablate: {name}" for name in ("sa2h", "full", "sa2h-512")]
    assert list(offered) == [*shipped, "comes with ablate: the formula"]
    assert len(NAMES) == 3
    picked = {"here": offered["comes with ablate: sa2h"]}
    views = SceneRenderer(BODY, STATE.pose[None]).render(replace(STATE, runs=tuple(picked.values())), Quality.full)
    (image,) = views.generated
    assert image is not None
    assert image.shape == STATE.simulator.image_shape
    assert (image[~views.mask] == 0).all()
    assert image[views.mask].std() > 5
    assert "not trained on gel" in views.notes["generated 0"]
    assert re.search(
        r"trained with .*pixels of 0\.61 x 0\.61 mm \(here [\d.]+ x [\d.]+ mm\)", views.notes["generated 0"]
    )
    assert "MHz" not in views.notes["generated 0"]
    assert first_fitting(picked, BODY.tissues, STATE) == ()


@pytest.mark.parametrize(("name", "preset"), [("sa2h", "quick"), ("sa2h-512", "fine")])
def test_a_preset_is_shown_with_the_shipped_network_that_was_trained_in_it(name: str, preset: str) -> None:
    settings, offered = jobs_of([f"preset={preset}"])[0].settings, pickable(Path("nowhere"))
    state = replace(STATE, probe=settings.probe, simulator=settings.simulator)
    assert first_fitting(offered, [*load_tissues().values()], state) == (offered[f"comes with ablate: {name}"],)
    trained = replace(load(name).simulator, time_gain_db=None)
    own = replace(state, simulator=replace(settings.simulator, time_gain_db=(0.0,) * 8))
    assert first_fitting(offered, [*load_tissues().values()], own) == (), "its images are brighter at depth"
    assert trained == settings.simulator, "a preset that changes needs another network, or other words on its card"


def test_a_run_that_was_trained_again_is_opened_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened, shipped = [], pickable(Path("nowhere"))["comes with ablate: sa2h"]

    def opens(folder: Path, tissues: Sequence[Tissue], _custom: str | None) -> Trained:
        opened.append(folder)
        return open_generator(shipped, tissues)

    monkeypatch.setattr("ablate.viewer.scene_renderer.open_generator", opens)
    engine, state, images = SceneRenderer(BODY, STATE.pose[None]), replace(STATE, runs=(tmp_path,)), []
    for written_ns in (1, 1, 2):
        (tmp_path / "last.ckpt").touch()
        os.utime(tmp_path / "last.ckpt", ns=(0, written_ns))
        images.append(engine.render(state, Quality.full).ms["generated 0"])
    assert len(opened) == 2
    assert images[0] == images[1] != images[2], "milliseconds: rendered once for each training"


def test_the_image_of_a_network_is_that_of_ablate_load() -> None:
    """With tissues that it knows, against the library's own way to render."""
    renderer, table = ablate.load("sa2h"), load_tissues()
    fluid, tissue = (table[name] for name in [name for name in renderer.values if name][:2])
    known = Scene((Structure(trimesh.creation.icosphere(4, 100), tissue),), fluid, "known")
    picked = (offered := pickable(Path("nowhere")))["comes with ablate: sa2h"]
    finer = replace(renderer.simulator, rays=1, layers=1, time_gain_db=None)
    at_its_size = replace(STATE, simulator=finer)
    assert first_fitting(offered, known.tissues, at_its_size) == (picked,)
    darker = replace(at_its_size, simulator=replace(finer, dynamic_range_db=40.0))
    assert open_generator(picked, known.tissues).reservation(darker) == (
        "trained with dynamic_range_db=60.0 (here 40.0)"
    )
    deeper = replace(at_its_size, probe=replace(STATE.probe, depth_mm=170.0))
    assert first_fitting(offered, known.tissues, deeper) == ()
    said = open_generator(picked, known.tissues).reservation(deeper).partition(", ")[0]
    assert said == f"trained with depth_mm={renderer.probe.depth_mm} (here 170.0)", "what does not differ is not named"
    wider = replace(at_its_size, simulator=replace(finer, scanlines=256))
    said = open_generator(picked, known.tissues).reservation(wider)
    assert said == "trained with rows x scanlines of 384 x 128 (here 384 x 256)"
    changed = [fluid, replace(tissue, scatterer_density=0.001)]
    unlike = open_generator(picked, changed).reservation(at_its_size)
    assert unlike == f"not trained on {tissue.name.replace('_', ' ')}"
    engine, state = SceneRenderer(known, STATE.pose[None]), replace(STATE, runs=(picked,), seed=3)
    moving, rest = engine.render(state, Quality.coarse), engine.render(state, Quality.full)
    frame = Simulator(known, STATE.probe, STATE.simulator).render(STATE.pose, seed=3)
    with pytest.warns(UserWarning, match=re.escape(rest.notes["generated 0"])):  # what the page says, too
        exact = renderer.render(frame, known.tissues)
    with pytest.warns(UserWarning, match="trained with"):
        whole = load("full").render(frame, known.tissues)
    np.testing.assert_array_equal(rest.generated[0], exact)
    np.testing.assert_array_equal(moving.generated[0], exact, "S, A and grain are complete while the probe moves")
    of_full = engine.render(replace(state, runs=(offered["comes with ablate: full"],)), Quality.coarse)
    assert 0 < np.abs(of_full.generated[0].astype(int) - whole)[moving.mask].mean() < 3, "its surfaces, of one layer"
    louder = engine.render(replace(state, display=Display(tgc_db=(0, 0, 20))), Quality.full)
    assert louder.ms["generated 0"] == rest.ms["generated 0"], "a display renders no generator again"


def test_a_generator_is_exported_while_it_is_used_and_renders_the_same_image() -> None:
    pytest.importorskip("openvino", reason="needs the extra: pip install 'ablate-ultrasound[export]'")
    small = Generator(GeneratorSpec(depth=2, width=0.1, noise_start=0.1)).eval()
    fast, mask = FastGenerator(small), torch.ones(48, 66, dtype=torch.bool)
    generator = torch.Generator().manual_seed(0)
    maps = {name: torch.rand((1, 1, 48, 66), generator=generator) for name in ("segmentation", "attenuation")}

    render = partial(FastGenerator.render, fast, maps, mask, torch.tensor([3]), True)

    first, last, end = render(), render(), time.monotonic() + 120
    np.testing.assert_array_equal(first, last)
    while not fast._opened:
        assert time.monotonic() < end
        last = render()
        time.sleep(0.2)
    in_bf16 = chosen_precision(TrainingPrecision.auto, torch.device("cpu")) is TrainingPrecision.bf16
    np.testing.assert_allclose(last, first.astype(float), atol=3 if in_bf16 else 1)  # grey levels, which are rounded
    np.testing.assert_array_equal(FastGenerator.render(fast, maps, mask, torch.tensor([3]), False), first)
    assert last.std() > 5
    folder = fast._folder
    del fast, render
    gc.collect()
    assert not folder.exists()


def test_the_formula_renders_the_frame_that_a_data_set_would_have_of_it() -> None:
    """Speckle, fan and controls are those of the simulated frame; no training is needed."""
    state = replace(STATE, runs=(pickable(Path("nowhere"))["comes with ablate: the formula"],))
    views = SceneRenderer(BODY, STATE.pose[None]).render(state, Quality.full)
    (image,) = views.generated
    assert image is not None
    assert "generated 0" not in views.notes
    assert (image[~views.mask] == 0).all()
    assert np.corrcoef(image[views.mask], views.target[views.mask])[0, 1] > 0.5
    bright = SceneRenderer(BODY, STATE.pose[None]).render(replace(state, display=Display(gain_db=6.0)), Quality.full)
    assert bright.generated[0][views.mask].mean() > image[views.mask].mean() + 10
