"""What a data set at the paper's size costs: to simulate, to store, and to read crops from.

make bench-dataset

A few frames of the paper's 6,669 are simulated as `task=simulate preset=paper` does it; what all would take is
those frames' cost times their number. Give it the machine alone.
"""

import resource
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median

import numpy as np
import torch
from numcodecs import Blosc, Zstd

from ablate.command.compose import jobs_of
from ablate.dataset import CropLoader, Crops, CropSettings, Encoding, Pairs, Part, label_values
from ablate.dataset.encoding import decode_attenuation, encode_attenuation
from ablate.dataset.pairs import FORMATS
from ablate.settings.study import DatasetSettings
from ablate.sources.data_set import DataSet, maps_needed
from ablate.sources.prepare import prepare_data, simulator_of
from ablate.sources.source import source_of
from ablate.study.job import Job
from ablate.study.provenance import hardware
from ablate.ultrasound import Simulator
from yardstick import Yardstick

FRAMES, LEAST_FRAMES, SHARD, WORKERS = 96, 32, 4, 2
PAPER = DatasetSettings().frames
CODEC_FRAMES = 8
LOADER_BATCHES, MEMORY_BATCHES = 200, 3000
HOUR_BATCHES = 3600 * 200 // CropSettings().batch_size  # of 200 crops a second

CODECS: dict[str, Blosc | Zstd] = {
    "zstd 3": Zstd(3),
    "zstd 9": Zstd(9),
    "lz4, shuffled bytes": Blosc("lz4", 5, Blosc.SHUFFLE),
    "zstd 3, shuffled bytes": Blosc("zstd", 3, Blosc.SHUFFLE),
    "zstd 3, shuffled bits": Blosc("zstd", 3, Blosc.BITSHUFFLE),
    "zstd 5, shuffled bytes": Blosc("zstd", 5, Blosc.SHUFFLE),
    "zstd 5, shuffled bits": Blosc("zstd", 5, Blosc.BITSHUFFLE),
}


def table(title: str, rows: Sequence[Sequence[str]]) -> None:
    """Print rows, the first of them the head, with the first column to the left and the others to the right."""
    widths = [max(len(r[k]) for r in rows) for k in range(len(rows[0]))]
    print(f"\n{title}")
    for first, *rest in rows:
        cells = (cell.rjust(width) for cell, width in zip(rest, widths[1:], strict=True))
        print("  ".join([first.ljust(widths[0]), *cells]), flush=True)


def milliseconds(call: Callable[..., object], *arguments: object) -> float:
    """Of one call."""
    start = time.perf_counter()
    call(*arguments)
    return 1e3 * (time.perf_counter() - start)


def simulated(job: Job) -> DataSet:
    """Simulate the frames and print what they cost."""
    started = time.time()
    maps = maps_needed([job.settings.model])
    data = prepare_data(job.settings, job.data, job.identity["data"], maps)
    pairs = data.pairs
    done = np.zeros(pairs.shards)
    size = dict.fromkeys(sorted(maps), 0)
    for shard in range(pairs.shards):
        for name in (name for name in maps if pairs.shard_file(name, shard).exists()):
            file = pairs.shard_file(name, shard).stat()
            done[shard] = max(done[shard], file.st_mtime)
            size[name] += file.st_size
    done.sort()
    # The first shard of each worker holds its start; at the end one worker may be alone.
    steady = done[WORKERS - 1 : 1 - WORKERS]
    span = 2 * WORKERS
    rates = span * SHARD / (steady[span:] - steady[:-span])
    start, rate = done[0] - started, SHARD * (len(steady) - 1) / (steady[-1] - steady[0])
    rows = [
        ("", "measured", f"{PAPER:,} frames"),
        ("before the first shard, s", f"{start:.0f}", f"{start:.0f}"),
        ("frames a second", f"{rate:.2f}", f"{rate:.2f}"),
        ("  slowest, median, fastest", f"{rates.min():.2f}, {median(rates):.2f}, {rates.max():.2f}", ""),
        ("minutes", f"{(done[-1] - started) / 60:.1f}", f"{(start + PAPER / rate) / 60:.1f}"),
    ]
    table(f"Simulating {len(pairs)} frames of {pairs.shape[0]} x {pairs.shape[1]} in {WORKERS} processes", rows)
    rows = [("kB a frame", "measured", f"GiB of {PAPER:,}")]
    for name, total in (*size.items(), ("together", sum(size.values()))):
        each = total / len(pairs)
        rows.append((name, f"{each / 1e3:.0f}", f"{each * PAPER / 2**30:.2f}"))
    unseen = (pairs.split != Part.train).mean()
    table(f"On disk (resimulation for the {unseen:.0%} of frames that are not trained on)", rows)
    return data


