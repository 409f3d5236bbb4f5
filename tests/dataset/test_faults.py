"""Killed at any moment, out of disk: what is there is whole, and the same call finishes the rest."""

import multiprocessing
import pickle
import random
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from ablate.dataset import Pairs, Recipe, remove_damaged, simulate_pairs

Blank = Callable[..., Pairs]
Contents = Callable[[Path], dict[str, bytes]]
MAPS = frozenset({"segmentation", "attenuation", "target", "resimulation"})
KILLS = 4


def shards(pairs: Pairs) -> dict[Path, tuple[int, int]]:
    """Inode and modification time of every shard."""
    files = [path for name in MAPS for path in pairs.folder.glob(f"pairs.zarr/{name}/c/*/0/0")]
    return {path: (path.stat().st_ino, path.stat().st_mtime_ns) for path in files}


@pytest.mark.slow
def test_killed_again_and_again_the_set_is_that_of_one_go(
    tmp_path: Path, recipe: Recipe, blank: Blank, contents: Contents
) -> None:
    whole = blank(tmp_path / "whole", 120, 3)
    simulate_pairs(recipe, whole, MAPS, 1)
    pairs = blank(tmp_path / "killed", 120, 3)
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["ablate.dataset.simulate"])
    rng = random.Random(0)

    def start() -> multiprocessing.process.BaseProcess:
        process = context.Process(target=simulate_pairs, args=(recipe, pairs, MAPS, 1))
        process.start()
        return process

    running = [start(), start()]
    compared: set[Path] = set()
    for kill in range(KILLS):
        wanted = 8 * kill + rng.randrange(10)  # of the 160 that will be
        while len(shards(pairs)) < wanted:
            assert any(process.is_alive() for process in running)
            time.sleep(0.01)
        time.sleep(rng.uniform(0.0, 0.05))
        victim = rng.randrange(2)
        before = shards(pairs)
        running[victim].kill()
        running[victim].join()
        assert running[victim].exitcode == -9, "the set was full before the last kill"
        after = shards(pairs)
        assert before.items() <= after.items()  # nothing that was finished is lost or made again
        for path in after.keys() - compared:  # those compared before have not changed since
            pairs.stored(path.parents[3].name, pairs.frames_of_shard(int(path.parents[1].name)))
        compared |= after.keys()
        running[victim] = start()
    for process in running:
        process.join()
        assert process.exitcode == 0
    assert remove_damaged(pairs, MAPS) == ()
    assert contents(pairs.folder) == contents(whole.folder)


def test_a_worker_that_is_killed_is_reported_and_the_rest_is_kept(tmp_path: Path, recipe: Recipe, blank: Blank) -> None:
    pairs = blank(tmp_path / "set", 900, 3)
    errors: list[BaseException] = []

    def fill() -> None:
        try:
            simulate_pairs(recipe, pairs, MAPS, 2)
        except RuntimeError as error:
            errors.append(error)

    thread = threading.Thread(target=fill)
    thread.start()
    while len(shards(pairs)) < 5:
        time.sleep(0.05)
    multiprocessing.active_children()[0].kill()
    thread.join()
    assert "SIGKILL" in str(errors[0])
    assert not multiprocessing.active_children()
    assert remove_damaged(pairs, MAPS) == ()
    assert len(list(pairs.folder.rglob("*.partial"))) <= 1  # of the one that was killed; the next to make it removes it


FULL_DISK = """
import pickle, sys
from pathlib import Path
from ablate.dataset import open_pairs, remove_damaged, simulate_pairs

if __name__ == "__main__":
    folder, maps = Path(sys.argv[1]), frozenset({"segmentation", "attenuation", "target", "resimulation"})
    recipe = pickle.loads(Path(sys.argv[2]).read_bytes())
    pairs = open_pairs(folder / "set")
    try:
        simulate_pairs(recipe, pairs, maps, int(sys.argv[3]))
    except OSError as error:
        print("stopped:", error)
    print("missing:", len(pairs.missing(maps)))
    print("half-written:", [str(p) for p in folder.rglob("*.partial")])
    print("damaged:", remove_damaged(pairs, maps))
    (folder / "ballast").unlink()
    simulate_pairs(recipe, pairs, maps, 1)
    print("then missing:", len(pairs.missing(maps)))
"""


@pytest.mark.slow
def test_a_full_disk_stops_with_its_name_and_nothing_half_written(tmp_path: Path, recipe: Recipe, blank: Blank) -> None:
    """On a file system of its own, in a mount namespace that ends with the command."""
    room = tmp_path / "room"
    room.mkdir()
    mount = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c"]
    disk = f"mount -t tmpfs -o size=1M tmpfs {room}"
    if not shutil.which("unshare") or subprocess.run([*mount, disk], capture_output=True, check=False).returncode:
        pytest.skip("file systems cannot be mounted here")
    laid_out = blank(tmp_path / "set", 60, 3).folder
    (tmp_path / "fill.py").write_text(FULL_DISK)
    (tmp_path / "recipe").write_bytes(pickle.dumps(recipe))
    fill = f"{sys.executable} {tmp_path}/fill.py {room} {tmp_path}/recipe 2"
    ballast = f"cp -r {laid_out} {room} && head -c 800000 /dev/zero > {room}/ballast"
    done = subprocess.run([*mount, f"{disk} && {ballast} && {fill}"], capture_output=True, text=True, check=False)
    printed = dict(line.split(": ", 1) for line in done.stdout.splitlines())
    assert done.returncode == 0, done.stderr
    assert "No space left on device" in printed["stopped"]
    assert "of frames" in printed["stopped"]
    assert 0 < int(printed["missing"]) < 20
    assert (printed["half-written"], printed["damaged"], printed["then missing"]) == ("[]", "()", "0")
