"""Hydra's plugins of `ablate`: Hydra accepts launchers and sweepers from the namespace `hydra_plugins` alone.

Hydra imports this file whenever it starts, so what the plugins need is imported where they work.
"""

from collections.abc import Sequence
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.core.plugins import Plugins
from hydra.core.utils import JobReturn
from hydra.plugins.launcher import Launcher
from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig

try:
    from hydra_plugins.hydra_submitit_launcher.submitit_launcher import SlurmLauncher
except ImportError:  # the extra `slurm` is not installed
    SlurmLauncher = None


class ProcessLauncher(Launcher):
    """`hydra/launcher=processes`: a process for each job on this machine; see `ablate.command.launch`."""

    def __init__(self, n_jobs: int = -1) -> None:
        self.n_jobs = n_jobs

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """Keep what every job is run with."""
        self.hydra_context, self.task_function, self.config = hydra_context, task_function, config

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> list[JobReturn]:
        """Check all jobs, make their pairs, run them side by side and compare their study."""
        from ablate.command.launch import start_processes
        from ablate.tasks.entry import run_sweep

        return run_sweep(self.config, job_overrides, initial_job_idx, start_processes(self))


class CellSweeper(Sweeper):
    """`hydra/sweeper=cells`: the product of all swept keys, for each line of `hydra.sweeper.params.cells`.

    Unlike Hydra's basic sweeper it also takes cells that are no product, such as a fraction of a factorial, and leaves
    composing the jobs to the launcher.
    """

    def __init__(self, max_batch_size: int | None = None, params: Any = None, **of_jobs: Any) -> None:
        self.max_batch_size, self.params = max_batch_size, params
        del of_jobs  # `swept` and `source`, for the jobs: see `sweep`

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """Make the launcher that the command line names."""
        self.config: Any = config
        self.launcher: Any = Plugins.instance().instantiate_launcher(
            hydra_context=hydra_context, task_function=task_function, config=config
        )

    def sweep(self, arguments: list[str]) -> list[Sequence[JobReturn]]:
        """Launch the jobs, in batches of `max_batch_size`; what a job raised is raised here.

        Each job is told which keys are swept, because its label names them, wherever it is composed; and by which code
        the command runs, as a job that begins later, in another process, may find other files.
        """
        from ablate.command.compose import cells, refuse_other_launcher, swept_keys
        from ablate.command.composed import composed
        from ablate.settings.study import ConfigurationError
        from ablate.study.source_code import loaded_digest

        HydraConfig.instance().set_config(self.config)  # as Hydra does for a job
        jobs = cells(self.config.hydra.sweeper.params, arguments)
        size = len(jobs) if self.max_batch_size is None else self.max_batch_size
        if not isinstance(size, int) or size < 1:
            raise ConfigurationError(f"hydra.sweeper.max_batch_size={size}: allowed are 1 and more, or null for all")
        keys = swept_keys(jobs, arguments)
        swept = ",".join(sorted(keys))
        if not self.launcher.__module__.startswith(__name__):  # ours looks at its jobs before it starts one
            for job in jobs:
                chosen = [word for word in job if word.partition("=")[0] in keys]
                refuse_other_launcher(self.config, composed([*self.config.hydra.overrides.hydra, *job]), chosen)
        told = [f"hydra.sweeper.swept=[{swept}]", f"hydra.sweeper.source='{loaded_digest()}'"]
        jobs = [[*job, *told] for job in jobs]
        batches = []
        for start in range(0, len(jobs), size):
            returns = self.launcher.launch(jobs[start : start + size], initial_job_idx=start)
            batches.append(returns)
            for returned in returns:
                _ = returned.return_value
        return batches


if SlurmLauncher is not None:

    class QueueLauncher(SlurmLauncher):
        """`hydra/launcher=slurm`: submitit's launcher, which also returns where a job was killed or queued again."""

        def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> list[JobReturn]:
            """Check all jobs, submit one array of them, wait for it and compare their study."""
            from ablate.command.slurm import submit
            from ablate.tasks.entry import run_sweep

            return run_sweep(self.config, job_overrides, initial_job_idx, submit(self), elsewhere=True)
