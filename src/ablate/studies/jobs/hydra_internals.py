"""All that this project uses of Hydra beyond its documented interface.

`tests/studies/test_hydra_internals.py` lists each part, and fails by its name when a new release of Hydra changes it.
"""

import argparse
import pickle
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import hydra
from hydra import compose, initialize_config_dir
from hydra._internal.callbacks import Callbacks
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra._internal.utils import get_args_parser
from hydra.core.config_search_path import ConfigSearchPath as ConfigSearchPath
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override as Override
from hydra.core.plugins import Plugins
from hydra.core.singleton import Singleton as Singleton
from hydra.core.utils import JobReturn as JobReturn
from hydra.core.utils import JobStatus as JobStatus
from hydra.core.utils import configure_log, run_job, setup_globals
from hydra.plugins.launcher import Launcher as Launcher
from hydra.types import HydraContext as HydraContext
from hydra.types import TaskFunction as TaskFunction
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf, open_dict

CONFIG = "config"
_VERSION_BASE = "1.3"
_JOBLIB = "hydra_plugins.hydra_joblib_launcher.joblib_launcher.JoblibLauncher"
_IN_PLACE_OF_JOBLIB = "ablate.studies.jobs.side_by_side.ProcessLauncher"
_QUESTIONS = ("help", "hydra_help", "cfg", "info", "shell_completion")


def parse_arguments(arguments: Sequence[str]) -> argparse.Namespace:
    """Hydra's flags and the overrides, which may stand in any order."""
    return get_args_parser().parse_intermixed_args(list(arguments))


def is_question(parsed: argparse.Namespace) -> bool:
    """Whether a command line asks Hydra something (`--help`, `--cfg job`, `--info`, ...) and starts no task."""
    return any(getattr(parsed, name) not in (None, False) for name in _QUESTIONS)


def answer(folder: Path) -> None:
    """Let Hydra answer the question in `sys.argv`."""
    hydra.main(version_base=_VERSION_BASE, config_path=str(folder), config_name=CONFIG)(lambda _: None)()


@contextmanager
def composing(folder: Path) -> Iterator[None]:
    """A context in which `composed` reads the configuration in `folder`."""
    with initialize_config_dir(str(folder), version_base=_VERSION_BASE, job_name="ablate"):
        yield


def composed(overrides: Sequence[str]) -> DictConfig:
    """The whole configuration of one job, its node `hydra` included."""
    return compose(CONFIG, list(overrides), return_hydra_config=True)


def search_path() -> ConfigSearchPath:
    """Where Hydra looks for configuration files; to be called within `composing`."""
    return GlobalHydra.instance().config_loader().get_search_path()


def parse_overrides(overrides: Sequence[str]) -> list[Override]:
    """Parse `key=value` words; one that is not of Hydra's grammar raises a HydraException."""
    return OverridesParser.create().parse_overrides(list(overrides))


def product(overrides: Sequence[Override]) -> list[list[str]]:
    """The overrides of every job of a sweep, the last swept key running fastest."""
    return BasicSweeper.split_arguments(list(overrides), None)[0]


class ComposedConfigLoader(ConfigLoaderImpl):
    """Gives a launcher the configurations of jobs that were composed before, and composes none.

    A launcher pickles this object once for each job, so the configurations are compressed.
    """

    def __init__(self, search_path: ConfigSearchPath, configs: Mapping[tuple[str, ...], DictConfig]) -> None:
        super().__init__(search_path)
        self._packed = {overrides: zlib.compress(pickle.dumps(_untyped(c))) for overrides, c in configs.items()}

    def load_sweep_config(self, master_config: DictConfig, sweep_overrides: list[str]) -> DictConfig:
        config: DictConfig = pickle.loads(zlib.decompress(self._packed[tuple(sweep_overrides)]))
        OmegaConf.set_struct(config, True)
        OmegaConf.copy_cache(from_config=master_config, to_config=config)
        return config


def _untyped(config: DictConfig) -> DictConfig:
    """Remove the types of our schema, which are made at run time and cannot be pickled; keep Hydra's own types."""
    own = OmegaConf.masked_copy(config, [str(key) for key in config if key != "hydra"])
    made = OmegaConf.create(OmegaConf.to_container(own))
    assert isinstance(made, DictConfig)
    made.hydra = config.hydra
    return made


def run_single(config: DictConfig, loader: ComposedConfigLoader, task: TaskFunction) -> None:
    """Run a task as Hydra runs one without `-m`."""
    configure_log(config.hydra.hydra_logging, config.hydra.verbose)
    callbacks = Callbacks(config)
    callbacks.on_run_start(config=config, config_name=CONFIG)
    context = HydraContext(config_loader=loader, callbacks=callbacks)
    returned = run_job(task, config, "hydra.run.dir", None, context)
    callbacks.on_run_end(config=config, config_name=CONFIG, job_return=returned)


def run_sweep(
    master: DictConfig, loader: ComposedConfigLoader, jobs: Sequence[Sequence[str]], task: TaskFunction
) -> None:
    """Run jobs, each named by its overrides, by the launcher that `master` names."""
    configure_log(master.hydra.hydra_logging, master.hydra.verbose)
    callbacks = Callbacks(master)
    callbacks.on_multirun_start(config=master, config_name=CONFIG)
    launcher = _launcher(master, HydraContext(config_loader=loader, callbacks=callbacks), task)
    batch = master.hydra.sweeper.max_batch_size or len(jobs)
    for start in range(0, len(jobs), batch):
        launcher.launch(jobs[start : start + batch], initial_job_idx=start)
    callbacks.on_multirun_end(config=master, config_name=CONFIG)


def run_sweep_job(
    context: HydraContext,
    config: DictConfig,
    task: TaskFunction,
    overrides: list[str],
    number: int,
    singletons: Mapping[Any, Any],
) -> None:
    """Run one job of a sweep in a process of its own, as Hydra's launchers do; `singletons` are the parent's."""
    setup_globals()
    Singleton.set_state(dict(singletons))
    own = context.config_loader.load_sweep_config(config, overrides)
    with open_dict(own):
        own.hydra.job.id, own.hydra.job.num = f"{own.hydra.job.name}_{number}", number
    HydraConfig.instance().set_config(own)
    run_job(task, own, "hydra.sweep.dir", "hydra.sweep.subdir", context)


def _launcher(master: DictConfig, context: HydraContext, task: TaskFunction) -> Launcher:
    """The launcher that `master` names; Hydra accepts only those in the package `hydra_plugins`, and ours are not.

    In place of `joblib` there is one of ours that reads its key `n_jobs`: where one process of joblib's pool is killed,
    or Ctrl-C is pressed, the pool ends all others before they have saved anything.
    """
    launcher: Launcher
    if master.hydra.launcher["_target_"] == _JOBLIB:
        launcher = instantiate({"_target_": _IN_PLACE_OF_JOBLIB, "n_jobs": master.hydra.launcher.n_jobs})
        launcher.setup(hydra_context=context, task_function=task, config=master)
        return launcher
    if Plugins.is_in_toplevel_plugins_module(master.hydra.launcher["_target_"]):
        return Plugins.instance().instantiate_launcher(context, task, master)
    launcher = instantiate(master.hydra.launcher)
    launcher.setup(hydra_context=context, task_function=task, config=master)
    return launcher
