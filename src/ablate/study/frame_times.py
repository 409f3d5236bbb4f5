"""How long a frame takes with each network of a study: timed in turns in one process, kept machine by machine."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch
from tqdm import tqdm

from ablate import dataset
from ablate.dataset import Part, equally_spaced
from ablate.metrics.metric import BOUNDS, FRAME_TIME
from ablate.networks import Family, Generator, Space, conditions
from ablate.settings.study import StudySettings
from ablate.sources.data_set import DataSet
from ablate.sources.source import source_of
from ablate.storage import digest, written_whole
from ablate.study.comparable import without_anatomy
from ablate.study.provenance import hardware
from ablate.study.run import Run
from ablate.threads import torch_threads
from ablate.training import TrainingPrecision, chosen_device, generated_images, load_generator, read_checkpoint

TIMES = "frame_times.csv"  # in the folder of a study
NETWORK = "network"  # the part of a frame's time that is not one of its maps
_KEPT = {"machine": str, "network": str, "round": int, "part": str, "ms": float}
_FEWEST_ROUNDS = 8  # quartiles of fewer say nothing
Maps = tuple[dict[str, np.ndarray], dict[str, float]]  # (H, W) each, and the milliseconds that each took


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
    times, networks = read_times(runs[0].training.folder.parent), {network_of(run.training.identity) for run in runs}
    counts = times[times["network"].isin(networks)].groupby("machine", sort=False)["network"].nunique()
    return "" if counts.empty else str(counts.index[counts == counts.max()][-1])


def frame_times(runs: Sequence[Run]) -> pd.DataFrame:
    """Times of the machine that is shown: columns variant, seed, data, metric, value (the median), lower, upper.

    The bounds are quartiles over the rounds. What a run itself stored of times is not read.
    """
    rows: list[tuple[object, ...]] = []
    if machine := timed_on(runs):
        times = read_times(runs[0].training.folder.parent)
        frames = times[times["machine"] == machine].groupby(["network", "round"], sort=False)["ms"].sum()
        timed = frames.groupby("network", sort=False).quantile(np.array([0.5, 0.25, 0.75])).unstack()
        known = [(run, of) for run in runs if (of := network_of(run.training.identity)) in timed.index]
        rows = [(run.label, run.seed, run.data, FRAME_TIME, *timed.loc[network]) for run, network in known]
    return pd.DataFrame(rows, columns=["variant", "seed", "data", "metric", "value", *BOUNDS])


def untimed(runs: Sequence[Run]) -> list[str]:
    """A sentence about the variants that have no time beside the others'; none where all have one."""
    times, shown = read_times(runs[0].training.folder.parent), timed_on(runs)
    timed = set(times["network"][times["machine"] == shown])
    missing = dict.fromkeys(run.label for run in runs if network_of(run.training.identity) not in timed)
    return [f"Times are those of {shown}; none from there: {', '.join(missing)}."] if shown and missing else []


def time_networks(study_dir: Path, runs: Sequence[Run], custom: Sequence[str] = ()) -> str:
    """Time the networks of the runs, unless this machine has timed all of them before.

    Times of different moments do not compare well, so where one is missing all are measured again. Without a checkpoint
    a network is timed with the weights that it starts with, which takes as long; a custom one is not, because how long
    it takes may depend on them, and its code is run only if `custom` names it: the folder may be a stranger's. Returns
    why nothing could be measured, a sentence, or an empty string.
    """
    to_time = {}
    for run in reversed(runs):
        model = run.training.identity["model"]
        is_known = run.training.checkpoint.is_file() and model.get("target") in custom
        if is_known or model.get("family") != Family.custom.value:
            to_time[network_of(run.training.identity)] = run
    if not to_time:
        return ""
    try:
        settings = {network: run.training.settings for network, run in to_time.items()}
        training = next(iter(settings.values())).training
        device = chosen_device(training.device)
        with torch_threads(training.threads) as threads:
            machine = f"{hardware()}, {device.type}, {threads} thread{'' if threads == 1 else 's'}"
            times = read_times(study_dir)
            here = times["machine"] == machine
            if to_time.keys() <= set(times["network"][here]):
                return ""
            _check_code(to_time.values(), custom)
            measured = _in_turns(to_time, settings, device).assign(machine=machine)
    except (OSError, ValueError, KeyError, TypeError, RuntimeError, ImportError) as error:  # no pairs, no GPU, ...
        return f"Times were not measured: {' '.join(str(error).split())}."
    with written_whole(study_dir / TIMES) as partial:
        pd.concat([times[~here], measured[list(_KEPT)]]).to_csv(partial, index=False)
    return ""


