"""Pairs made elsewhere serve a study as simulated ones do, as far as they go."""

import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from skimage.io import imsave

from ablate.command.compose import jobs_of
from ablate.command.launch import Launch
from ablate.dataset import Part
from ablate.dataset.export_formats import write_png
from ablate.dataset.png_folder import FOLDERS
from ablate.settings.study import ConfigurationError
from ablate.sources.data_set import DataSet
from ablate.study.run import read_list
from ablate.tasks import study as tasks
from ablate.viewer.generators import open_generator
from support.studies import TINY, TinyStudy, run

#: What scene=pairs leaves a generator, which reads maps that others can have too.
AS_PAIRS = ["encoding=echogenicity", "model={space:image,position:none,interfaces:none,attenuation:integral}"]


def make_all_maps(arguments: list[str]) -> None:
    lsa2h = ["study_name=maps", "variant=lsa2h"]  # the only one that reads `low`
    assert run("task=simulate", *arguments, *lsa2h) == 0


@pytest.fixture(scope="module")
def simulated(tiny_study: TinyStudy, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of simulated pairs, which have every map."""
    runs = tmp_path_factory.mktemp("simulated") / "runs"
    shutil.copytree(tiny_study.runs / "data", runs / "data")
    make_all_maps([f"runs_dir={runs}", *TINY])
    assert run(f"runs_dir={runs}", *TINY, *AS_PAIRS) == 0
    return runs


def data_of(runs: Path) -> DataSet:
    return DataSet(next(runs.glob("data/*/about.json")).parent)


@pytest.fixture(scope="module")
def folder(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("elsewhere") / "pngs"
    write_png(data_of(simulated).pairs, made, data_of(simulated).tissues)
    return made


def per_image(runs: Path, variant: str) -> pd.DataFrame:
    (folder,) = runs.glob(f"*/{variant}-seed0-*")
    files = sorted(folder.glob("scores/*.parquet"))
    return pd.concat([pd.read_parquet(path) for path in files], ignore_index=True)


def test_exported_pairs_come_back_bit_for_bit_and_train_the_same_networks(
    simulated: Path, folder: Path, runs: Path
) -> None:
    arguments = [f"runs_dir={runs}", *TINY, "scene=pairs", f"scene.folder={folder}"]
    make_all_maps(arguments)
    assert run(*arguments) == 0
    there, here = data_of(simulated).pairs, data_of(runs).pairs
    for name in FOLDERS:
        np.testing.assert_array_equal(here.read(name, range(12)), there.read(name, range(12)))
    np.testing.assert_array_equal(here.mask(), there.mask())
    np.testing.assert_array_equal(here.split, there.split)
    assert len(set(zip(here.sites, there.sites, strict=True))) == len(set(there.sites))  # other numbers, same groups
    assert here.tissues == there.tissues
    assert not (here.folder / "pairs.zarr" / "resimulation").exists()
    mine, theirs = per_image(runs, "sa2h"), per_image(simulated, "sa2h*")
    assert set(mine["source"]) == {"model"}
    assert set(mine["metric"]) >= {"psnr", "pchi2", "mae_smooth", "shadow_contrast"}
    theirs = theirs[(theirs["source"] == "model") & ~theirs["metric"].str.startswith("motion")].reset_index(drop=True)
    other = ["site"]  # their numbers
    pd.testing.assert_frame_equal(mine.drop(columns=other), theirs.drop(columns=other))
    (run_here,) = read_list(runs / "tiny-pngs").runs
    assert not [name for name in run_here.scalars if "floor" in name]
    report = next(runs.glob("tiny-pngs/comparison/report.html")).read_text()
    assert "The re-simulation is missing" in report
    assert "pairs made elsewhere cannot be simulated again" in report
    assert "re-simulation" not in next(runs.glob("*/comparison/table.csv")).read_text()
    before = {p: p.stat().st_mtime_ns for p in runs.rglob("*") if p.is_file()}
    assert tasks.study(jobs_of(arguments), Launch(lambda *_: pytest.fail("all is finished"))) == 0
    kept = [p for p in before if p.suffix in {".json", ".ckpt", ".parquet", ".csv", ".html"} or p.name == "0"]
    assert all(p.stat().st_mtime_ns == before[p] for p in kept)


def bare(folder: Path, tmp_path: Path) -> Path:
    """Only segmentations and images, of names that tell the site."""
    made = tmp_path / "bare"
    for _, row in pd.read_csv(folder / "frames.csv").iterrows():
        for place in ("segmentation", "image"):
            (made / place).mkdir(parents=True, exist_ok=True)
            shutil.copy(folder / place / f"{row['name']}.png", made / place / f"{row['site']}_{row['name']}.png")
    return made


@pytest.mark.parametrize("numbered", [None, "{:04}.png", "{:04}_us.png"])  # a site is what stands before the last _
def test_what_pairs_leave_out_is_said(folder: Path, runs: Path, tmp_path: Path, numbered: str | None) -> None:
    own = bare(folder, tmp_path)
    for k, path in enumerate(sorted((own / "segmentation").glob("*.png")) if numbered else ()):
        for name in ("segmentation", "image"):
            (own / name / path.name).rename(own / name / str(numbered).format(k))
    where = ["scene=pairs", f"scene.folder={own}", f"runs_dir={runs}", "dataset.frames=3"]
    assert run("task=simulate", "variant=sa2h-att", *TINY, *where) == 0
    left_out = data_of(runs).about["left_out"]
    assert any("sites: none are named" in line for line in left_out) is (numbered is not None)
    assert any("dataset.frames: all 12 pairs" in line for line in left_out), "a setting that decides nothing is said"


@pytest.mark.parametrize("patients", [4, 12])
def test_pictures_that_are_in_two_parts_are_said(folder: Path, runs: Path, tmp_path: Path, patients: int) -> None:
    """Four pictures, each of three frames, of one patient or of three."""
    shutil.copytree(folder, tmp_path / "own")
    names = [f"frame{k:05d}" for k in range(12)]
    for k, name in enumerate(names):
        for place in ("segmentation", "image"):
            shutil.copy(folder / place / f"{names[k % 4]}.png", tmp_path / "own" / place / f"{name}.png")
    rows = [f"{name},{k % patients}" for k, name in enumerate(names)]
    (tmp_path / "own" / "frames.csv").write_text("\n".join(["name,site", *rows]))
    where = ["scene=pairs", f"scene.folder={tmp_path / 'own'}", f"runs_dir={runs}"]
    assert run("task=simulate", "variant=sa2h-att", *TINY, *where) == 0
    said = [line for line in data_of(runs).about["left_out"] if "the same pictures are in two parts" in line]
    assert bool(said) == (patients == 12)
    pairs = data_of(runs).pairs
    training = {pairs.stored("target", int(i)).tobytes() for i in pairs.frames(Part.train)}
    twice = sum(pairs.stored("target", int(i)).tobytes() in training for i in pairs.frames(Part.test))
    assert not said or f"{twice} of {len(pairs.frames(Part.test))} test frames" in said[0]


def test_segmentations_and_images_alone_are_enough_for_a_variant_without_attenuation(
    folder: Path, runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    where = [*TINY, "scene=pairs", f"scene.folder={bare(folder, tmp_path)}", f"runs_dir={runs}"]
    message = r"^variant sa2h reads attenuation, but .*bare has no folder attenuation; .* that read segmentation alone$"
    with pytest.raises(ConfigurationError, match=message):
        run("-m", "variant=sa2h-att,sa2h", *where)
    assert not (runs / "data").exists()
    assert run("variant=sa2h-att", *where) == 0
    told = capsys.readouterr()
    for line in (
        "Importing 12 pairs",
        "left out: re-simulation",
        "left out: shadow_contrast and variants that read A: there is no folder attenuation",
        "left out: tissues: without labels.csv the labels are ordered by number",
    ):
        assert line in told.out + told.err
    table = per_image(runs, "sa2h-att")
    assert "psnr" in set(table["metric"])
    assert "shadow_contrast" not in set(table["metric"])
    pairs = data_of(runs).pairs
    assert pairs.maps == {"segmentation", "target"}
    assert pairs.tissues[:2] == ("label_1", "label_2")
    for site in np.unique(pairs.sites):
        assert len(set(pairs.split[pairs.sites == site])) == 1


def test_a_generator_of_such_pairs_is_shown_with_their_probe_or_with_a_word(folder: Path, tmp_path: Path) -> None:
    arguments = [f"runs_dir={tmp_path}", *TINY, "scene=pairs", f"scene.folder={folder}", "probe.depth_mm=100"]
    assert run(*arguments) == 0
    (trained,) = tmp_path.glob("*/sa2h-seed0-*")
    data = data_of(tmp_path)
    opened = open_generator(trained, data.tissues)
    assert opened.renderer.probe.depth_mm == 150
    assert opened.unknown == ""
    shutil.rmtree(data.folder)
    assert "its data set is gone" in open_generator(trained, data.tissues[::-1]).unknown


def test_depths_are_known_where_the_fan_is_told_or_is_that_of_the_probe(folder: Path, tmp_path: Path) -> None:
    untold = tmp_path / "untold"
    shutil.copytree(folder, untold, ignore=shutil.ignore_patterns("fan.yaml"))
    for pngs, known in ((folder, True), (untold, False)):
        where = ["scene=pairs", f"scene.folder={pngs}", f"runs_dir={tmp_path / pngs.name}", "probe.depth_mm=100"]
        assert run("task=simulate", *TINY, *where) == 0
        data = DataSet(next((tmp_path / pngs.name / "data").iterdir()))
        assert any("depth_mm=100, so depths are not known" in line for line in data.about["left_out"]) is not known
        assert (data.pairs.probe is not None) is known
    where[-1:] = ["probe.depth_mm=150", f"runs_dir={tmp_path / 'similar'}"]
    assert run("task=simulate", *TINY, *where) == 0
    (left_out,) = (DataSet(folder).about["left_out"] for folder in (tmp_path / "similar" / "data").iterdir())
    assert "fan.yaml: there is none, so depths and sizes in mm are those of probe.* of the settings" in left_out


def test_a_network_in_beam_space_needs_the_fan_and_learns_from_the_images_of_others(
    folder: Path, tmp_path: Path
) -> None:
    told = tmp_path / "told"
    shutil.copytree(folder, told)
    where = [*TINY, "scene=pairs", f"scene.folder={told}", f"runs_dir={tmp_path / 'runs'}"]
    in_beam_space = ["model.space=beam", "model.position=beam"]
    fan = told / "fan.yaml"
    fitting = fan.read_text()
    fan.write_text(fitting.replace("fov_deg: 70", "fov_deg: 60"))
    with pytest.raises(ConfigurationError, match=r"^.*told/fan\.yaml: its fan is not that of the images, .*frame00000"):
        run(*where, *in_beam_space)
    fan.unlink()
    for key in in_beam_space:
        message = rf"^{re.escape(key)} in variant .*: needs .*told/fan\.yaml, .* allowed without it is (image|none)$"
        with pytest.raises(ConfigurationError, match=message):
            run(*where, key)
    assert not (tmp_path / "runs" / "data").exists()
    fan.write_text(fitting)
    assert run(*where, *in_beam_space) == 0
    assert set(per_image(tmp_path / "runs", "sa2h*")["metric"]) >= {"psnr", "shadow_contrast"}


@pytest.mark.parametrize(
    "key", ["attenuation=compensated", "attenuation=illumination", "attenuation=compound", "interfaces=echo"]
)
def test_a_map_that_only_the_simulator_makes_is_refused(folder: Path, tmp_path: Path, key: str) -> None:
    where = [f"runs_dir={tmp_path / 'runs'}", "scene=pairs", f"scene.folder={folder}"]
    message = rf"^model\.{key} in variant .*pairs made elsewhere .*allowed are (integral and )?none$"
    with pytest.raises(ConfigurationError, match=message):
        run(*where, f"model.{key}")


def test_the_grain_of_a_body_that_nobody_knows_is_refused(folder: Path, tmp_path: Path) -> None:
    where = [f"runs_dir={tmp_path / 'runs'}", "scene=pairs", f"scene.folder={folder}", "model.noise=body"]
    with pytest.raises(ConfigurationError, match=r"^model\.noise=body with space=image: .*allowed is space=beam$"):
        run(*where)
    message = r"^model\.noise=body in variant .*only a simulator knows.*allowed are inject, input and none$"
    with pytest.raises(ConfigurationError, match=message):
        run(*where, "model.space=beam")


def test_a_site_on_two_sides_is_refused_unless_frames_are_split(folder: Path, tmp_path: Path) -> None:
    moved = tmp_path / "moved"
    shutil.copytree(folder, moved)
    pd.read_csv(moved / "frames.csv").assign(site="one").to_csv(moved / "frames.csv", index=False)
    where = [*TINY, "scene=pairs", f"scene.folder={moved}", f"runs_dir={tmp_path / 'runs'}"]
    with pytest.raises(ConfigurationError, match=r"frames\.csv: site 'one' is in two parts; .*dataset\.split=frame"):
        run("task=simulate", *where)
    assert run("task=simulate", *where, "dataset.split=frame") == 0


def test_too_few_sites_and_too_small_a_fan_are_refused_before_anything_is_written(folder: Path, tmp_path: Path) -> None:
    made = bare(folder, tmp_path)
    where = [*TINY, f"runs_dir={tmp_path / 'runs'}", "scene=pairs", "variant=sa2h-att", f"scene.folder={made}"]
    (made / "frames.csv").write_text("name,site\n" + "".join(f"{p.stem},one\n" for p in made.glob("image/*.png")))
    with pytest.raises(ConfigurationError, match=r"1 sites cannot be split .*, or for dataset\.split=frame"):
        run("task=simulate", *where)
    (made / "frames.csv").unlink()
    for path in made.glob("*/*.png"):
        imsave(path, np.ones((40, 40), np.uint8), check_contrast=False)
    with pytest.raises(ConfigurationError, match=r"no patch of 48 x 48 px .*; FD speckle needs a larger one"):
        run("task=simulate", *where)
    assert not (tmp_path / "runs" / "data").exists()
