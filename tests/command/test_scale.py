"""Miniatures to scale: every network and the crop cover the paper's millimetres, whatever the frame's pixels."""

import math
from pathlib import Path

import numpy as np
import pytest
from skimage.io import imsave

from ablate.command.compose import job_of, jobs_of
from ablate.command.scale import PAPER_ROWS, crop, levels, paper_levels
from ablate.networks import receptive_field

LOCAL, UNET = 4, 8  # levels in the paper's frame


@pytest.mark.parametrize(
    ("frame", "local", "deep", "side"),
    [((1000, 1386), 4, 8, 512), ((512, 710), 3, 7, 256), ((256, 355), 2, 6, 128), ((128, 177), 1, 5, 64)],
)
def test_a_frame_n_times_smaller_has_log2_n_levels_less_and_a_crop_n_times_smaller(
    frame: tuple[int, int], local: int, deep: int, side: int
) -> None:
    size = f"simulator.image_shape=[{frame[0]},{frame[1]}]"
    jobs = {
        job.label: job.settings
        for job in jobs_of(["-m", "variant=sa2h,sa2h-depth,lsa2h,nsa2h", size, "model.space=image"])
    }
    assert len(jobs) == 4
    for settings in jobs.values():
        assert settings.model.depth == (local if settings.variant == "sa2h" else deep)
        assert settings.training.crop == side


def test_any_frame_keeps_the_papers_share_within_the_rounding() -> None:
    paper = receptive_field(jobs_of(["preset=paper"])[0].settings.model) / PAPER_ROWS
    for rows in range(100, 1400, 37):
        deviation = math.log2(PAPER_ROWS / rows) - (LOCAL - levels(LOCAL, rows))
        assert abs(deviation) <= 0.5
        assert abs(crop(rows) / rows - 0.512) <= 2 ** (levels(UNET, rows) - 1) / rows
        assert crop(rows) % 2 ** levels(UNET, rows) == 0
    (quick,) = jobs_of(["preset=quick", "model.space=image", "model.grain=output"])
    share = receptive_field(quick.settings.model) / quick.settings.simulator.image_shape[0]
    assert share == pytest.approx(paper, rel=0.1)


def test_images_made_elsewhere_are_to_the_scale_of_their_own_pixels(tmp_path: Path) -> None:
    for name in ("segmentation", "image"):
        (tmp_path / name).mkdir()
        imsave(tmp_path / name / "0.png", np.ones((512, 600), np.uint8), check_contrast=False)
    where = ["preset=tiny", "scene=pairs", f"scene.folder={tmp_path}"]
    (job,) = jobs_of([*where, "model.depth=${levels:8}"])
    assert job.settings.simulator.image_shape == (512, 600)
    assert (job.settings.model.depth, job.settings.training.crop, job.label) == (7, 256, "sa2h.depth-7")
    (nowhere,) = jobs_of(["scene=pairs", f"scene.folder={tmp_path}/nowhere"])
    assert nowhere.settings.simulator.image_shape[0] == PAPER_ROWS


@pytest.mark.parametrize("shape", ["[64, 89]", "${fan_shape:64}"])
def test_a_preset_of_ones_own_has_the_image_that_it_says(tmp_path: Path, shape: str) -> None:
    (tmp_path / "preset").mkdir()
    lines = ["# @package _global_", "defaults: [tiny]", "preset: mine", "simulator:", f"  image_shape: {shape}"]
    (tmp_path / "preset" / "mine.yaml").write_text("\n".join(lines))
    settings = job_of(["preset=mine"], fixed=[f"hydra.searchpath=[file://{tmp_path}]"]).settings
    assert settings.simulator.image_shape == (64, 89)


def test_each_job_of_a_sweep_over_presets_is_to_its_own_scale() -> None:
    jobs = jobs_of(["-m", "preset=tiny,paper", "model.depth=${levels:4},${levels:8}"])
    assert [(job.settings.preset, job.settings.model.depth, job.label) for job in jobs] == [
        ("tiny", 1, "sa2h"),
        ("tiny", 5, "sa2h.depth-5"),
        ("paper", 4, "sa2h"),
        ("paper", 8, "sa2h.depth-8"),
    ]


def test_the_reference_of_add_one_in_is_one_of_its_jobs_at_every_size() -> None:
    jobs = jobs_of(["+study=add_one_in", "preset=tiny,paper"])
    for preset, deep in (("tiny", 5), ("paper", 8)):
        nothing, *others = [job for job in jobs if job.settings.preset == preset]
        assert f".depth-{deep}." in nothing.label
        assert {job.settings.reference for job in (nothing, *others)} == {nothing.label}


@pytest.mark.parametrize("rows", [32, 64, 90, 2000, 5000])
def test_frames_beyond_what_networks_allow_get_the_nearest(rows: int) -> None:
    assert levels(LOCAL, rows) == {32: 1, 64: 1, 90: 1, 2000: 5, 5000: 6}[rows]
    assert levels(UNET, rows) == {32: 3, 64: 4, 90: 5, 2000: 8, 5000: 8}[rows]
    assert crop(rows) >= 32
    assert paper_levels(levels(LOCAL, rows), rows) == LOCAL
    assert paper_levels(levels(UNET, rows), rows) == UNET
