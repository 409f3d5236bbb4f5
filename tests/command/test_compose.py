"""The command line: what it stands for, and how it is refused."""

import math
import re
from collections import Counter
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from ablate.analysis import find_design
from ablate.analysis.statistics.component_models import require_judged
from ablate.command.compose import cells, jobs_of, without_repetitions
from ablate.dataset import Encoding
from ablate.networks import Attenuation, Family
from ablate.settings.components import components
from ablate.settings.study import ConfigurationError, SceneSettings, StudySettings
from ablate.study.comparable import levels_of, untold_differences
from ablate.study.job import Job
from support.studies import study_group


def test_a_sweep_is_the_product_of_its_values() -> None:
    jobs = jobs_of(["-m", "variant=sa2h,nsa2h", "seed=0,1"])
    assert [job.name for job in jobs] == ["sa2h/seed0", "sa2h/seed1", "nsa2h/seed0", "nsa2h/seed1"]
    assert jobs[1].settings.training.seed == 1
    assert jobs[0].folder.parts[-2:] == ("quick-fetal", f"sa2h-seed0-{jobs[0].hash[:8]}")


@pytest.mark.parametrize(
    ("arguments", "label"),
    [
        (["seed=1", "training.steps=3"], "sa2h"),
        (["model.depth=8"], "sa2h.depth-8"),
        (["model.depth=${levels:8}"], "sa2h.depth-6"),
        (["model.depth=${levels:8}", "preset=paper"], "sa2h.depth-8"),
        (["model.depth=${levels:4}"], "sa2h"),
        (["model.width=0.5"], "sa2h"),
        (["model={depth:8,noise:body,width:0.5}"], "sa2h.depth-8"),
        (["model={depth:${levels:8},noise:input}"], "sa2h.depth-6.noise-input"),
        (["variant=sa2h-depth", "model.depth=6"], "sa2h-depth"),
        (["variant=sa2h-depth", "model.depth=8"], "sa2h-depth.depth-8"),
        (["encoding=arbitrary", "model.noise=none"], "sa2h.encoding-arbitrary.noise-none"),
        (["training.loss=none"], "sa2h.loss-none"),
        (["variant=custom", "model.target=my_nets.Net", "model.attenuation=none"], "Net.attenuation-none"),
        (
            ["variant=custom", "model={target:my_nets.Net,noise:input}", "training.loss=none"],
            "Net.loss-none.noise-input",
        ),
        (["variant=sa2h-gan", "training={loss:none,steps:3}"], "sa2h-gan"),
    ],
)
def test_labels_name_what_differs_from_the_variant(arguments: list[str], label: str) -> None:
    (job,) = jobs_of(arguments)
    assert job.label == label


@pytest.fixture(scope="module")
def factorial() -> list[Job]:
    return study_group("factorial")


def test_no_two_cells_of_the_factorial_share_a_place(factorial: list[Job]) -> None:
    assert len({job.folder for job in factorial}) == 32
    assert len({job.settings.model for job in factorial}) == 32


def test_the_factorial_of_a_preset_has_its_map_and_its_reference() -> None:
    jobs = jobs_of(["+study=factorial", "preset=paper"])
    assert {str(job.settings.model.attenuation) for job in jobs} == {"integral", "none"}
    assert "sa2h" in {job.label for job in jobs}


OFF = {"attenuation": "none", "concat": "input", "upsampling": "transposed", "noise": "input", "depth": 6}


def off(job: Job) -> set[str]:
    """The components that a job goes without."""
    return {name for name, value in OFF.items() if getattr(job.settings.model, name) == value}


def test_half_of_the_factorial_tells_main_effects_and_interactions_apart(factorial: list[Job]) -> None:
    whole = {job.label: job for job in factorial}
    half = study_group("factorial_half")
    assert len(half) == 16
    assert all(whole[job.label].settings == job.settings for job in half)  # so the whole can follow the half
    effects = [(name,) for name in OFF] + list(combinations(OFF, 2))
    signs = np.array([[math.prod(-1 if c in off(job) else 1 for c in effect) for effect in effects] for job in half])
    np.testing.assert_array_equal(signs.T @ signs, 16 * np.eye(len(effects)))


