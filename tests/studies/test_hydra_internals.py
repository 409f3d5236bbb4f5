"""What is used of Hydra beyond its documented interface is as it was; a release that changes it fails here by name."""

import importlib
import inspect
from pathlib import Path

import pytest
from hydra import compose
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf

from ablate.jobs.hydra_internals import ComposedConfigLoader, composing, parse_arguments, product, search_path
from ablate.jobs.hydra_internals import parse_overrides as parse
from ablate.jobs.schema import register
from ablate.settings.conf_folder import configuration_dir

# Parameters of each, in their order.
SIGNATURES = {
    "hydra._internal.callbacks.Callbacks": ["config"],
    "hydra._internal.callbacks.Callbacks.on_run_start": ["self", "config", "kwargs"],
    "hydra._internal.callbacks.Callbacks.on_run_end": ["self", "config", "kwargs"],
    "hydra._internal.callbacks.Callbacks.on_multirun_start": ["self", "config", "kwargs"],
    "hydra._internal.callbacks.Callbacks.on_multirun_end": ["self", "config", "kwargs"],
    "hydra._internal.config_loader_impl.ConfigLoaderImpl": ["config_search_path"],
    "hydra._internal.config_loader_impl.ConfigLoaderImpl.load_sweep_config": [
        "self",
        "master_config",
        "sweep_overrides",
    ],
    "hydra._internal.core_plugins.basic_sweeper.BasicSweeper.split_arguments": ["overrides", "max_batch_size"],
    "hydra._internal.utils.get_args_parser": [],
    "hydra.core.global_hydra.GlobalHydra.config_loader": ["self"],
    "hydra.core.override_parser.overrides_parser.OverridesParser.create": ["config_loader"],
    "hydra.core.override_parser.overrides_parser.OverridesParser.parse_overrides": ["self", "overrides"],
    "hydra.core.plugins.Plugins.instantiate_launcher": ["self", "hydra_context", "task_function", "config"],
    "hydra.core.plugins.Plugins.is_in_toplevel_plugins_module": ["clazz"],
    "hydra.core.singleton.Singleton.get_state": [],
    "hydra.core.utils.configure_log": ["log_config", "verbose_config"],
    "hydra.core.utils.run_job": [
        "task_function",
        "config",
        "job_dir_key",
        "job_subdir_key",
        "hydra_context",
        "configure_logging",
    ],
    "hydra.plugins.launcher.Launcher.launch": ["self", "job_overrides", "initial_job_idx"],
    "hydra.plugins.launcher.Launcher.setup": ["self", "hydra_context", "task_function", "config"],
    "hydra.types.HydraContext": ["config_loader", "callbacks"],
    # Of the plugin that `QueueLauncher` is derived from.
    "hydra_plugins.hydra_submitit_launcher.submitit_launcher.SlurmLauncher.__call__": [
        "self",
        "sweep_overrides",
        "job_dir_key",
        "job_num",
        "job_id",
        "singleton_state",
    ],
    "hydra_plugins.hydra_submitit_launcher.submitit_launcher.SlurmLauncher.launch": [
        "self",
        "job_overrides",
        "initial_job_idx",
    ],
}


def found(name: str) -> object:
    """What a dotted name stands for: a function, a class or a method of one."""
    parts = name.split(".")
    for k in range(len(parts) - 1, 0, -1):
        try:
            value: object = importlib.import_module(".".join(parts[:k]))
        except ModuleNotFoundError:
            continue
        for part in parts[k:]:
            value = getattr(value, part)
        return value
    raise ModuleNotFoundError(name)


@pytest.mark.parametrize("name", SIGNATURES)
def test_a_part_of_hydra_takes_what_it_took(name: str) -> None:
    parameters = list(inspect.signature(found(name)).parameters)  # type: ignore[arg-type]
    assert parameters == SIGNATURES[name]


def test_flags_may_stand_anywhere() -> None:
    parsed = parse_arguments(["seed=0,1", "-m", "variant=sa2h"])
    assert parsed.multirun
    assert parsed.overrides == ["seed=0,1", "variant=sa2h"]
    names = ("help", "hydra_help", "cfg", "info", "shell_completion", "config_path", "config_name", "config_dir")
    assert {getattr(parsed, name) for name in names} == {None, False}


def test_the_last_key_of_a_sweep_runs_fastest() -> None:
    assert product(parse(["a=1,2", "+b=x", "seed=range(2)"])) == [
        ["a=1", "+b=x", "seed=0"],
        ["a=1", "+b=x", "seed=1"],
        ["a=2", "+b=x", "seed=0"],
        ["a=2", "+b=x", "seed=1"],
    ]


def test_a_launcher_is_given_what_was_composed(tmp_path: Path) -> None:
    """The configuration that a launcher asks for equals the one that Hydra's own loader composes for the job."""
    register()
    overrides = ["variant=nsa2h", "seed=3", f"runs_dir={tmp_path}"]
    with composing(configuration_dir()):
        master = compose("config", [f"runs_dir={tmp_path}"], return_hydra_config=True)
        config = compose("config", overrides, return_hydra_config=True)
        theirs = GlobalHydra.instance().config_loader().load_sweep_config(master, overrides)
        loader = ComposedConfigLoader(search_path(), {tuple(overrides): config})
    ours = loader.load_sweep_config(master, overrides)
    assert OmegaConf.to_container(ours) == OmegaConf.to_container(theirs)
    assert OmegaConf.get_type(ours, "hydra") is OmegaConf.get_type(theirs, "hydra")
    assert ours.hydra.sweep.dir == f"{tmp_path}/.hydra"
