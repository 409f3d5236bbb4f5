"""A worker ends when its parent is killed; how many there are."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ablate.dataset.processes import allotted_cores

PARENT = """
import multiprocessing, os, sys, time

def work(path):
    from ablate.dataset.processes import end_with_parent
    if IMPORTS_S == 0:
        end_with_parent()
    open(path, "w").write(str(os.getpid()))
    time.sleep(IMPORTS_S)
    end_with_parent()
    time.sleep(120)

if __name__ == "__main__":
    process = multiprocessing.get_context("spawn").Process(target=work, args=(sys.argv[1],))
    process.start()
    process.join()
"""


def alive(pid: int) -> bool:
    status = Path(f"/proc/{pid}/stat")
    return status.exists() and status.read_text().rpartition(")")[2].split()[0] != "Z"


@pytest.mark.parametrize("imports_s", [0, 2], ids=["at work", "while it imports"])
def test_a_worker_ends_when_its_parent_is_killed(tmp_path: Path, imports_s: int) -> None:
    """Also where it asks for its parent when that is gone: imports may take longer than the parent lives."""
    script, told = tmp_path / "parent.py", tmp_path / "pid"
    script.write_text(PARENT.replace("IMPORTS_S", str(imports_s)))
    parent = subprocess.Popen([sys.executable, script, told])
    deadline = time.monotonic() + 60
    while not (told.exists() and told.read_text()) and time.monotonic() < deadline:
        time.sleep(0.02)
    worker = int(told.read_text())
    assert alive(worker)
    os.kill(parent.pid, signal.SIGKILL)
    parent.wait()
    while alive(worker) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not alive(worker)


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="the system binds no process to cores")
def test_cores_are_those_that_the_process_is_bound_to() -> None:
    everywhere = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(everywhere)})
        assert allotted_cores() == 1
    finally:
        os.sched_setaffinity(0, everywhere)


# A thread that is left inside of torch or Arrow as the process ends: `sys.exit` aborts there, or hangs.
LEFT = """
import sys, threading
from ablate.dataset.processes import end_process, start_beside

def torch_work():
    import torch
    torch.set_num_threads(1)
    numbers = torch.ones(300, 300)
    at_work.set()
    while True:
        numbers @ numbers

def arrow_work():
    import io, pandas as pd
    file = io.BytesIO()
    pd.DataFrame({"a": range(1000)}).to_parquet(file)
    pd.read_parquet(io.BytesIO(file.getvalue()))
    at_work.set()
    while True:
        pd.read_parquet(io.BytesIO(file.getvalue()))

at_work = threading.Event()
start_beside(locals()[sys.argv[1]])
at_work.wait()
threading.Event().wait(0.2)
print("all is told")
end_process({"none": None, "three": 3, "words": "ablate: interrupted"}[sys.argv[2]])
"""


@pytest.mark.parametrize(("code", "status"), [("none", 0), ("three", 3), ("words", 1)])
@pytest.mark.parametrize("work", ["torch_work", "arrow_work"])
def test_a_process_ends_with_its_own_status_whatever_a_thread_beside_it_does(work: str, code: str, status: int) -> None:
    ended = subprocess.run([sys.executable, "-c", LEFT, work, code], capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stdout) == (status, "all is told\n"), ended.stderr
    assert ended.stderr.strip() == ("ablate: interrupted" if code == "words" else "")
