"""Hydra's public interface: its grammar, and what it composes of words in that grammar."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from omegaconf import DictConfig

from ablate.command.refusals import in_one_line
from ablate.command.schema import register
from ablate.settings.components import read_components_from
from ablate.settings.conf import conf_folder

CONFIG = "config"
VERSION_BASE = "1.3"


def composed(overrides: Sequence[str], primary: str | None = None) -> DictConfig:
    """The whole configuration of one job, its node `hydra` included; what cannot be composed is refused in one line.

    `primary` is conf/config.yaml, or what `--config-name` of the running command names, if it is not given.
    """
    register()
    with in_one_line(overrides), ExitStack() as stack:
        if not GlobalHydra.instance().is_initialized():  # as the command line does it
            folder = str(conf_folder())
            stack.enter_context(initialize_config_dir(folder, version_base=VERSION_BASE, job_name="ablate"))
        return compose(primary or primary_name(), list(overrides), return_hydra_config=True)


def primary_name() -> str:
    """The file that a command line starts from; `hydra.main` says it once it has composed."""
    is_running = GlobalHydra.instance().is_initialized() and HydraConfig.initialized()
    return str(HydraConfig.get().job.config_name) if is_running else CONFIG


def parsed(words: Sequence[str]) -> list[Override]:
    """Words `key=value`, read by Hydra's grammar."""
    return OverridesParser.create().parse_overrides(list(words))


def read_own_components(hydra_node: Any) -> None:
    """Read components also where Hydra looks for the user's files, as `--config-dir`, and in conf/ of this folder."""
    runtime = hydra_node.runtime
    places = [source.path for source in runtime.config_sources if source.schema == "file"]
    read_components_from([*map(Path, places), Path(runtime.cwd) / "conf"])
