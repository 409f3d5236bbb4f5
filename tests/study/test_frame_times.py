"""Times a frame: of one moment and one machine in a column, and a difference within their spread is none."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest

from ablate.analysis import comparison_table, pareto_front
from ablate.storage import digest, read_json, write_json
from ablate.study import frame_times
from ablate.study.frame_times import TIMES, network_of, read_times, time_networks, timed_on
from ablate.study.reading import scored_frames
from ablate.study.run import Run
from ablate.study.scores import ScoreKey, by_metric, write_score
from ablate.study.training import Training, trainings_in
from support.finished_runs import PARAMETERS, PIXELS, scores_of, timed, write_training

if TYPE_CHECKING:
    from support.studies import TinyStudy


def semantic(width: float, seed: int = 0, anatomy: int = 0) -> dict[str, Any]:
    training = {"precision": "fp32", "seed": seed, "steps": 9 + seed}
    return {
        "model": {"width": width, "family": "local"},
        "encoding": {"order": "properties"},
        "training": training,
        "data": {"scene": {"anatomy_seed": anatomy}, "frames": 3},
        "seed": seed,
    }


def write_run(study: Path, label: str, width: float, seed: int = 0, checkpoint: bool = True, **model: str) -> None:
    """A finished training whose own file has a time that nobody should believe."""
    content = semantic(width, seed)
    content["model"] |= model
    scalars = {"ms_per_frame": 666.0, **PARAMETERS}
    training = write_training(study, label, content, scalars=scalars)
    key = ScoreKey("mae", "v2", 3, PIXELS)
    write_score(training.scores, key, by_metric(scores_of({"mae": 9.0}, frames=2), [key])[key])
    if checkpoint:
        training.checkpoint.write_text("weights")


def runs_of(study: Path) -> list[Run]:
    """Every finished training of a folder with all of its scores."""
    trainings = sorted((one for one in trainings_in(study) if one.is_trained), key=lambda one: (one.label, one.seed))
    return [Run(one, one.label, {}, tuple(path.name for path in one.score_files())) for one in trainings]


def change_identity(run: Run, pairs: str = "", settings: dict[str, Any] | None = None, **parts: Any) -> None:
    """Another identity of a training, at its new address."""
    about = read_json(run.training.folder / "training.json")
    identity = about["identity"]
    for part, values in parts.items():
        identity[part] |= values
    about |= {"identity": identity, "hash": digest(identity), "data": pairs or about["data"]}
    about["settings"]["model"] |= settings or {}
    write_json(run.training.folder / "training.json", about)
    folder = run.training.folder
    folder.rename(folder.with_name(f"{run.label}-seed{run.seed}-{about['hash'][:8]}"))


@pytest.fixture
def study(tmp_path: Path) -> Path:
    folder = tmp_path / "a_study"
    for label, width in (("sa2h", 1.0), ("nsa2h", 2.0)):
        for seed in (0, 1):
            write_run(folder, label, width, seed)
    return folder


def times_of(study: Path) -> dict[str, float]:
    _, scalars = scored_frames(runs_of(study))
    rows = scalars[scalars["metric"] == "ms_per_frame"]
    return {f"{r['variant']}/seed{r['seed']}": r["value"] for r in rows.to_dict("records")}


def test_seeds_and_anatomies_share_a_network_and_widths_precisions_and_encodings_do_not() -> None:
    assert network_of(semantic(1.0)) == network_of(semantic(1.0, seed=4, anatomy=2))
    others = {"training": {"precision": "bf16"}}, {"encoding": {"order": "arbitrary"}}
    for other in (semantic(2.0), *(semantic(1.0) | changed for changed in others)):
        assert network_of(semantic(1.0)) != network_of(other)


def test_all_seeds_have_the_median_of_their_network(study: Path) -> None:
    first, second = (network_of(semantic(width)) for width in (1.0, 2.0))
    times = pd.concat([timed("a machine", first, 9, 10, 30), timed("a machine", second, 5)])
    times.to_csv(study / TIMES, index=False)
    assert times_of(study) == {"sa2h/seed0": 10, "sa2h/seed1": 10, "nsa2h/seed0": 5, "nsa2h/seed1": 5}


def test_times_of_two_machines_are_never_in_one_column(study: Path) -> None:
    write_run(study, "lsa2h", 3.0)
    first, second, third = (network_of(semantic(width)) for width in (1.0, 2.0, 3.0))
    old, new = (timed("old", first, 1), timed("old", third, 3)), (timed("new", first, 10), timed("new", second, 20))
    pd.concat([*old, *new]).to_csv(study / TIMES, index=False)
    assert timed_on(runs_of(study)) == "new"
    assert times_of(study) == {"sa2h/seed0": 10, "sa2h/seed1": 10, "nsa2h/seed0": 20, "nsa2h/seed1": 20}


@pytest.mark.parametrize("damage", [None, "", "machine,ms\n", "machine,network,round,part,ms\na,b,c,d,e\n"])
def test_without_a_whole_file_there_are_no_times_not_even_those_of_the_runs(study: Path, damage: str | None) -> None:
    if damage is not None:
        (study / "frame_times.csv").write_text(damage)
    assert times_of(study) == {}


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> list[set[str]]:
    """Which runs were timed at each call, in place of timing them."""
    calls: list[set[str]] = []

    def in_turns(runs: dict[str, Run], *_: object) -> pd.DataFrame:
        calls.append({run.name for run in runs.values()})
        return pd.concat([timed("", network, 10.0 * len(calls)) for network in runs])

    class Settings:
        class training:
            device, threads = "cpu", 1

    monkeypatch.setattr(frame_times, "_in_turns", in_turns)
    monkeypatch.setattr(Training, "settings", Settings)
    return calls


def test_what_is_unchanged_is_not_timed_again(study: Path, measured: list[set[str]]) -> None:
    for _ in range(2):
        assert time_networks(study, runs_of(study)) == ""
    assert measured == [{"sa2h/seed0", "nsa2h/seed0"}], "one run a network, once"


def test_a_new_network_is_timed_together_with_all_others(study: Path, measured: list[set[str]]) -> None:
    time_networks(study, runs_of(study))
    write_run(study, "lsa2h", 3.0)
    time_networks(study, runs_of(study))
    assert measured[1] == {"sa2h/seed0", "nsa2h/seed0", "lsa2h/seed0"}
    assert set(times_of(study).values()) == {20.0}


def test_times_of_two_moments_are_never_in_one_column(study: Path, measured: list[set[str]], tmp_path: Path) -> None:
    time_networks(study, runs_of(study))
    moved = sorted(study.glob("nsa2h-*"))
    for folder in moved:
        folder.rename(tmp_path / folder.name)
    write_run(study, "lsa2h", 3.0)
    time_networks(study, runs_of(study))
    for folder in moved:
        (tmp_path / folder.name).rename(folder)
    time_networks(study, runs_of(study))
    assert len(measured) == 3
    assert set(times_of(study).values()) == {30.0}


def test_another_machine_is_timed_anew_and_the_old_one_kept(
    study: Path, measured: list[set[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    time_networks(study, runs_of(study))
    monkeypatch.setattr(frame_times, "hardware", lambda: "another machine")
    time_networks(study, runs_of(study))
    assert len(measured) == 2
    assert read_times(study)["machine"].nunique() == 2
    assert "another machine" in timed_on(runs_of(study))
    assert set(times_of(study).values()) == {20.0}


def test_without_a_checkpoint_a_network_is_timed_as_a_training_starts_it(study: Path, measured: list[set[str]]) -> None:
    write_run(study, "lsa2h", 3.0, checkpoint=False)
    assert time_networks(study, runs_of(study)) == ""
    assert measured == [{"sa2h/seed0", "nsa2h/seed0", "lsa2h/seed0"}]


def test_kept_results_are_timed_where_their_pairs_are_made_again(tiny_study: TinyStudy, tmp_path: Path) -> None:
    folder = tmp_path / "tiny-fetal"
    shutil.copytree(tiny_study.runs / folder.name, folder, ignore=shutil.ignore_patterns("*.ckpt", "frame_times.csv"))
    assert "Times were not measured" in time_networks(folder, runs_of(folder))
    (tmp_path / "data").symlink_to(tiny_study.runs / "data")
    assert time_networks(folder, runs_of(folder)) == ""
    here, there = read_times(folder), read_times(tiny_study.runs / folder.name)
    timed_there = ["machine", "network", "round", "part"]
    pd.testing.assert_frame_equal(here[timed_there], there[timed_there])


def test_each_network_is_timed_with_maps_of_its_own_pairs(
    tiny_study: TinyStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = tmp_path / "tiny-fetal"
    shutil.copytree(tiny_study.runs / study.name, study, ignore=shutil.ignore_patterns("frame_times.csv"))
    own = runs_of(study)[0].data
    for name in (own, "others"):
        shutil.copytree(tiny_study.runs / "data" / own, tmp_path / "data" / name)
    (changed,) = [run for run in runs_of(study) if run.label == "sa2h-att"]
    probe = changed.training.identity["data"]["probe"]
    frequency = probe["frequency_mhz"] + 1
    change_identity(changed, "others", data={"probe": {**probe, "frequency_mhz": frequency}})
    made: list[str] = []
    maker = frame_times._map_maker
    monkeypatch.setattr(frame_times, "_map_maker", lambda s, data: made.append(data.name) or maker(s, data))
    assert time_networks(study, runs_of(study)) == ""
    assert sorted(made) == sorted((own, "others"))
    assert read_times(study).groupby("network")["part"].agg(set).map({"segmentation", "network"}.issubset).all()


def test_a_network_has_the_time_of_its_own_maps_whoever_stands_beside_it(
    tiny_study: TinyStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = tmp_path / "tiny-fetal"
    shutil.copytree(tiny_study.runs / study.name, study, ignore=shutil.ignore_patterns("*.ckpt", "frame_times.csv"))
    (tmp_path / "data").symlink_to(tiny_study.runs / "data")
    labels = {"sa2h": {"interfaces": "echo"}, "sa2h-att": {"interfaces": "none"}}
    for run in runs_of(study):
        model = labels[run.label]
        change_identity(run, settings={"attenuation": "integral", "position": "none"} | model, model=model)
    names: list[tuple[int, tuple[str, ...]]] = []
    maker = frame_times._map_maker

    def watched(*of: object) -> object:
        make = maker(*of)
        return lambda frame, turn, read, space: names.append((turn, read)) or make(frame, turn, read, space)

    monkeypatch.setattr(frame_times, "_map_maker", watched)
    assert time_networks(study, runs_of(study)) == ""
    with_surfaces = ("segmentation", "attenuation", "interfaces", "grain")
    assert {read for _, read in names} == {with_surfaces, tuple(n for n in with_surfaces if n != "interfaces")}
    assert len({turn for turn, _ in names}) == len(names), "a pose of its own, or the simulator would remember"


def test_a_custom_network_is_timed_with_its_weights_only(study: Path, measured: list[set[str]]) -> None:
    for label, checkpoint in (("theirs", True), ("lost", False)):
        write_run(study, label, 3.0 + checkpoint, checkpoint=checkpoint, family="custom", target="my_nets.Net")
    time_networks(study, runs_of(study))
    assert measured == [{"sa2h/seed0", "nsa2h/seed0"}], "code that only a file names is not imported"
    time_networks(study, runs_of(study), {"my_nets.Net"})
    assert measured[1] == {"sa2h/seed0", "nsa2h/seed0", "theirs/seed0"}


def test_what_cannot_be_timed_is_said(study: Path) -> None:
    assert time_networks(study, runs_of(study)).startswith("Times were not measured: ")
    assert not (study / "frame_times.csv").exists()


def test_times_within_their_spread_share_the_star() -> None:
    values = [("a", 10.0, 9.0, 12.0), ("b", 12.5, 11.5, 14.0), ("c", 15.0, 14.5, 16.0)]
    scalars = pd.DataFrame(values, columns=["variant", "value", "lower", "upper"]).assign(seed=0, metric="ms_per_frame")
    per_image = pd.DataFrame({"variant": ["a"], "seed": 0, "frame": 0, "site": 0, "metric": "mae", "value": 1.0})
    table = comparison_table(per_image, scalars).set_index(["variant", "metric"]).xs("ms_per_frame", level="metric")
    assert table["best"].to_dict() == {"a": True, "b": True, "c": False}
    assert table["sd"].to_dict() == {"a": 1.5, "b": 1.25, "c": 0.75}


def test_a_front_is_not_made_by_a_difference_in_time_that_is_none() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        ms, error, half = rng.uniform(1, 9, 8), rng.integers(1, 6, 8).astype(float), rng.uniform(0, 2, 8)
        lower, upper = ms - half, ms + half
        kept = [
            i
            for i in range(8)
            if not any(error[j] < error[i] and lower[j] <= upper[i] for j in range(8))
            and not any(error[j] == error[i] and ms[j] < ms[i] for j in range(8))
        ]
        front = pareto_front(ms, error, lower, upper)
        assert sorted(front) == kept
        assert (np.diff(ms[front]) > 0).all()
        assert (np.diff(error[front]) < 0).all()
        assert list(pareto_front(ms, error, ms, ms)) == list(pareto_front(ms, error))
