"""How long a frame takes with each network of a study: timed in turns in one process, kept machine by machine."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch

from ablate import dataset
from ablate.analysis import REFERENCE
from ablate.dataset import Part, equally_spaced
from ablate.evaluation import formula_images, formula_maps, time_in_turns
from ablate.metrics.metric import BOUNDS, FORMULA, FRAME_TIME
from ablate.networks import Family, Generator, Space, conditions, count_generator
from ablate.setting import shown
from ablate.settings.study import StudySettings
from ablate.sources.data_set import DataSet
from ablate.sources.source import source_of
from ablate.storage import digest, written_whole
from ablate.study.comparable import without_anatomy
from ablate.study.provenance import hardware
from ablate.study.run import Run
from ablate.threads import torch_threads
from ablate.training import TrainingPrecision, chosen_device, generated_images, load_generator

TIMES = "frame_times.csv"  # in the folder of a study
NETWORK = "network"  # the part of a frame's time that is not one of its maps
_KEPT = {"machine": str, "network": str, "round": int, "part": str, "ms": float}
_MOST_WEIGHTS = 2**26  # the largest network of the paper's width has 5.9e7
_FEWEST_ROUNDS = 8  # quartiles of fewer say nothing
Maps = tuple[dict[str, np.ndarray], dict[str, float]]  # (H, W) each, and the milliseconds that each took
Rendering = Callable[[np.ndarray, int, dict[str, np.ndarray]], np.ndarray]  # of frames, draw of noise, maps


class Read(NamedTuple):
    """What a network reads of a frame; networks that read the same share its maps."""

    kind: str  # of pairs: the digest of their recipe
    names: tuple[str, ...]
    space: Space


def network_of(identity: Mapping[str, Any]) -> str:
    """What decides the time of a frame on a machine: network, encoding, arithmetic, and the recipe of its maps.

    The weights do not, nor does the anatomy of a block, so several runs have one time. `identity` is of a training.
    """
    read = {"order": identity["encoding"]["order"], "data": without_anatomy(identity["data"])}
    return digest({"model": identity["model"], "precision": identity["training"].get("precision"), **read})


def formula_of(runs: Sequence[Run], reference: str) -> tuple[str, Run] | None:
    """What decides the time of the formula, and the run whose maps it reads; None where pairs were made elsewhere.

    It is the first run of the reference, or of all where it has none.
    """
    simulated = [run for run in runs if run.identity["data"].get("simulator")]
    reference_runs = [run for run in simulated if run.label.partition(".")[0] == reference]
    first = next(iter(reference_runs or simulated), None)
    if first is None:
        return None
    maps = formula_maps(first.training.settings.model)
    return digest({FORMULA: maps, "data": without_anatomy(first.identity["data"])}), first


def read_times(study_dir: Path) -> pd.DataFrame:
    """What is kept for a study: a row for each part of a frame in a round, the machine that was timed last at the end.

    Columns are machine, network, round, part (a map that the network reads, or the network) and ms. There are no rows
    where the file is missing or damaged.
    """
    try:
        return pd.read_csv(study_dir / TIMES, dtype=_KEPT)[list(_KEPT)].dropna()
    except (OSError, ValueError, KeyError):
        return pd.DataFrame({name: pd.Series(dtype=kind) for name, kind in _KEPT.items()})


def timed_on(runs: Sequence[Run]) -> str:
    """The machine on which most networks of these runs were timed, of several the last; empty without times."""
    times, networks = read_times(runs[0].training.folder.parent), {network_of(run.identity) for run in runs}
    counts = times[times["network"].isin(networks)].groupby("machine", sort=False)["network"].nunique()
    return "" if counts.empty else str(counts.index[counts == counts.max()][-1])


def frame_times(runs: Sequence[Run], reference: str = REFERENCE) -> pd.DataFrame:
    """Times of the machine that is shown: columns variant, seed, data, metric, value (the median), lower, upper.

    The bounds are quartiles over the rounds; the last row is of the formula. What a run itself stored of times is not
    read.
    """
    rows: list[tuple[object, ...]] = []
    if machine := timed_on(runs):
        times = read_times(runs[0].training.folder.parent)
        frames = times[times["machine"] == machine].groupby(["network", "round"], sort=False)["ms"].sum()
        timed = frames.groupby("network", sort=False).quantile(np.array([0.5, 0.25, 0.75])).unstack()
        known = [(run, of) for run in runs if (of := network_of(run.identity)) in timed.index]
        rows = [(run.label, run.seed, run.data, FRAME_TIME, *timed.loc[network]) for run, network in known]
        formula = formula_of(runs, reference)
        if formula is not None and formula[0] in timed.index:
            rows.append((FORMULA, formula[1].seed, formula[1].data, FRAME_TIME, *timed.loc[formula[0]]))
    return pd.DataFrame(rows, columns=["variant", "seed", "data", "metric", "value", *BOUNDS])


def untimed(runs: Sequence[Run]) -> list[str]:
    """A sentence about the variants that have no time beside the others'; none where all have one."""
    times, shown = read_times(runs[0].training.folder.parent), timed_on(runs)
    timed = set(times["network"][times["machine"] == shown])
    missing = dict.fromkeys(run.label for run in runs if network_of(run.identity) not in timed)
    return [f"Times are those of {shown}; none from there: {', '.join(missing)}."] if shown and missing else []