def codecs(job: Job, pairs: Pairs) -> None:
    """Print size and time of the codecs tried on each kind of map."""
    scene, grid = source_of(job.settings).scene()
    chosen_settings = simulator_of(job.settings, job.data, scene, grid, pairs.poses)
    simulator = Simulator(scene, job.settings.probe, chosen_settings, poses=pairs.poses)
    chosen = np.linspace(0, len(pairs) - 1, CODEC_FRAMES).round().astype(int)
    exact = [simulator.beam_maps(pairs.poses[i], False).attenuation for i in chosen]
    stacks = {
        "segmentation": [pairs.stored("segmentation", i, pairs.space) for i in chosen],
        "target": [pairs.stored("target", i, pairs.space) for i in chosen],
        "attenuation, 16 bits": [np.rint(a * 65535).astype(np.uint16) for a in exact],
        "attenuation, 9 bits": [encode_attenuation(a) for a in exact],
    }
    kept = max(float(np.abs(decode_attenuation(encode_attenuation(a)) - a).max()) for a in exact)
    rows = [("map", "codec", "kB a frame", "ms to write", "ms to read")]
    for name, stack in stacks.items():
        for label, codec in CODECS.items():
            packed = [codec.encode(frame) for frame in stack]
            write = median(milliseconds(codec.encode, frame) for frame in stack)
            read = median(milliseconds(codec.decode, frame) for frame in packed)
            rows.append((name, label, f"{np.mean([len(p) for p in packed]) / 1e3:.0f}", f"{write:.1f}", f"{read:.1f}"))
    stored = ", ".join(f"{name}: zstd 3, {shuffle}" for name, (_, shuffle) in FORMATS.items() if "_" not in name)
    table(f"Codecs, one thread, {CODEC_FRAMES} frames (stored as {stored})", rows)
    print(f"9 bits of attenuation: off by {kept:.5f} at most")


def reading(data: DataSet) -> None:
    """Print how fast crops come from disk, and what that does to memory."""
    pairs = data.pairs
    values = label_values(data.tissues, Encoding.echogenicity)
    crops = Crops(pairs, pairs.frames(Part.train), frozenset({"attenuation"}), values, CropSettings(), 0)
    rows = [("workers", "crops a second")]
    for workers in (0, 1, 2):
        arrived = [time.perf_counter() for _ in CropLoader(crops, 0, LOADER_BATCHES, workers)]
        rate = crops.settings.batch_size * (len(arrived) - 11) / (arrived[-1] - arrived[10])
        rows.append((str(workers), f"{rate:.0f}"))
    table(f"Crops of {CropSettings().size} in batches of {CropSettings().batch_size}, from a warm file cache", rows)

    rows = [("batches", "MiB resident")]
    resident = []
    for step, _ in enumerate(CropLoader(crops, 0, MEMORY_BATCHES, WORKERS)):
        if step % (MEMORY_BATCHES // 6) == MEMORY_BATCHES // 6 - 1:
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            resident.append(pages * resource.getpagesize() / 2**20)
            rows.append((f"{step + 1:,}", f"{resident[-1]:.0f}"))
    table("Memory", rows)
    slope = np.polyfit(np.arange(4), resident[2:], 1)[0] / (MEMORY_BATCHES // 6)
    print(f"{1e3 * slope:+.2f} MiB per 1,000 batches in the last two thirds; at 200 crops a second,", end=" ")
    print(f"{HOUR_BATCHES:,} batches are an hour")


def main() -> None:
    """Simulate, then measure on what was simulated."""
    torch.set_num_threads(1)
    frames = int(sys.argv[1]) if len(sys.argv) > 1 else FRAMES
    if frames < LEAST_FRAMES:
        sys.exit(f"{frames} frames are too few to tell a rate from; allowed are {LEAST_FRAMES} and more")
    print(hardware())
    with tempfile.TemporaryDirectory() as runs:
        changed = [f"dataset.frames={frames}", f"dataset.shard={SHARD}", f"dataset.workers={WORKERS}"]
        (job,) = jobs_of(["preset=paper", f"runs_dir={runs}", *changed])
        yardstick = Yardstick()
        yardstick.tick()
        data = simulated(job)
        yardstick.tick()
        codecs(job, data.pairs)
        yardstick.tick()
        reading(data)
        print(yardstick.line())


if __name__ == "__main__":
    main()
