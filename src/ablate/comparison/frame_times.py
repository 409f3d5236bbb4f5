"""How long a frame takes with each network of a study: timed in turns in one process, kept machine by machine."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from tqdm import tqdm

from ablate import dataset
from ablate.comparison.usable_runs import without_anatomy
from ablate.dataset import Part, equally_spaced
from ablate.metrics.stored_names import BOUNDS, FRAME_TIME
from ablate.networks import Family, Generator, conditions
from ablate.runs.data_set import DataSet
from ablate.runs.run import Run
from ablate.settings.study import SceneKind, StudySettings
from ablate.storage import digest, read_json, write_json
from ablate.tracking import hardware
from ablate.training import chosen_device, generate, load_generator

TIMES = "times.json"  # in the folder of a study
NETWORK = "network"  # the part of a frame's time that is not one of its maps

_FEWEST_ROUNDS = 8  # quartiles of fewer say nothing
Maps = tuple[dict[str, np.ndarray], dict[str, float]]  # (H, W) each, and the milliseconds that each took


@dataclass(frozen=True)
class FrameTime:
    """Milliseconds of each part of a frame, the maps that the network reads and the network, a value a round."""

    parts: Mapping[str, Sequence[float]]

    @property
    def quartiles(self) -> tuple[float, float, float]:
        """Lower quartile, median and upper quartile of the whole frame."""
        lower, middle, upper = np.percentile(np.sum(list(self.parts.values()), axis=0), (25, 50, 75))
        return float(lower), float(middle), float(upper)


Times = dict[str, dict[str, FrameTime]]  # by machine, the one timed last at the end, and by network


def network_of(semantic: Mapping[str, Any]) -> str:
    """What decides the time of a frame on a machine: the network, its arithmetic, and what its maps are made from.

    The weights do not, nor does the anatomy of a block, so several runs have one time. `semantic` is from `spec.json`.
    """
    precision = semantic.get("training", {}).get("precision")
    return digest({"model": semantic["model"], "precision": precision, "data": without_anatomy(semantic["data"])})


def read_times(study_dir: Path) -> Times:
    """What is kept for a study; nothing where the file is missing or damaged."""
    try:
        machines = read_json(study_dir / TIMES)["machines"]
        return {
            str(machine["name"]): {str(k): _frame_time(parts) for k, parts in machine["networks"].items()}
            for machine in machines
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def _frame_time(parts: Mapping[str, Sequence[float]]) -> FrameTime:
    frame_time = FrameTime({str(name): [float(ms) for ms in values] for name, values in parts.items()})
    if not all(np.isfinite(frame_time.quartiles)):
        raise ValueError(f"{TIMES}: a time that is not finite")
    return frame_time


def write_times(study_dir: Path, times: Times) -> None:
    """Keep the times of a study."""
    machines = [
        {"name": machine, "networks": {network: dict(time.parts) for network, time in timed.items()}}
        for machine, timed in times.items()
    ]
    write_json(study_dir / TIMES, {"machines": machines})


def shown_machine(times: Times, networks: Iterable[str]) -> str | None:
    """The one machine whose times are compared: on which most of these networks were timed, and of several the last."""
    wanted = set(networks)
    counts = {machine: len(wanted & timed.keys()) for machine, timed in times.items()}
    most = max(counts.values(), default=0)
    return next(machine for machine in reversed(counts) if counts[machine] == most) if most else None


def time_rows(study_dir: Path, runs: Mapping[tuple[str, int, str], str]) -> pd.DataFrame:
    """Times of the machine that is shown: columns variant, seed, data, metric, value (the median), lower, upper.

    The bounds are quartiles over the rounds. `runs` holds the network of each run by its variant, seed and data.
    """
    times = read_times(study_dir)
    timed = times.get(shown_machine(times, runs.values()) or "", {})
    rows = []
    for (variant, seed, data), network in runs.items():
        if network in timed:
            lower, middle, upper = timed[network].quartiles
            rows.append((variant, seed, data, FRAME_TIME, middle, lower, upper))
    return pd.DataFrame(rows, columns=["variant", "seed", "data", "metric", "value", *BOUNDS])


def all_times(study_dir: Path, labels: Mapping[str, str]) -> pd.DataFrame:
    """Everything that is kept: columns variant, machine, ms, lower, upper, rounds, and the median of each part.

    `labels` names the network of each variant.
    """
    rows = []
    for machine, timed in read_times(study_dir).items():
        for variant, network in labels.items():
            if (time := timed.get(network)) is not None:
                lower, middle, upper = time.quartiles
                parts = {f"{part}_ms": float(np.median(ms)) for part, ms in time.parts.items()}
                rounds = len(next(iter(time.parts.values())))
                about = {"variant": variant, "machine": machine, "ms": middle, "lower": lower, "upper": upper}
                rows.append({**about, "rounds": rounds, **parts})
    return pd.DataFrame(rows)


def untimed(study_dir: Path, labels: Mapping[str, str]) -> list[str]:
    """Sentences about the variants that have no time beside the others'."""
    times = read_times(study_dir)
    shown = shown_machine(times, labels.values())
    if shown is None:
        return []
    missing: dict[str, list[str]] = {}
    for variant, network in labels.items():
        if network not in times[shown]:
            elsewhere = [machine for machine, timed in times.items() if network in timed]
            missing.setdefault(elsewhere[-1] if elsewhere else "", []).append(variant)
    return [
        f"Times are those of {shown}; none from there: {', '.join(names)} "
        f"({f'timed on {machine}, see times.csv' if machine else 'not timed'})."
        for machine, names in missing.items()
    ]