def test_add_one_in_starts_from_nothing() -> None:
    nothing, *others = study_group("add_one_in")
    assert off(nothing) == set(OFF)
    assert nothing.label == nothing.settings.reference
    assert [set(OFF) - off(job) for job in others] == [{name} for name in OFF]
    assert {job.settings.model.family for job in others} == {Family.local}


def of_the_design(jobs: list[Job]) -> list[Job]:
    """The jobs of a study but for those of other variants, which are beside its design."""
    return [job for job in jobs if job.settings.variant == job.settings.reference]


def test_the_study_has_each_network_equally_often_in_both_anatomies() -> None:
    jobs = of_the_design(study_group("full_model"))
    assert len(jobs) == len({job.folder for job in jobs}) == 52
    assert jobs[0].label == "sa2h"
    runs = Counter((job.label.replace(".anatomy_seed-4", ""), job.settings.scene.anatomy_seed) for job in jobs)
    assert {anatomy for _, anatomy in runs} == {3, 4}
    assert all(count == (4 if label == "sa2h" else 2) for (label, _), count in runs.items())
    assert len(runs) == 2 * (1 + len(components("full_model"))), "each component is switched off alone"
    assert not untold_differences(jobs, "sa2h")
    orders = {job.settings.label_seed for job in jobs if job.settings.encoding is Encoding.arbitrary}
    assert len(orders) == 2, "an order of the labels for each seed"


def test_the_runs_beside_the_design_take_no_part_in_it() -> None:
    jobs = study_group("full_model")
    design_jobs = of_the_design(jobs)
    assert len(jobs) == len({job.folder for job in jobs}) == len(design_jobs) + 9
    beside = Counter(job.label for job in jobs if job not in design_jobs)
    assert beside == {"nsa2h": 3, "lsa2h": 3, "sa2h-printed.crop-0.reconstruction-l1": 3}
    assert not untold_differences(jobs, "sa2h")
    factors = [*(component.key for component in components()), *(key for job in jobs for key in dict(job.changed))]
    design = find_design({job.label: levels_of(job.identity) for job in jobs}, factors)
    assert design is not None
    assert set(design.cells.index) == {job.label for job in design_jobs}
    assert len(design.factors) == len(components("full_model"))


def test_the_components_are_asked_again_at_the_papers_inputs() -> None:
    """Each level alone, equally often in both anatomies; the network on images has noise by pixel, as one beside it."""
    jobs = of_the_design(study_group("components"))
    assert len(jobs) == len({job.folder for job in jobs}) == 52
    models = [job.settings.model for job in jobs if job.settings.encoding is not Encoding.properties]
    assert {model.attenuation for model in models} == {Attenuation.integral, Attenuation.none}
    runs = Counter((re.sub(r"\.anatomy_seed-\d+", "", job.label), job.settings.scene.anatomy_seed) for job in jobs)
    assert all(count == (4 if label == "sa2h" else 2) for (label, _), count in runs.items())
    orders = {job.settings.label_seed for job in jobs if job.settings.encoding is Encoding.arbitrary}
    assert len(orders) == 4, "an order of the labels for each training"
    assert not untold_differences(study_group("components"), "sa2h")
    keys = [component.key for component in components()]
    levels = {job.label: levels_of(job.identity) for job in study_group("components")}
    design = find_design(levels, keys, components=components())
    assert design is not None
    assert set(design.cells.index) == {job.label for job in jobs}
    asked = {component.name for component in components()} - {"interfaces", "grain"}
    told = {one.name: require_judged(one, design)[2] for one in components() if one.name in asked}
    assert sorted(told.values()) == sorted(design.factors), "each factor is one component's"
    assert (told["noise"], told["lattice"]) == ("model.noise=input", "model.noise=inject")
    assert (told["encoding"], told["properties"]) == ("encoding=arbitrary", "encoding=properties")