def time_networks(study_dir: Path, runs: Sequence[Run], named: Collection[str] = (), reference: str = REFERENCE) -> str:
    """Time the networks of the runs and the formula, unless this machine has timed all of them before.

    Times of different moments do not compare well, so where one is missing all are measured again. Without a checkpoint
    a network is timed with the weights that it starts with, which takes as long. A class of the user's is timed with
    its weights only, because how long it takes may depend on them, and only if it is among those that this command has
    `named`: what only a file names is not imported. Returns why nothing could be measured, a sentence, or an empty
    string.

    Parameters
    ----------
    study_dir : Path
        Folder of the study, where the times are kept.
    runs : sequence of Run
        Whose networks are timed.
    named : collection of str
        Dotted paths of the user's classes.
    reference : str
        The variant whose maps the formula reads.
    """
    to_time = {network_of(run.identity): run for run in reversed(runs) if _can_be_timed(run, named)}
    if not to_time:
        return ""
    try:
        training = next(iter(to_time.values())).training.settings.training
        device = chosen_device(training.device)
        with torch_threads(training.threads) as threads:
            machine = f"{hardware()}, {device.type}, {threads} thread{'' if threads == 1 else 's'}"
            times = read_times(study_dir)
            here = times["machine"] == machine
            formula = formula_of(list(to_time.values()), reference)
            if {*to_time, *(formula or ())[:1]} <= set(times["network"][here]):
                return ""
            measured = _in_turns(to_time, formula, device).assign(machine=machine)
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        RuntimeError,
        ImportError,
    ) as error:  # such as lost pairs
        return f"Times were not measured: {' '.join(str(error).split())}."
    with written_whole(study_dir / TIMES) as partial:
        pd.concat([times[~here], measured[list(_KEPT)]]).to_csv(partial, index=False)
    return ""


def _can_be_timed(run: Run, named: Collection[str]) -> bool:
    if run.identity["model"].get("family") != Family.custom.value:
        return True
    return run.training.checkpoint.is_file() and run.identity["model"].get("target") in named


@dataclass(frozen=True)
class _Network:
    """A network that can render frames of pairs of its kind."""

    read: Read
    render: Rendering


def _in_turns(runs: Mapping[str, Run], formula: tuple[str, Run] | None, device: torch.device) -> pd.DataFrame:
    """Times of each network and of the formula in the columns of `read_times`, without the machine.

    There are `evaluation.timed_frames` rounds, or `_FEWEST_ROUNDS`, after one that does not count. A round makes the
    maps of one frame, once for all networks that read the same ones and no others, because what a map takes depends on
    those beside it. Then it renders with each network; the next round takes them in the opposite order. The frames are
    those of the last anatomy whose pairs are here, of each kind of pairs.
    """
    run_of_kind: dict[str, Run] = {}
    for run in sorted(runs.values(), key=lambda run: run.training.data_set.exists):
        run_of_kind[_kind_of(run)] = run  # the last counts
    networks = {
        name: _prepared(run, run_of_kind[_kind_of(run)].training.data_set, device) for name, run in runs.items()
    }
    if formula is not None:
        name, run = formula
        networks[name] = _prepared_formula(run, run_of_kind[_kind_of(run)].training.data_set)
    asked = next(iter(runs.values())).training.settings.evaluation.timed_frames
    rounds = max(asked, _FEWEST_ROUNDS)
    maps = _MapsOfRounds(run_of_kind, rounds, [network.read for network in networks.values()])

    def render(name: str, number: int) -> None:
        network = networks[name]
        frame, arrays = maps.of(network.read)
        given = {map_name: arrays[map_name][None] for map_name in network.read.names}
        network.render(np.array([frame]), number, given)  # waits for a GPU

    calls = {name: partial(render, name) for name in networks}
    network_times = time_in_turns(calls, rounds, before=lambda _, number: maps.make(number), what="time")
    rows = []
    for name, number, ms in network_times.itertuples(index=False):
        maps_ms = maps.ms[number, networks[name].read]
        rows += [(name, number, part, part_ms) for part, part_ms in {**maps_ms, NETWORK: ms}.items()]
    return pd.DataFrame(rows, columns=["network", "round", "part", "ms"])


