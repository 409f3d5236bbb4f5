"""Pairs made elsewhere serve a study as simulated ones do, as far as they go."""

import csv
import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from skimage.io import imsave

from ablate.__main__ import main
from ablate.dataset import Pairs, Part
from ablate.jobs.compose import jobs_of
from ablate.jobs.launch import Launch
from ablate.runs.data_set import DataSet
from ablate.settings.study import ConfigurationError
from ablate.tasks import run_task as tasks
from support.studies import TINY, TinyStudy, run

FOLDERS = {"segmentation": "segmentation", "target": "image", "attenuation": "attenuation", "low": "low"}


def study(arguments: list[str]) -> None:
    """Make every map, then train the variant that `arguments` name."""
    assert run(*arguments) == 0


def make_all_maps(arguments: list[str]) -> None:
    lsa2h = ["study_name=maps", "variant=lsa2h"]  # the only one that reads `low`
    assert run("task=simulate", *arguments, *lsa2h) == 0


def export(pairs: Pairs, folder: Path) -> None:
    """Write a data set as PNGs, attenuation with 16 bits, and the tables that say what was what."""
    names = [f"{i:02d}" for i in range(len(pairs))]
    for map_name, place in FOLDERS.items():
        (folder / place).mkdir(parents=True)
        for i, name in enumerate(names):
            image = pairs.read(map_name, [i])[0]
            if map_name == "attenuation":
                image = np.rint(image.astype(np.float64) * 65535).astype(np.uint16)
            imsave(folder / place / f"{name}.png", image, check_contrast=False)
    with (folder / "frames.csv").open("w", newline="") as stream:
        rows = zip(names, pairs.sites.tolist(), [Part(p).name for p in pairs.split], strict=True)
        csv.writer(stream).writerows([("name", "site", "part"), *rows])
    with (folder / "labels.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows([("label", "tissue"), *enumerate(pairs.tissues, start=1)])


@pytest.fixture(scope="module")
def simulated(tiny_study: TinyStudy, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of a study of simulated pairs, with every map."""
    runs = tmp_path_factory.mktemp("simulated") / "runs"
    shutil.copytree(tiny_study.runs, runs)
    make_all_maps([f"runs_dir={runs}", *TINY])
    return runs


def data_of(runs: Path) -> Pairs:
    return DataSet(next(runs.glob("data/*/about.json")).parent).pairs


@pytest.fixture(scope="module")
def folder(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("elsewhere") / "pngs"
    export(data_of(simulated), made)
    return made


def per_image(runs: Path, variant: str) -> pd.DataFrame:
    (path,) = runs.glob(f"*/{variant}/seed0/per_image.parquet")
    return pd.read_parquet(path)


def test_exported_pairs_come_back_bit_for_bit_and_train_the_same_networks(
    simulated: Path, folder: Path, runs: Path
) -> None:
    arguments = [f"runs_dir={runs}", *TINY, "scene=pairs", f"scene.folder={folder}"]
    make_all_maps(arguments)
    study(arguments)
    there, here = data_of(simulated), data_of(runs)
    for name in FOLDERS:
        np.testing.assert_array_equal(here.read(name, range(12)), there.read(name, range(12)))
    np.testing.assert_array_equal(here.mask(), there.mask())
    np.testing.assert_array_equal(here.split, there.split)
    assert len(set(zip(here.sites, there.sites, strict=True))) == len(set(there.sites))  # other numbers, same groups
    assert here.tissues == there.tissues
    assert not (here.folder / "pairs.zarr" / "resimulation").exists()
    mine, theirs = per_image(runs, "sa2h"), per_image(simulated, "sa2h")
    assert set(mine["source"]) == {"model"}
    assert set(mine["metric"]) >= {"psnr", "pchi2", "mae_smooth", "shadow_contrast"}
    theirs = theirs[theirs["source"] == "model"].reset_index(drop=True)
    pd.testing.assert_frame_equal(mine.drop(columns="site"), theirs.drop(columns="site"))
    result = json.loads(next(runs.glob("*/sa2h/seed0/result.json")).read_text())
    assert not [name for name in result["scalars"] if "floor" in name]
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
    with (folder / "frames.csv").open() as stream:
        for row in csv.DictReader(stream):
            for place in ("segmentation", "image"):
                (made / place).mkdir(parents=True, exist_ok=True)
                shutil.copy(folder / place / f"{row['name']}.png", made / place / f"p{row['site']}_{row['name']}.png")
    return made


def test_segmentations_and_images_alone_are_enough_for_a_variant_without_attenuation(
    folder: Path, runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    where = [*TINY, "scene=pairs", f"scene.folder={bare(folder, tmp_path)}", f"runs_dir={runs}"]
    with pytest.raises(
        ConfigurationError,
        match=r"^variant sa2h reads attenuation, but .*bare has no folder attenuation; .* without it: sa2h-att$",
    ):
        study(["-m", "variant=sa2h-att,sa2h", *where])
    assert not (runs / "data").exists()
    study(["variant=sa2h-att", *where])
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
    pairs = data_of(runs)
    assert pairs.maps == {"segmentation", "target"}
    assert pairs.tissues[:2] == ("label_1", "label_2")
    for site in np.unique(pairs.sites):
        assert len(set(pairs.split[pairs.sites == site])) == 1


def test_depths_are_known_only_where_the_fan_is_that_of_the_probe(folder: Path, tmp_path: Path) -> None:
    where = ["scene=pairs", f"scene.folder={folder}", f"runs_dir={tmp_path}", "probe.depth_mm=100"]
    assert run("task=simulate", *TINY, *where) == 0
    data = DataSet(next(tmp_path.glob("data/*")))
    assert any("depth_mm=100, so depths are not known" in line for line in data.left_out)


def test_what_cannot_be_is_refused_before_anything_is_started(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    where = [f"runs_dir={tmp_path / 'runs'}", "scene=pairs"]
    with pytest.raises(ConfigurationError, match=r"scene=pairs needs scene\.folder=path/to/folder"):
        study(where)
    with pytest.raises(ConfigurationError, match="task=preview: pairs made elsewhere have no scene"):
        run("task=preview", *where, f"scene.folder={folder}")
    with pytest.raises(ConfigurationError, match=r"^model\.attenuation=compensated in variant sa2h-c.*allowed are int"):
        study([*where, f"scene.folder={folder}", "variant=sa2h-compensated"])
    broken = tmp_path / "broken"
    shutil.copytree(folder, broken)
    (broken / "image" / "03.png").unlink()
    monkeypatch.setattr(sys, "argv", ["ablate", *where, f"scene.folder={broken}"])
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    error = capsys.readouterr().err
    assert len(error.strip().splitlines()) == 1, error
    assert f"{broken / 'image' / '03.png'}: missing, though its partner" in error
    assert not list((tmp_path / "runs").glob("*/*")), "something was started"


def test_a_site_on_two_sides_is_refused_unless_frames_are_split(folder: Path, tmp_path: Path) -> None:
    moved = tmp_path / "moved"
    shutil.copytree(folder, moved)
    text = (moved / "frames.csv").read_text().splitlines()
    first = [line.split(",")[1] for line in text[1:]]
    rows = [line.split(",") for line in text[1:]]
    for row in rows:
        row[1] = first[0]
    (moved / "frames.csv").write_text("\n".join([text[0], *(",".join(row) for row in rows)]))
    where = [*TINY, "scene=pairs", f"scene.folder={moved}", f"runs_dir={tmp_path / 'runs'}"]
    with pytest.raises(ConfigurationError, match=r"frames\.csv: site '\d+' is in two parts; .*dataset\.split=frame"):
        run("task=simulate", *where)
    assert run("task=simulate", *where, "dataset.split=frame") == 0


def test_too_few_sites_and_too_small_a_fan_are_refused_before_anything_is_written(folder: Path, tmp_path: Path) -> None:
    made = bare(folder, tmp_path)
    one_site = tmp_path / "one"
    shutil.copytree(made, one_site)
    for path in list(one_site.glob("*/*.png")):
        path.rename(path.with_name("p_" + path.stem.rpartition("_")[2] + ".png"))
    where = [*TINY, f"runs_dir={tmp_path / 'runs'}", "scene=pairs", "variant=sa2h-att"]
    with pytest.raises(ConfigurationError, match=r"1 sites cannot be split into train, validation and test"):
        run("task=simulate", *where, f"scene.folder={one_site}")
    for path in made.glob("*/*.png"):
        imsave(path, np.ones((40, 40), np.uint8), check_contrast=False)
    with pytest.raises(ConfigurationError, match=r"no patch of 48 x 48 px lies wholly inside"):
        run("task=simulate", *where, f"scene.folder={made}")
    assert not (tmp_path / "runs" / "data").exists()