def test_cells_of_a_study_take_more_keys() -> None:
    lines = cells({"variant": "sa2h", "cells": "seed=0 model={}\nseed=1 model={noise:input}"}, ["training.steps=2,3"])
    assert lines == [
        ["variant=sa2h", f"seed={seed}", f"model={model}", f"training.steps={steps}"]
        for seed, model in ((0, "{}"), (1, "{noise:input}"))
        for steps in (2, 3)
    ]


def test_table_2_trains_the_papers_seven_networks_as_printed() -> None:
    jobs = jobs_of(["+study=table2"])
    trained = Counter(job.settings.variant for job in jobs if job.settings.encoding is Encoding.arbitrary)
    ablated = ["sa2h-att", "sa2h-concat", "sa2h-conv", "sa2h-noise", "nsa2h", "lsa2h"]
    assert trained == {"sa2h": 5, **dict.fromkeys(ablated, 3)}
    assert len({job.hash for job in jobs}) == len(jobs) == 26
    for job in jobs:
        model, training = job.settings.model, job.settings.training
        assert (model.space, model.position, model.fold, model.interfaces) == ("image", "none", "none", "none")
        assert model.attenuation == ("none" if job.settings.variant == "sa2h-att" else "integral")
        assert "body" not in (model.noise, model.extra_input)
        assert (training.reconstruction, training.l1_weight, training.loss) == ("l1", 100, "nonsaturating")
        assert (training.batch_size, training.crop, training.learning_rate) == (4, 128, 2e-4)
        assert (training.schedule, training.ema_decay, training.snapshots) == ("constant", 0, 5)


def test_study_groups_take_seeds() -> None:
    jobs = jobs_of(["+study=leave_one_out", "seed=0,1,2"])
    assert len(jobs) == 6 * 3


def test_the_two_orders_of_the_labels_are_compared_in_a_study_of_their_own() -> None:
    jobs = study_group("encoding")
    assert {job.settings.encoding for job in jobs} == {Encoding.echogenicity, Encoding.arbitrary}
    assert {job.settings.study for job in jobs} == {"encoding"}
    assert jobs[0].settings.reference in {job.label for job in jobs}


def test_a_folder_names_its_study() -> None:
    (job,) = jobs_of(["scene=folder", "scene.folder=some/where/patient7", "preset=quick"])
    assert job.settings.study == "quick-patient7"
    (job,) = jobs_of(["study_name=mine", "runs_dir=/elsewhere"])
    assert str(job.settings.study_dir) == "/elsewhere/mine"


@pytest.mark.parametrize(
    ("folder", "study"),
    [("o'neill", "quick-o_neill"), ("what? 100%20", "quick-what_ 100_20"), (200 * "ø", "quick-" + 50 * "ø")],
)
def test_a_folder_of_any_name_gives_the_name_of_a_study(folder: str, study: str) -> None:
    assert StudySettings(preset="quick", scene=SceneSettings("folder", f"some/{folder}")).study == study


def test_a_users_variant_has_a_name_that_a_folder_can_have(tmp_path: Path) -> None:
    (tmp_path / "variant").mkdir()
    for file, variant in (("mine", "comparison"), ("other", "a/b")):
        text = f"# @package _global_\ndefaults:\n  - sa2h\nvariant: {variant}\n"
        (tmp_path / "variant" / f"{file}.yaml").write_text(text)
    path = f"hydra.searchpath=[file://{tmp_path}]"
    with pytest.raises(ConfigurationError, match=r"^variant='a/b': allowed are at most 200 letters"):
        jobs_of([path, "variant=other"])
    (mine,) = jobs_of([path, "variant=mine", f"runs_dir={tmp_path}"])
    assert mine.folder.name.startswith("comparison-seed0-"), "no folder of another"


def test_two_trainings_of_one_name_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("first_nets", "second_nets"):
        (tmp_path / f"{name}.py").write_text("class Net: ...\n")
    monkeypatch.syspath_prepend(tmp_path)
    jobs = jobs_of(["-m", "variant=custom", "model.target=first_nets.Net,second_nets.Net"])
    with pytest.raises(ConfigurationError, match=r"called Net/seed0 and differ in model\.source, model\.target"):
        without_repetitions(jobs)
    assert len(without_repetitions(jobs[:1] * 2)) == 1
