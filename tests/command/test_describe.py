"""What `task=describe` prints is the paper's table, beside what the networks see of this preset's frames."""

from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import trimesh
from skimage.io import imsave

from ablate.anatomy import validate_scene_folder
from ablate.command.compose import jobs_of
from ablate.command.describe import described, description
from ablate.settings.conf import variant_names
from ablate.settings.study import ConfigurationError
from ablate.tasks.run_task import describe

TOTALS = {
    "lsa2h": 57_171_266,
    "nsa2h": 57_170_242,
    "sa2h-att": 14_415_947,
    "sa2h-concat": 14_384_130,
    "sa2h-conv": 16_164_308,
    "sa2h-noise": 14_450_388,
    "sa2h": 14_450_964,
}
MORE = ("training.loss=none", "model.space=image")


@cache
def table_of(*words: str) -> pd.DataFrame:
    """The table of a command line, made once for all tests."""
    return described(jobs_of(words))


def test_the_papers_networks_have_the_papers_parameter_counts_at_every_size() -> None:
    table = table_of("preset=paper")
    assert list(table.index) == list(variant_names())
    for variant, total in TOTALS.items():
        assert table.loc[variant, "total"] == total
    assert (table["generator"] + table["discriminator"] == table["total"]).all()
    assert (table["total_here"] == table["total"]).all()
    # Measured by gradients in tests/networks/test_receptive_field.py.
    assert (table.loc[["sa2h", "sa2h-depth"], "paper_field_px"] == [173, 2813]).all()
    assert table.loc["sa2h", "paper_field_mm"] == pytest.approx(173 * 157.23 / 1000, rel=1e-4)
    assert (table["field_mm"] == table["paper_field_mm"]).all()
    smaller = described(jobs_of(["preset=paper", "simulator.image_shape=[256,355]"]))
    assert (smaller["total"] == table["total"]).all()
    assert (smaller["total_here"] < table["total"]).all()  # two levels less


def with_fold(fold: str) -> pd.DataFrame:
    """The table of `preset=quick` with this in all variants that leave it open."""
    variants = ",".join(name for name in variant_names() if name not in ("custom", "sa2h-printed"))
    table = table_of("-m", "preset=quick", f"model.fold={fold}", f"variant={variants}")
    return table.rename(index=lambda label: label.removesuffix(f".fold-{fold}"))


def test_a_miniature_sees_the_papers_millimetres_along_the_scanlines() -> None:
    table = with_fold("none")
    assert table["field_mm"].to_numpy() == pytest.approx(table["paper_field_mm"].to_numpy(), rel=0.12)
    assert table.loc["sa2h", "field_px"] == 45  # 41, and the convolution that refines the grain
    assert table.loc["sa2h", "field_percent"] == pytest.approx(100 * 45 / 384)
    assert table.loc["sa2h", "field_mm"] == pytest.approx(45 * 150 / 384)
    # More maps in the first convolutions, 4 x 4 to 64 channels, of generator and discriminator: two of position, and in
    # the generator of NSA2H the four of the grain in place of one of noise.
    for variant, more in (("lsa2h", 2 + 2), ("nsa2h", 2 + 3 + 2)):
        assert table.loc[variant, "total"] == TOTALS[variant] + more * 4 * 4 * 64


def test_folded_rows_see_twice_as_far_along_the_scanlines_and_leave_the_papers_size_as_it_is() -> None:
    every_row, folded = with_fold("none"), with_fold("rows")
    assert (folded["field_px"] == 2 * every_row["field_px"]).all()
    assert (folded["total"] == every_row["total"]).all()


def test_a_variant_of_another_encoding_has_its_row_and_its_parameters() -> None:
    alone, swept = described(jobs_of([])), described(jobs_of(["-m", "variant=sa2h,sa2h-printed"]))
    assert alone.loc["sa2h-printed"].equals(swept.loc["sa2h-printed"])
    assert swept.loc["sa2h-printed", "total"] == TOTALS["sa2h"]  # the paper's labels are one channel