def _check_code(runs: Iterable[Run], custom: Sequence[str]) -> None:
    """Refuse settings and checkpoints that name other code than the command does, whatever their identities say."""
    for run in runs:
        targets = [run.training.settings.model.target]
        if run.training.checkpoint.is_file():
            targets.append(read_checkpoint(run.training.checkpoint)["hyper_parameters"]["spec"]["target"])
        for target in targets:
            if target is not None and target not in custom:
                raise ValueError(
                    f"{run.training.folder} names code, model.target={target!r:.200}, and the command does not"
                )


def _in_turns(runs: Mapping[str, Run], settings: Mapping[str, StudySettings], device: torch.device) -> pd.DataFrame:
    """Times of each network in the columns of `read_times`, without the machine.

    There are `evaluation.timed_frames` rounds, or `_FEWEST_ROUNDS`, after one that does not count. A round makes the
    maps of one frame, once for all networks that read the same ones and no others, because what a map takes depends on
    those beside it. Then it renders with each network; the next round takes them in the opposite order. The frames are
    those of the last anatomy whose pairs are here, of each kind of pairs.
    """
    kinds = {network: digest(without_anatomy(run.training.identity["data"])) for network, run in runs.items()}
    in_order = sorted(runs.items(), key=lambda named: named[1].training.data_set.exists)
    chosen = {kinds[network]: run for network, run in in_order}  # the last counts
    data = {kind: run.training.data_set for kind, run in chosen.items()}
    reads, render = {}, {}  # by network
    for network, run in runs.items():
        kind, s = kinds[network], settings[network]
        values = dataset.label_values(data[kind].tissues, s.encoding, s.label_seed)
        if run.training.checkpoint.is_file():
            generator = load_generator(run.training.checkpoint)
        else:  # the weights that a training starts with
            generator = Generator(replace(s.model, labels=values.shape[1])).eval()
        precision = TrainingPrecision[run.training.identity["training"]["precision"]]
        render[network] = generated_images(generator.to(device), data[kind].pairs, values, precision)
        reads[network] = Read(kind, conditions(generator.spec), generator.spec.space)
    make = {kind: _map_maker(chosen[kind].training.settings, of_kind) for kind, of_kind in data.items()}
    different = list(dict.fromkeys(reads.values()))
    rounds = max(next(iter(settings.values())).evaluation.timed_frames, _FEWEST_ROUNDS)
    frames = {kind: equally_spaced(each.pairs.frames(Part.test), rounds) for kind, each in data.items()}
    rows: list[tuple[str, int, str, float]] = []
    turns = list(runs)
    with tqdm(total=(rounds + 1) * len(runs), unit="frame", desc="time", leave=False, disable=None) as bar:
        for number in range(rounds + 1):
            shown = {kind: int(of_kind[number % len(of_kind)]) for kind, of_kind in frames.items()}
            made = {
                read: make[read.kind](shown[read.kind], number * len(different) + k, read.names, read.space)
                for k, read in enumerate(different)
            }
            for network in turns:
                read = reads[network]
                maps, map_ms = made[read]
                given = {name: maps[name][None] for name in read.names}
                start = time.perf_counter()
                render[network](np.array([shown[read.kind]]), number, given)  # waits for a GPU
                parts = {name: map_ms[name] for name in given if name in map_ms}
                parts[NETWORK] = 1e3 * (time.perf_counter() - start)
                rows += [(network, number, name, ms) for name, ms in parts.items()]
                bar.update()
            turns.reverse()
    times = pd.DataFrame(rows, columns=["network", "round", "part", "ms"])
    return times[times["round"] > 0]


def _map_maker(settings: StudySettings, data: DataSet) -> Callable[[int, int, Sequence[str], Space], Maps]:
    """A function of frame, turn, names, and space: maps. Where pairs were made elsewhere they are read in no time."""
    source = source_of(settings)
    if not source.has_scene:
        return lambda frame, _, names, space: ({name: data.pairs.read(name, [frame], space)[0] for name in names}, {})

    from ablate.dataset.simulate import nudged, timed_maps

    scene, _ = source.scene()
    simulator = replace(settings.simulator, time_gain_db=data.time_gain_db)
    make = timed_maps(scene, settings.probe, simulator, data.pairs.poses)
    return lambda frame, turn, *of: make(nudged(data.pairs.poses[frame], turn), settings.dataset.seed, *of)
