"""What a comparison makes of a study that is whole, and of one that is not: words, never a traceback."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import ablate
from ablate.analysis import RESIMULATION, find_design
from ablate.evaluation import Scores
from ablate.metrics import metric_of
from ablate.settings.components import components, read_components_from
from ablate.settings.study import ConfigurationError
from ablate.storage import digest, read_json, write_json
from ablate.study.comparable import comparable_runs, levels_of, with_earlier
from ablate.study.compare import compare_study, on_screen, write_comparison
from ablate.study.frame_times import TIMES, network_of, timed_on
from ablate.study.opened import Study
from ablate.study.reading import pictures
from ablate.study.run import Run, RunList, read_list, write_list
from ablate.study.scores import ScoreKey, by_metric, read_score, write_score
from ablate.study.training import Training
from support.finished_runs import PIXELS, timed, write_training
from support.studies import TinyStudy, Unrendered, study_group

MODEL = {"family": "local", "attenuation": "integral", "concat": "every_level", "upsampling": "texture"}
MODEL |= {"noise": "inject", "depth": 4, "extra_input": "none", "width": 0.25}
VARIANTS = {
    "sa2h": {},
    "sa2h-att": {"attenuation": "none"},
    "sa2h-conv": {"upsampling": "transposed"},
    "nsa2h": {"family": "unet", "extra_input": "noise"},
}
FRAMES, SITES = 24, 8
FACTORS = [component.key for component in components()]
METRICS = ("psnr", "mae", "pchi2", str(components()[0].metric))  # the last one is what `att` is judged by
SCALARS = {"test/fd_speckle_lower": 2.0, "test/floor_fd_speckle": 0.1, "test/floor_psnr": 22.0}


def write_run(study: Path, label: str, seed: int, data: str = "fetal-0", frames: int = FRAMES, anatomy: int = 0) -> Run:
    """A finished training without the training, its scores, and its place in the list of the study."""
    rng = np.random.default_rng([seed, *label.encode()])
    identity = {
        "model": MODEL | VARIANTS.get(label.partition(".")[0], {}),
        "encoding": {"order": "arbitrary" if ".encoding" in label else "echogenicity"},
        "data": {"scene": {"anatomy_seed": anatomy}, "dataset": {"frames": frames}},
        "training": {
            "steps": 9,
            "seed": seed,
            "loss": "none" if label.startswith("sa2h-gan") else "nonsaturating",
            "precision": "fp32",
        },
        "seed": seed,
    }
    sizes = {"parameters_generator": 1e6, "parameters_discriminator": 2e6}
    notes = ["FID: no Inception weights were given."]
    training = write_training(study, label, identity, data, scalars=sizes, notes=notes)
    rows = [
        {"frame": f, "site": f % SITES, "metric": m, "source": source, "split": split, "value": 20 + k + rng.normal()}
        for k, m in enumerate(METRICS)
        for source in ("model", "resimulation")
        for split in ("test", "validation")
        for f in range(frames)
    ]
    scalars = {"test/fd_speckle": 3.0 + seed, "test/fd_speckle_upper": 5.0 + seed, "test/psnr": 20 + rng.normal()}
    keys = [ScoreKey(metric, "v2", 3, PIXELS) for metric in (*METRICS, "fd_speckle")]
    for key, score in by_metric(Scores(pd.DataFrame(rows), SCALARS | scalars), keys).items():
        write_score(training.scores, key, score)
    run = Run(training, label, {}, tuple(key.file_name for key in keys))
    listed(study, *(one for one in read_list(study).runs if one.name != run.name), run)
    return run


def listed(study: Path, *runs: Run, reference: str = "sa2h") -> RunList:
    """The list of a study, kept in its folder as a comparison keeps it."""
    (study / "comparison").mkdir(exist_ok=True)
    asked = RunList(study, runs, (), reference)
    write_list(study / "comparison", asked)
    return asked


def run_in(study: Path, label: str, seed: int) -> Run:
    (run,) = [run for run in read_list(study).runs if run.name == f"{label}/seed{seed}"]
    return run


@pytest.fixture(autouse=True)
def undrawn(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """No figure is drawn but where a test asks for them, and then none is rendered: tests/analysis looks at them."""
    if "figures" not in request.fixturenames:
        monkeypatch.setattr("ablate.study.compare.draw_figures", lambda *_: [])


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ablate.analysis.figures.style.Figure", Unrendered)


@pytest.fixture
def study(tmp_path: Path) -> Path:
    folder = tmp_path / "quick-fetal"
    for label in VARIANTS:
        for seed in (0, 1, 2):
            write_run(folder, label, seed)
    networks = {run.label: network_of(run.training.identity) for run in read_list(folder).runs}
    times = [timed("a machine", networks[label], k + 9.0, k + 10.0, k + 11.0) for k, label in enumerate(VARIANTS)]
    pd.concat(times).to_csv(folder / TIMES, index=False)
    return folder


def compared(study: Path, reference: str = "sa2h") -> tuple[Path, str, str]:
    """Folder of the comparison, its report, and its notes as one text."""
    asked = replace(read_list(study), reference=reference)
    notes = write_comparison(Study(asked, comparable_runs(asked)), "a study")
    return study / "comparison", (study / "comparison" / "report.html").read_text(), "\n".join(notes)


def change(run: Run, **values: object) -> None:
    """Other values in a trained.json."""
    path = run.training.folder / "trained.json"
    write_json(path, read_json(path) | values)


def score_file(run: Run, metric: str) -> Path:
    (name,) = [name for name in run.score_names if name.startswith(f"{metric}@")]
    return run.training.scores / name


def set_values(run: Run, metric: str, where: Callable[[pd.DataFrame], pd.Series], value: float) -> None:
    """Other values of the model in a score."""
    change_score(run, metric, lambda t: t.assign(value=t["value"].mask((t["source"] == "model") & where(t), value)))


def change_score(run: Run, metric: str, to: Callable[[pd.DataFrame], pd.DataFrame]) -> None:
    """Another table in a score."""
    score = read_score(score_file(run, metric))
    write_score(run.training.scores, ScoreKey(metric, "v2", 3, PIXELS), replace(score, values=to(score.values)))


@pytest.mark.usefixtures("figures")
def test_a_whole_study_gives_every_table_and_figure(study: Path) -> None:
    folder, report, notes = compared(study)
    names = {path.name for path in folder.iterdir()}
    assert names >= {"report.html", "table.csv", "table.tex", "paired.csv", "claims.csv", "effects.csv"}
    assert names >= {"verdicts.csv", "runs.csv"}
    figures = {"verdicts", "boxplots", "error_vs_runtime", *(f"boxplot_{m}" for m in METRICS)}
    assert names >= {f"{name}.{kind}" for name in figures for kind in ("png", "pdf")}
    assert not (study / "comparison.partial").exists()
    table = pd.read_csv(folder / "table.csv").set_index("variant")
    assert list(table.index) == [RESIMULATION, "sa2h", "nsa2h", "sa2h-att", "sa2h-conv"]
    assert table.loc["sa2h", "fd_speckle_mean"] == 4.0
    assert (table.loc["sa2h", "fd_speckle_lower"], table.loc["sa2h", "fd_speckle_upper"]) == (2.0, 6.0)
    assert "fd_speckle_lower_mean" not in table, "a bound is no metric"
    runs = pd.read_csv(folder / "runs.csv").set_index("variant")
    assert set(runs.loc["sa2h-att", "model.attenuation"]) == {"none"}
    for name, ms in (("ms_per_frame", 10.0), ("ms_per_frame_lower", 9.5), ("ms_per_frame_upper", 10.5)):
        assert set(runs.loc["sa2h", name]) == {ms}
    assert table.loc["sa2h", "ms_per_frame_sd"] == 0.5
    assert set(pd.read_csv(folder / "effects.csv")["effect"]) == {"model.attenuation", "model.upsampling"}
    claims = pd.read_csv(folder / "claims.csv")
    assert set(claims["metric"]) == {*METRICS, "fd_speckle"}
    assert set(claims["seeds"]) == {3}
    assert "one change at a time around sa2h" in report
    assert report.count("FID: no Inception weights were given.") == 1
    assert "There are no pictures: the runs kept no frame in common." in notes


def test_an_opened_study_is_tables_and_says_nothing_of_what_a_network_of_the_user_lacks(
    study: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = {"family": "custom", "concat": "input", "upsampling": "transposed", "noise": "none"}
    monkeypatch.setitem(VARIANTS, "Mine", own)
    write_run(study, "Mine", 0)
    opened = ablate.open_study(study)
    assert len(opened.runs) == 3 * (len(VARIANTS) - 1) + 1
    runs = opened.runs.set_index(["variant", "seed"])
    assert runs.loc[("Mine", 0), ["model.concat", "model.upsampling", "model.depth"]].isna().all()
    assert list(runs.loc[("Mine", 0), ["model.attenuation", "model.noise"]]) == ["integral", "none"]
    assert list(runs.loc[("sa2h", 0), ["model.concat", "model.depth"]]) == ["every_level", 4]
    frames = opened.per_image.query("variant == 'sa2h' and seed == 0 and metric == 'psnr'")["value"]
    assert runs.loc[("sa2h", 0), "psnr"] == pytest.approx(frames.mean())
    again = opened.per_image.query(f"variant == '{RESIMULATION}' and metric == 'psnr'")["value"]
    assert opened.floor.loc["psnr", "mean"] == pytest.approx(again.mean())
    assert set(opened.verdicts["component"]) == {"att", "conv", "noise"}, (
        "no rows of components that the study does not have"
    )
    with pytest.raises(FileNotFoundError, match="There is no finished study at nowhere"):
        ablate.open_study("nowhere")


def test_runs_without_a_discriminator_tell_its_effect_and_leave_the_others(study: Path) -> None:
    before = pd.read_csv(compared(study)[0] / "effects.csv").set_index(["metric", "effect"])
    for seed in (0, 1, 2):
        write_run(study, "sa2h-gan", seed)
    folder, _, _ = compared(study)
    assert "sa2h-gan" in set(pd.read_csv(folder / "paired.csv")["variant"])
    after = pd.read_csv(folder / "effects.csv").set_index(["metric", "effect"])
    assert set(after.index.unique("effect")) - set(before.index.unique("effect")) == {"training.loss"}
    pd.testing.assert_series_equal(after["estimate"].loc[before.index], before["estimate"])
    assert (after["dof"].loc[before.index] == before["dof"] + 2).all()


def test_pictures_of_frames_that_there_are_not_are_said_to_be_missing(
    tiny_study: TinyStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    listed_runs = read_list(tiny_study.runs / "tiny-fetal")
    np.savez(tmp_path / "pictures.npz", frames=[10**6], images=np.zeros((1, 96, 134), np.uint8))
    monkeypatch.setattr(Training, "pictures_file", tmp_path / "pictures.npz")
    kept = Study(replace(listed_runs, folder=tmp_path), comparable_runs(listed_runs))
    assert "There are no pictures: " in " ".join(write_comparison(kept, "a study"))


def test_pictures_without_their_pairs_are_said_to_be_missing(study: Path) -> None:
    for run in read_list(study).runs:
        np.savez(run.training.pictures_file, frames=[3], images=np.zeros((1, 40, 60), np.uint8))
    _, report, notes = compared(study)
    assert "There are no pictures: no data set at" in notes
    assert "no data set at" in report


@pytest.mark.usefixtures("figures")
def test_one_variant(tmp_path: Path) -> None:
    alone = tmp_path / "alone"
    write_run(alone, "sa2h", 0)
    folder, report, notes = compared(alone)
    assert "There is one variant, sa2h: nothing is compared." in notes
    assert "nothing is compared" in report
    assert "not claimable" in report
    assert pd.read_csv(folder / "table.csv").shape[0] == 2, "what there is, is shown"
    assert not (folder / "boxplots.png").exists()


@pytest.mark.usefixtures("figures")
def test_a_missing_reference(study: Path) -> None:
    folder, report, notes = compared(study, reference="lsa2h")
    assert "The reference lsa2h is missing" in notes
    assert "The reference lsa2h is missing" in report
    assert (folder / "table.tex").exists()
    assert not (folder / "boxplots.png").exists()
    assert pd.read_csv(folder / "paired.csv").empty


def test_another_anatomy_is_a_block_of_effects_and_no_part_of_any_pair(study: Path) -> None:
    folder, _, _ = compared(study)
    alone = {name: (folder / name).read_text() for name in ("table.csv", "paired.csv", "claims.csv")}
    effects = pd.read_csv(folder / "effects.csv")
    for label in ("sa2h", "sa2h-att", "sa2h-conv"):
        for seed in (3, 4):
            run = write_run(study, label, seed, data="fetal-1", anatomy=1)
            set_values(run, "psnr", lambda t: t["frame"] >= 0, 1000.0 - 5 * (label == "sa2h-att"))
    folder, report, _ = compared(study)
    assert {name: (folder / name).read_text() for name in alone} == alone
    assert (
        "6 runs on another anatomy or data set than fetal-0 take part in effects and verdicts only: sa2h/seed3,"
        in report
    )
    together = pd.read_csv(folder / "effects.csv")
    assert (together["dof"] == effects["dof"] + 6 - 1).all(), "six more runs and one more block"
    shift = together.set_index(["metric", "effect"])["estimate"]["psnr", "model.attenuation"]
    alone_shift = effects.set_index(["metric", "effect"])["estimate"]["psnr", "model.attenuation"]
    # Two differences of two means, over 3 + 3 and over 2 + 2 runs; 900 dB between anatomies are in neither.
    assert shift == pytest.approx((3 * alone_shift + 2 * -5) / 5)


def test_cautions_notes_and_times_are_of_all_runs_that_verdicts_use(study: Path) -> None:
    blocks = [
        write_run(study, label, seed, data="fetal-1", anatomy=1) for label in ("sa2h", "sa2h-att") for seed in (3, 4)
    ]
    set_values(blocks[0], METRICS[-1], lambda t: t["frame"] == 5, np.nan)
    for metric in METRICS:
        change_score(blocks[1], metric, lambda table: table[table["frame"] < 20])
    change(blocks[0], notes=["3 % of the pixels were clipped."])
    times = pd.read_csv(study / TIMES)
    other = write_run(study, "sa2h.encoding-arbitrary", 3, data="fetal-1", anatomy=1)
    more = timed("a machine", network_of(other.training.identity), 5.0, 6.0, 7.0)
    later = times.assign(machine="a later machine", ms=99.0)  # of all networks but that of the block
    pd.concat([times, more, later]).to_csv(study / TIMES, index=False)
    folder, report, notes = compared(study)
    for text in (notes, report):
        assert "1 NaN left out (sa2h/seed3 frame 5)" in text
        assert "sa2h/seed4 (20 of 24)" in text
    assert "3 % of the pixels were clipped." in report
    runs = pd.read_csv(folder / "runs.csv").set_index(["variant", "seed"])
    shared = run_in(study, "sa2h", 4).scores.query("split == 'test' and source == 'model'")
    shared = shared[(shared["metric"] == METRICS[-1]) & (shared["frame"] != 5)]
    assert runs.loc[("sa2h", 4), METRICS[-1]] == pytest.approx(shared["value"].mean())
    opened = ablate.open_study(study)
    assert timed_on(opened.usable.all) == "a machine"
    assert opened.results.scalars.query("metric == 'ms_per_frame'")["value"].max() < 99, (
        "times are of the machine that is named"
    )
    assert set(opened.per_image["data"]) == {"fetal-0"}
    assert set(opened.results.blocks["data"]) == {"fetal-1"}


def test_runs_of_different_data_sets(study: Path) -> None:
    shutil.rmtree(run_in(study, "nsa2h", 1).training.folder)
    write_run(study, "nsa2h", 1, data="fetal-1", frames=10, anatomy=1)
    write_run(study, "sa2h-att.encoding-arbitrary", 0, data="fetal-2", frames=12)
    folder, report, notes = compared(study)
    note = "2 runs left aside, made from other pairs than fetal-0: nsa2h/seed1, sa2h-att.encoding-arbitrary/seed0."
    assert note in notes
    assert note in report
    table = pd.read_csv(folder / "table.csv").set_index("variant")
    assert table.loc["nsa2h", "seeds"] == 2
    assert "sa2h-att.encoding-arbitrary" not in table.index
    assert "nsa2h (2)" in notes, "which leaves it too few seeds"


def replace_in_about(run: Run, **parts: object) -> None:
    """Other parts in a training.json."""
    path = run.training.folder / "training.json"
    write_json(path, read_json(path) | parts)


def write_about(text: str) -> Callable[[Run], object]:
    return lambda run: (run.training.folder / "training.json").write_text(text)


def write_scores(content: bytes) -> Callable[[Run], object]:
    return lambda run: score_file(run, "mae").write_bytes(content)


def model_of(run: Run, **model: object) -> dict[str, object]:
    """An identity with other values of the model, which its hash does not know of."""
    identity = run.training.identity
    return identity | {"model": identity["model"] | model}


DAMAGED = "with a training.json that is damaged, or not what its hash says"
UNUSABLE: dict[str, tuple[Callable[[Run], object], str]] = {
    "scores are not Parquet": (write_scores(b"no"), "without all of its scores"),
    "scores are missing": (lambda run: score_file(run, "mae").unlink(), "without all of its scores"),
    "an unfinished training": (lambda run: (run.training.folder / "trained.json").unlink(), "not finished"),
    "a damaged result": (
        lambda run: (run.training.folder / "trained.json").write_text("{"),
        "without a usable pixels, scalars, notes, started, ended in trained.json: start it again",
    ),
    "a result without a number": (lambda run: change(run, scalars={"seconds": "1"}), "without a usable scalars in "),
    "a result without parameters": (lambda run: change(run, scalars={}), "without a usable scalars.parameters_gen"),
    "an empty file": (write_about(""), DAMAGED),
    "without a hash": (write_about("{}"), DAMAGED),
    "changes that are no mapping": (lambda run: replace_in_about(run, changed="ab"), DAMAGED),
    "settings that are a number": (lambda run: replace_in_about(run, settings=5), DAMAGED),
    "not what its hash says": (lambda run: replace_in_about(run, identity=model_of(run, depth=3)), DAMAGED),
    "another seed than its folder": (lambda run: replace_in_about(run, seed=7), "in a folder that was renamed"),
}


@pytest.mark.parametrize("damage", UNUSABLE)
def test_a_run_that_cannot_be_used_is_left_aside_in_words(study: Path, damage: str) -> None:
    harm, why = UNUSABLE[damage]
    run = run_in(study, "nsa2h", 0)
    harm(run)
    usable = comparable_runs(read_list(study))
    (note,) = usable.notes
    assert note.startswith(f"1 run not finished: {run.training.folder.name} ({why}")
    assert len(usable.runs) == len(VARIANTS) * 3 - 1


def test_scores_that_hold_another_metric_are_refused_by_name(study: Path) -> None:
    run = run_in(study, "nsa2h", 0)
    change_score(run, "mae", lambda table: table.assign(metric="x/../../../stolen"))
    with pytest.raises(ValueError, match=r"mae@v2.*parquet: holds values of 'x/"):
        assert run_in(study, "nsa2h", 0).scores.empty


@pytest.mark.usefixtures("figures")
def test_a_metric_that_is_nan_for_one_frame_or_for_all(study: Path) -> None:
    set_values(run_in(study, "nsa2h", 0), "mae", lambda t: (t["frame"] == 5) & (t["split"] == "test"), np.nan)
    for seed in (0, 1, 2):
        set_values(run_in(study, "sa2h-att", seed), "pchi2", lambda t: t["frame"] >= 0, np.nan)
    folder, report, notes = compared(study)
    assert "MAE: 1 NaN left out (nsa2h/seed0 frame 5)." in notes
    paired = pd.read_csv(folder / "paired.csv").set_index(["variant", "metric"])
    assert paired.loc[("nsa2h", "mae"), "n"] == FRAMES - 1
    assert ("sa2h-att", "pchi2") not in paired.index
    assert "±\u00a0nan" not in report
    assert "–" in report
    assert (folder / "boxplot_pchi2.png").exists()
    assert "72 NaNs left out" in report


def test_a_comparison_is_kept_until_what_it_is_made_from_changes(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A training that was deleted and done again has the same hash."""
    asked = read_list(study)

    def again() -> int:
        """When the table was written, after the same runs were compared again."""
        compare_study(RunList(study, tuple(run_in(study, r.label, r.seed) for r in asked.runs), (), "sa2h"), "a study")
        return (study / "comparison" / "table.csv").stat().st_mtime_ns

    before = again()
    assert again() == before
    other_band = tuple(replace(component, band=1.0) for component in components())
    for changed, to in (("reading.components", other_band), ("compare.loaded_digest", "x")):  # or other statistics
        monkeypatch.setattr(f"ablate.study.{changed}", lambda *_, to=to: to)
        later = again()
        assert later > before, changed
        before = later
    set_values(run_in(study, "nsa2h", 0), "psnr", lambda t: t["frame"] >= 0, 90.0)
    assert again() > before
    table = study / "comparison" / "table.csv"
    assert 43 < pd.read_csv(table).set_index("variant").loc["nsa2h", "psnr_mean"] < 44
    (study / "comparison" / "made_from.json").write_text("")
    table.unlink()
    again()
    assert table.exists()
    (study / "comparison" / "report.html").unlink()
    again()
    assert (study / "comparison" / "report.html").exists()