@pytest.mark.parametrize(
    "changed",
    ["model.depth=6", *(pytest.param(word, marks=pytest.mark.slow) for word in MORE), "variant=custom"],
)
def test_a_job_that_is_no_variant_of_conf_has_a_row(changed: str) -> None:
    target = ["model.target=torch.nn.Identity"] if changed.endswith("custom") else []
    (job,) = jobs_of([changed, *target])
    table = described([job])
    assert list(table.index) == [job.label, *variant_names()]
    assert table.loc[job.label].equals(described(jobs_of(["-m", changed, *target])).iloc[0].rename(job.label))


def test_pairs_made_elsewhere_have_the_networks_that_are_trained_on_them(tmp_path: Path) -> None:
    for name in ("segmentation", "image", "attenuation"):
        (tmp_path / name).mkdir()
        imsave(tmp_path / name / "0.png", np.ones((128, 150), np.uint8), check_contrast=False)
    words = ["scene=pairs", f"scene.folder={tmp_path}"]
    alone, swept = described(jobs_of(words)), described(jobs_of(["-m", *words, "variant=sa2h,nsa2h"]))
    assert alone.loc[["sa2h", "nsa2h"]].equals(swept)


def test_the_text_is_whole_and_readable_at_120_columns() -> None:
    in_beam_space = description(jobs_of([]))
    assert "frame: 384 x 128 px of 0.39 mm (in the paper: 1000 rows of 0.16 mm)" in in_beam_space
    assert "crop: 384 px, 150 mm, 100 % of the frame's height (in the paper: 512 px, 81 mm, 51 %)" in in_beam_space
    text = description(jobs_of(["preset=paper", "simulator.image_shape=[300,416]", "training.crop=96"]))
    assert max(map(len, (text + "\n" + in_beam_space).splitlines())) <= 120
    assert "..." not in text
    assert "frame: 300 x 416 px of 0.52 mm (in the paper: 1000 rows of 0.16 mm)" in text
    assert "crop: 96 px, 50 mm, 32 % of the frame's height (in the paper: 512 px, 81 mm, 51 %)" in text
    for variant, total in TOTALS.items():
        assert any(line.split()[:1] == [variant] and line.endswith(f"{total:,}") for line in text.splitlines())


def test_a_network_deeper_than_any_of_the_papers_has_no_counterpart() -> None:
    table = described(jobs_of(["-m", "model.depth=3,8"]))
    assert list(table.index) == ["sa2h.depth-3", "sa2h.depth-8"]
    assert table.loc["sa2h.depth-3", "paper_depth"] == 5
    assert table.loc["sa2h.depth-8", ["paper_depth", "paper_field_px", "total"]].isna().all()


@pytest.mark.parametrize("arguments", [("preset=paper",), ("-m", "preset=paper", "variant=sa2h,sa2h-gan")])
def test_a_variant_without_a_discriminator_has_no_parameters_of_one(arguments: tuple[str, ...]) -> None:
    table = table_of(*arguments)
    with_one, without = table.loc["sa2h"], table.loc["sa2h-gan"]
    assert (with_one["discriminator"], without["discriminator"]) == (2_764_737, 0)
    assert without["total"] == without["generator"] == with_one["generator"]
    assert with_one["total_here"] - without["total_here"] == 2_764_737


def test_a_folder_without_scene_yaml_gets_a_proposal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    jobs = jobs_of(["-m", "task=describe", f"scene.folder={tmp_path}", "variant=sa2h,nsa2h"])
    with pytest.raises(ConfigurationError, match=r"has no scene\.yaml, no mesh and no volume"):
        describe(jobs)
    trimesh.creation.icosphere(1, radius=60).export(tmp_path / "liver.ply")
    (tmp_path / "scene.yaml").touch()  # as a shell does for `> scene.yaml`, before the command runs
    assert describe(jobs) == 0
    (tmp_path / "scene.yaml").write_text(capsys.readouterr().out)
    assert validate_scene_folder(tmp_path).meshes[0][1].name == "liver"
    assert describe(jobs) == 0
    said = capsys.readouterr().out
    assert "receptive field" in said
    assert "not in scene.yaml" not in said
    (tmp_path / "kidney.PLY").write_bytes((tmp_path / "liver.ply").read_bytes())
    assert describe(jobs) == 0
    assert capsys.readouterr().out.endswith(f"{tmp_path}: not in scene.yaml, so left out: kidney.PLY\n")