def time_networks(study_dir: Path, runs: Sequence[Run]) -> str:
    """Time the networks of the runs, unless this machine has timed all of them before.

    Times of different moments do not compare well, so where one is missing all are measured again. Without a checkpoint
    a network is timed with the weights that it starts with, which takes as long; a custom one is not, because how long
    it takes may depend on them. Returns why nothing could be measured, a sentence, or an empty string.
    """
    kept = {
        network_of(run.spec["semantic"]): run
        for run in reversed(runs)
        if run.checkpoint.is_file() or run.spec["semantic"]["model"].get("family") != Family.custom.value
    }
    if not kept:
        return ""
    try:
        settings = {network: run.settings for network, run in kept.items()}
        training = next(iter(settings.values())).training
        device = chosen_device(training.device)
        with _threads(training.threads) as threads:
            machine = f"{hardware()}, {device.type}, {threads} thread{'' if threads == 1 else 's'}"
            times = read_times(study_dir)
            before = times.pop(machine, {})
            if kept.keys() <= before.keys():
                return ""
            measured = _in_turns(kept, settings, device)
    except (OSError, ValueError, KeyError, RuntimeError, ImportError) as error:  # no pairs, no GPU, no Embree, ...
        return f"Times were not measured: {' '.join(str(error).split())}."
    write_times(study_dir, {**times, machine: {**before, **measured}})
    return ""


def _generator(run: Run, settings: StudySettings) -> Generator:
    """The trained network, or the same with the weights that a training starts with."""
    return load_generator(run.checkpoint) if run.checkpoint.is_file() else Generator(settings.model).eval()


@contextmanager
def _threads(count: int) -> Iterator[int]:
    """Use as many threads as the study's settings say, where they do."""
    before = torch.get_num_threads()
    torch.set_num_threads(count or before)
    try:
        yield torch.get_num_threads()
    finally:
        torch.set_num_threads(before)


def _in_turns(
    runs: Mapping[str, Run], settings: Mapping[str, StudySettings], device: torch.device
) -> dict[str, FrameTime]:
    """Times of each network, `evaluation.timed_frames` rounds or `_FEWEST_ROUNDS` after one that does not count.

    A round makes the maps of one frame once, for all networks, and then renders it with each of them; the next round
    takes them in the opposite order. The frames are those of the first anatomy whose pairs are here.
    """
    first = next((network for network, run in runs.items() if run.data_set.exists), next(iter(runs)))
    data = runs[first].data_set
    generators = {network: _generator(run, settings[network]).to(device) for network, run in runs.items()}
    read = {network: conditions(generator.spec) for network, generator in generators.items()}
    values = {k: dataset.label_values(data.tissues, s.encoding, s.encoding_seed) for k, s in settings.items()}
    rounds = max(settings[first].evaluation.timed_frames, _FEWEST_ROUNDS)
    make = _map_maker(settings[first], data, {name for names in read.values() for name in names})
    mask = data.pairs.mask()
    frames = equally_spaced(data.pairs.frames(Part.test), rounds)
    taken: dict[str, dict[str, list[float]]] = {network: {} for network in runs}
    turns = list(runs)
    with tqdm(total=(rounds + 1) * len(runs), unit="frame", desc="time", mininterval=1.0, leave=False) as bar:
        for number in range(rounds + 1):
            frame = int(frames[number % len(frames)])
            maps, map_ms = make(frame, number)
            for network in turns:
                given = {name: maps[name][None] for name in read[network]}
                seed = torch.from_numpy(dataset.noise_seeds(np.array([frame]), number))
                start = time.perf_counter()
                inputs = dataset.network_inputs(given, values[network], mask)
                precision = settings[network].training.precision
                generate(generators[network], inputs, torch.from_numpy(mask), seed, precision)  # waits for a GPU
                parts = {name: map_ms[name] for name in read[network] if name in map_ms}
                parts[NETWORK] = 1e3 * (time.perf_counter() - start)
                for name, ms in parts.items() if number else ():
                    taken[network].setdefault(name, []).append(ms)
                bar.update()
            turns.reverse()
    return {network: FrameTime(parts) for network, parts in taken.items()}


def _map_maker(settings: StudySettings, data: DataSet, names: set[str]) -> Callable[[int, int], Maps]:
    """A function of frame and round that makes maps. Where pairs were made elsewhere they are read and take no time."""
    if settings.scene.kind is SceneKind.pairs:
        return lambda frame, _: ({name: data.pairs.read(name, [frame])[0] for name in names}, {})

    from ablate.runs.simulated import build_scene
    from ablate.runs.timed_maps import TimedMaps, nudged

    scene, _ = build_scene(settings)
    make = TimedMaps(scene, settings.probe, settings.simulator, data.pairs.poses, low="low" in names)
    return lambda frame, number: make(nudged(data.pairs.poses[frame], number), settings.dataset.seed)