def test_a_band_that_is_edited_while_a_study_is_compared_counts_for_the_next_command(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whenever it is edited: before the comparison of this process, or between its verdicts and its last file."""
    file = tmp_path / "component" / "att.yaml"
    file.parent.mkdir()

    def declare(band: float, *_: object) -> list[object]:
        lines = f"key: model.attenuation\non: integral\noff: none\nmetric: shadow_contrast\nband: {band}\n"
        file.write_text(lines)
        return []  # as draw_figures

    def band() -> float:
        compare_study(read_list(study), "a study", time_here=False)
        return pd.read_csv(study / "comparison" / "verdicts.csv").set_index("component").loc["att", "band"]

    declare(2.5)
    read_components_from([tmp_path])
    try:
        assert {one.name: one.band for one in components()}["att"] == 2.5
        declare(1.5)
        monkeypatch.setattr("ablate.study.compare.draw_figures", lambda *_: declare(0.5))
        assert band() == 1.5
        monkeypatch.setattr("ablate.study.compare.draw_figures", lambda *_: [])
        assert band() == 0.5
    finally:
        read_components_from([])


def test_a_terminal_shows_the_table_what_is_to_be_known_and_three_lines(
    study: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(study.parent)
    set_values(run_in(study, "nsa2h", 0), "mae", lambda t: t["frame"] == 5, np.nan)  # which is a note
    asked = read_list(study)
    compared_study = compare_study(asked, "a study", rebuild=True, time_here=False)
    printed = on_screen(compared_study, "make ui").splitlines()
    assert max(map(len, printed)) <= 100
    assert "MAE: " in " ".join(line for line in printed if line.startswith("Note: "))
    *_, report, look = printed
    (best,) = [k for k, line in enumerate(printed) if line.startswith("Best    ")]
    means = compared_study.study.table.query("metric == 'pchi2' and variant != @RESIMULATION").set_index("variant")
    assert printed[best].startswith(f"Best    {means['mean'].idxmin()} by pχ² ↓: {means['mean'].min():.3f} (")
    assert all(line.startswith("        ") for line in printed[best + 1 : -2])
    assert (report, look) == ("Report  quick-fetal/comparison/report.html", "Look    make ui")


def test_no_run_at_all_is_one_line_that_says_why(tmp_path: Path) -> None:
    study = tmp_path / "quick-fetal"
    with pytest.raises(ConfigurationError, match=r"quick-fetal holds no finished run to compare\.$"):
        compare_study(read_list(study), "a study")
    run = write_run(study, "sa2h", 0)
    (run.training.folder / "trained.json").unlink()
    with pytest.raises(ConfigurationError, match=r"1 run not finished: sa2h-seed0-\w+ \(not finished\)\.$"):
        compare_study(read_list(study), "a study")


def test_results_of_another_version_say_so(study: Path) -> None:
    for run in read_list(study).runs:
        identity = {**run.training.identity, "training_version": 1}
        replace_in_about(run, identity=identity, hash=digest(identity))
        run.training.folder.rename(study / f"{run.label}-seed{run.seed}-{digest(identity)[:8]}")
    trainings = [Training(path.parent) for path in sorted(study.glob("*/training.json"))]
    names = run_in_names(trainings[0])
    asked = RunList(study, tuple(Run(one, one.label, {}, names) for one in trainings), (), "sa2h")
    (note,) = comparable_runs(asked).notes
    assert note.startswith("These results are of version 1 of the training; this program has version ")


def run_in_names(training: Training) -> tuple[str, ...]:
    return tuple(path.name for path in training.score_files())


def test_runs_scored_on_other_pixels_are_left_aside(study: Path) -> None:
    run = run_in(study, "nsa2h", 2)
    names = []
    for path in run.training.score_files():
        names.append(path.name.replace(PIXELS[:8], "1" * 8))
        path.rename(path.with_name(names[-1]))
    others = [one for one in read_list(study).runs if one.name != run.name]
    asked = listed(study, *others, Run(run.training, run.label, {}, tuple(names)))
    usable = comparable_runs(asked)
    (note,) = usable.notes
    assert note.startswith("1 run left aside, scored on other pixels of the same recipe")
    assert len(usable.runs) == 3 * len(VARIANTS) - 1


def renamed_scores(run: Run, of: str, to: str) -> Run:
    """The run with scores whose names say that they were computed another way."""
    for path in run.training.score_files():
        path.rename(path.with_name(path.name.replace(of, to)))
    return Run(run.training, run.label, {}, tuple(name.replace(of, to) for name in run.score_names))


@pytest.mark.parametrize(
    ("of", "to"), [("@v2-", "@v3-"), ("mae@v2-draws3", "mae@0123abcd-draws3"), ("draws3", "draws4")]
)
def test_scores_by_two_definitions_of_a_metric_are_in_no_table_together(study: Path, of: str, to: str) -> None:
    other = renamed_scores(run_in(study, "nsa2h", 2), of, to)
    others = [one for one in read_list(study).runs if one.name != other.name]
    usable = comparable_runs(listed(study, *others, other))
    names = {name for run in usable.runs for name in run.score_names}
    assert not any(to in name for name in names)
    assert any(note.startswith("mae is computed in more than one way (v2-draws3, ") for note in usable.notes)
    assert all("left aside in nsa2h/seed2" in note for note in usable.notes if "in more than one way" in note)
    alone = RunList(study, (other,), (), "sa2h")
    listed(study, *others)
    assert with_earlier(alone) is alone, "and one job alone does not join them"


def test_a_training_and_a_name_count_once(study: Path) -> None:
    before = comparable_runs(read_list(study))
    first = before.runs[0]
    twin = Run(first.training, "the-same", {}, first.score_names)
    namesake = Run(before.runs[-1].training, first.label, {}, first.score_names)
    namesake_elsewhere = write_run(study.parent / "other", first.label, first.seed, frames=10)
    usable = comparable_runs(listed(study, *before.runs, twin, namesake, namesake_elsewhere))
    assert [run.name for run in usable.runs] == [run.name for run in before.runs]
    (note,) = usable.notes
    assert note.startswith("3 runs left aside, as a run before has the same training or the same name: the-same/seed0")
    listed(study, *before.runs)
    joined = with_earlier(RunList(study, (twin,), (), "sa2h"))
    assert [run.name for run in joined.runs] == [run.name for run in before.runs]


def test_a_run_whose_files_are_damaged_stays_in_the_list_until_it_is_replaced(study: Path) -> None:
    whole = read_list(study)
    run, last = whole.runs[0], whole.runs[-1]
    listed(study, *whole.runs[:-1])
    content = score_file(run, "mae").read_bytes()
    score_file(run, "mae").write_bytes(b"PAR1")
    joined = with_earlier(RunList(study, (last,), (), "sa2h"))
    assert [name.partition("-seed")[0] for name in joined.unfinished] == [run.label]
    write_list(study / "comparison", joined)
    score_file(run, "mae").write_bytes(content)
    assert {one.name for one in read_list(study).runs} == {one.name for one in whole.runs}
    score_file(run, "mae").write_bytes(b"PAR1")
    again = Run(Training(shutil.copytree(run.training.folder, study / "copy")), run.label, {}, run.score_names)
    replaced = with_earlier(RunList(study, (again,), (), "sa2h"))
    assert not replaced.unfinished
    assert not replaced.unread


def test_the_reference_of_a_study_stays_unless_a_command_names_another(study: Path) -> None:
    first = listed(study, *read_list(study).runs, reference="nsa2h").runs[0]
    assert with_earlier(RunList(study, (first,), (), "sa2h")).reference == "nsa2h"
    assert with_earlier(RunList(study, (first,), (), "sa2h-att")).reference == "sa2h-att"


def test_what_was_there_stays_when_a_comparison_fails(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, before, _ = compared(study)

    def broken(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr("ablate.analysis.write_report", broken)
    with pytest.raises(MemoryError):
        compared(study)
    assert (folder / "report.html").read_text() == before


@pytest.mark.parametrize(
    ("group", "name"),
    [
        ("factorial_half", "half of the factorial of 5 components (16 of 32 cells)"),
        ("add_one_in", "one change at a time around"),
        ("encoding", "6 of the 8 cells of 3 components"),
        pytest.param("full_model", "one change at a time around sa2h (12 cells)", marks=pytest.mark.slow),
    ],
)
def test_study_groups_are_recognised_as_the_designs_they_are(group: str, name: str) -> None:
    jobs = study_group(group)
    design = find_design({job.label: levels_of(job.identity) for job in jobs}, FACTORS)
    assert design is not None
    assert design.name.startswith(name)


def test_a_start_of_noise_that_is_not_injected_and_a_seed_of_training_make_no_other_network(tmp_path: Path) -> None:
    levels = {}
    for label, noise, start in (("sa2h", "inject", 0.2), ("sa2h-noise", "input", 0.0), ("sa2h-att", "inject", 0.2)):
        run = write_run(tmp_path / "s", label, len(levels))
        levels[label] = levels_of(model_of(run, noise=noise, noise_start=start))
    design = find_design(levels, FACTORS)
    assert design is not None
    assert (design.factors, set(design.cells.index)) == (["model.attenuation", "model.noise"], set(levels))
    levels["sa2h-quiet"] = levels["sa2h"] | {"model.noise_start": 0.0}
    levels["sa2h-long"] = levels["sa2h"] | {"training.steps": 99}
    design = find_design(levels, FACTORS)
    assert design is not None
    assert set(levels) - set(design.cells.index) == {"sa2h-quiet", "sa2h-long"}


def test_a_metric_of_a_user_is_shown_by_its_name_where_no_command_names_it(study: Path) -> None:
    """Scores may come from anybody: what they name is not imported."""
    runs = []
    for run in read_list(study).runs:
        score = read_score(score_file(run, "mae"))
        key = ScoreKey("brightness", "0123abcd", 3, PIXELS)
        write_score(run.training.scores, key, replace(score, values=score.values.assign(metric="brightness")))
        runs.append(Run(run.training, run.label, {}, (*run.score_names, key.file_name)))
    listed(study, *runs)
    folder, _, _ = compared(study)
    assert "brightness_mean" in pd.read_csv(folder / "table.csv")
    assert metric_of("brightness").label == "brightness"


@pytest.mark.parametrize("name", ["pictures.npz", "provenance/made_with.json"])
def test_a_damaged_file_beside_the_scores_stops_nothing(study: Path, name: str) -> None:
    path = run_in(study, "sa2h", 0).training.folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"" if name.endswith("npz") else b"\xe9{")
    runs = comparable_runs(read_list(study)).runs
    assert len(runs) == len(VARIANTS) * 3
    assert pictures(runs) == []


def test_names_in_a_list_lead_nowhere_else(study: Path, tmp_path: Path) -> None:
    """The list may come from anybody."""
    other = write_run(tmp_path / "elsewhere", "sa2h", 9)
    content = read_json(study / "comparison" / "jobs.json")
    good = content["jobs"][0]
    for key, value in (
        ("training", f"../elsewhere/{other.training.folder.name}"),
        ("training", str(other.training.folder)),
        ("label", "../x"),
        ("scores", ["../../elsewhere/x.parquet"]),
        ("scores", []),
        ("changed", 5),
    ):
        write_json(study / "comparison" / "jobs.json", {**content, "jobs": [{**good, key: value}]})
        assert not read_list(study).runs, (key, value)