def _kind_of(run: Run) -> str:
    """Pairs of one kind have maps that take as long."""
    return digest(without_anatomy(run.identity["data"]))


def _prepared(run: Run, data: DataSet, device: torch.device) -> _Network:
    """The network of a run, with its weights where they are there, on frames of a data set of its kind."""
    training, settings = run.training, run.training.settings
    values = dataset.label_values(data.tissues, settings.encoding, settings.label_seed)
    if training.checkpoint.is_file():
        generator = load_generator(training.checkpoint, run.identity["model"].get("target"))
    elif settings.model.target is not None:
        raise ValueError(f"{training.folder} names code, model.target={shown(settings.model.target)}")
    else:  # the weights that a training starts with
        weights = count_generator(settings.model, values.shape[1])  # what a stranger's folder asks for in a few bytes
        if weights > _MOST_WEIGHTS:
            lacking = f"{training.folder} has no checkpoint, and a network of {weights:,} weights"
            raise ValueError(f"{lacking}; allowed are {_MOST_WEIGHTS:,} without one")
        generator = Generator(settings.model, values.shape[1]).eval()
    precision = TrainingPrecision[run.identity["training"]["precision"]]
    render = generated_images(generator.to(device), data.pairs, values, precision)
    return _Network(Read(_kind_of(run), conditions(generator.spec), generator.spec.space), render)


def _prepared_formula(run: Run, data: DataSet) -> _Network:
    """The formula of the maps that the network of a run reads, on frames of a data set of its kind."""
    spec = run.training.settings.model
    render = formula_images(data.tissues, data.pairs, spec)
    return _Network(Read(_kind_of(run), formula_maps(spec), Space.beam), render)


class _MapsOfRounds:
    """The maps of one frame a round, for each combination of maps that a network reads."""

    def __init__(self, of_kind: Mapping[str, Run], rounds: int, reads: Sequence[Read]) -> None:
        self.ms: dict[tuple[int, Read], dict[str, float]] = {}  # by round; of the maps that took any
        self._reads = list(dict.fromkeys(reads))
        data = {kind: run.training.data_set for kind, run in of_kind.items()}
        self._makers = {kind: _map_maker(run.training.settings, data[kind]) for kind, run in of_kind.items()}
        self._frames = {kind: equally_spaced(one.pairs.frames(Part.test), rounds) for kind, one in data.items()}
        self._arrays: dict[Read, tuple[int, dict[str, np.ndarray]]] = {}
        self._round: int | None = None

    def make(self, number: int) -> None:
        """Make the maps of a round, unless they are made."""
        if number == self._round:
            return
        self._round = number
        for turn, read in enumerate(self._reads, start=number * len(self._reads)):
            frames = self._frames[read.kind]
            frame = int(frames[number % len(frames)])
            arrays, ms = self._makers[read.kind](frame, turn, read.names, read.space)
            self._arrays[read] = frame, arrays
            self.ms[number, read] = {name: ms[name] for name in read.names if name in ms}

    def of(self, read: Read) -> tuple[int, dict[str, np.ndarray]]:
        """The number of the round's frame, and its maps."""
        return self._arrays[read]


def _map_maker(settings: StudySettings, data: DataSet) -> Callable[[int, int, Sequence[str], Space], Maps]:
    """A function of frame, turn, names, and space: maps. Where pairs were made elsewhere they are read in no time."""
    source = source_of(settings)
    if not source.has_scene:
        return lambda frame, _, names, space: ({name: data.pairs.read(name, [frame], space)[0] for name in names}, {})

    from ablate.dataset.simulate import nudged, timed_maps

    scene, _ = source.scene()
    simulator = replace(settings.simulator, time_gain_db=data.time_gain_db)
    make = timed_maps(scene, settings.probe, simulator, data.pairs.poses, settings.scene.target)
    return lambda frame, turn, *of: make(nudged(data.pairs.poses[frame], turn), settings.dataset.seed, *of)
