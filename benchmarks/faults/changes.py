"""A byte of a scene is changed; of a training that was stopped the code, the precision or the number of threads is."""

import json
import random
import re
import shutil
import signal
import subprocess
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from faults.bench import STUDY, SWEEP, Bench, Fault, Round
from faults.canaries import repository
from faults.commands import Start, ablate, start
from faults.judge import last_step, result_files

_VARIANT = "sa2h"


@dataclass(frozen=True)
class Change:
    """Other arguments, or a change of a source file: of what `pattern` finds, or of any file where none is named."""

    name: str
    arguments: tuple[str, ...] = ()
    file: str = ""
    pattern: str = ""
    by: str = ""


_CHANGES = (
    Change("a loss", file="training/module.py", pattern=r"\(fake - image\)\.abs\(\)", by="(fake - image).square()"),
    Change("precision", ("training.precision=bf16",)),
    Change("threads", ("training.threads=2",)),
    Change("a metric", file="metrics/patches.py", pattern=r"PEAK = 255", by="PEAK = 254"),
    Change("a line of any source file"),
    Change("learning rate", ("training.learning_rate=0.003",)),
)


def changed(bench: Bench, rng: random.Random, number: int) -> Round:
    """Stop a training, change something, repeat the command. It is refused, begins anew or says what differs."""
    change = _CHANGES[number % len(_CHANGES)]
    runs = bench.runs()
    root = runs.parent / "repository"
    environment = {"PYTHONPATH": str(repository(root, "", is_own=True))}
    subprocess.run(["git", "-C", str(root), "checkout", "-q", "--", "."], check=True)
    words = [word for word in SWEEP if word != "-m" and not word.startswith("variant=")]
    line = [*words, f"variant={_VARIANT}", "training.threads=1", "training.precision=fp32", f"runs_dir={runs}"]
    folder = runs / STUDY / _VARIANT / "seed0"
    command, at = ablate(line, runs.parent, Start.cold, environment), rng.randrange(2, 30)
    command.wait_until(lambda: last_step(folder) >= at)
    command.signal(signal.SIGTERM)
    command.wait()
    before = last_step(folder)
    what = change.name if change.arguments else f"{change.name} ({_edit(root / 'src' / 'ablate', change, rng)})"
    ended = ablate([*line, *change.arguments], runs.parent, Start.cold, environment).wait()
    if ended.code:
        is_told = "Traceback" not in ended.said and bool(change.arguments)
        return Round([] if is_told else [f"{what}: exit code {ended.code}: {ended.said[-300:]}"])
    result = result_files(runs).get(f"{_VARIANT}/seed0", {})
    if not result.get("scalars", {}).get("train/resumed_at"):
        return Round([], count=int(before > 0))
    starts = folder / "provenance" / "starts.json"
    listed = len(json.loads(starts.read_text("utf-8"))["starts"]) if starts.exists() else 1
    is_told = "goes on with other" in ended.said and listed > 1
    return Round([] if is_told else [f"{what}: step {before} was resumed without a word"])


def _edit(source: Path, change: Change, rng: random.Random) -> str:
    """Change a source file; returns which."""
    if change.file:
        path = source / change.file
        text = path.read_text("utf-8")
        path.write_text(re.sub(change.pattern, change.by, text, count=1), "utf-8")
        if path.read_text("utf-8") == text:
            raise RuntimeError(f"{change.file} holds no {change.pattern}")
    else:
        path = rng.choice(sorted(source.rglob("*.py")))
        path.write_text(f"{path.read_text('utf-8')}\nCHANGED = {rng.random()}\n", "utf-8")
    shutil.rmtree(path.parent / "__pycache__", ignore_errors=True)
    return str(path.relative_to(source))


def scene_bytes(bench: Bench, _: random.Random, number: int) -> Round:
    """Change each byte of a scene folder with one mesh in turn; its pairs must be known by another hash."""
    place = bench.place()
    ended = start(_change_bytes, (place, number), place).wait()
    if ended.code:
        return Round([f"the process ended with {ended.code}: {ended.said[-300:]}"])
    found = json.loads((place / "found.json").read_text("utf-8"))
    return Round(found["wrong"], found["count"], is_last=found["is_last"])


def _change_bytes(place: Path, number: int) -> None:
    from ablate.jobs.compose import jobs_of

    from ablate.anatomy.scene_folder import MESH_SUFFIXES
    from ablate.settings.study import ConfigurationError, refusing
    from faults.attempts import write_mesh

    folder, suffix = place / "in", MESH_SUFFIXES[number]
    folder.mkdir()
    mesh = write_mesh(folder, number, suffix)
    about = f"structures: [{{mesh: {mesh}, tissue: fat}}]\nsites: {{heights: [0, 10], angles: [0, 20]}}\n"
    (folder / "scene.yaml").write_text(about)
    (job,) = jobs_of(["scene=folder", f"scene.folder={folder}", f"runs_dir={place / 'runs'}"])
    before, wrong, count = job.data.name, [], 0
    for path in sorted(folder.iterdir()):
        content = path.read_bytes()
        count += len(content)
        for at in range(len(content)):
            path.write_bytes(content[:at] + bytes([content[at] ^ 1 << at % 8]) + content[at + 1 :])
            with suppress(ConfigurationError), refusing():
                if replace(job).data.name == before:  # a job reads its scene once
                    wrong.append(f"{path.name}: byte {at} may be another")
        path.write_bytes(content)
    found = {"wrong": wrong, "count": count, "is_last": number + 1 == len(MESH_SUFFIXES)}
    (place / "found.json").write_text(json.dumps(found))


FAULTS = (
    Fault(
        "bytes",
        "each byte of a scene folder changed, with a mesh of each format",
        "the pairs have another hash, or the folder is refused",
        scene_bytes,
        10**6,
        1,
    ),
    Fault(
        "code",
        "a training stopped and repeated with another loss, metric, source line, precision, threads, learning rate",
        "refused by name, begun anew, or said: no silent resume",
        changed,
        3 * len(_CHANGES),
        0,
    ),
)
