"""What a machine does while a run is trained: in the log of the run, and on the page of the store."""

import threading
import time
from pathlib import Path

import psutil
import pytest

from ablate.jobs import preflight
from ablate.jobs.compose import jobs_of
from ablate.tracking import LocalLog, StoredRun, open_store, parent_run, read_log, system_metrics
from ablate.tracking.local_log import points


def sampled(folder: Path, seconds: float) -> None:
    with system_metrics(folder, LocalLog(folder), every_s=0.05):
        time.sleep(seconds)


def test_samples_are_those_of_the_machine_and_a_resumed_run_goes_on_counting(runs: Path, tmp_path: Path) -> None:
    before = threading.active_count()
    sampled(tmp_path, 0.4)
    first = [p for p in points(read_log(tmp_path)[0]) if p.key == "system/system_memory_usage_percentage"]
    assert len(first) >= 2
    assert first[-1].value == pytest.approx(psutil.virtual_memory().percent, abs=20)
    sampled(tmp_path, 0.2)
    assert threading.active_count() == before, "a sampler that goes on"
    every = [p for p in points(read_log(tmp_path)[0]) if p.key == "system/cpu_utilization_percentage"]
    assert [p.step for p in every] == list(range(len(every)))
    assert len(every) > len(first)
    assert all(0 <= p.value <= 100 for p in every)
    store = open_store(runs, None, "ablate")
    run = StoredRun(store, parent_run(store, "study"))
    run.copy_log(tmp_path)
    kept = store.client.get_metric_history(run.run_id, "system/cpu_utilization_percentage")
    assert [(p.step, p.value) for p in kept] == [(p.step, p.value) for p in every]


def test_without_psutil_the_package_to_install_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    jobs = jobs_of(["preset=tiny", f"runs_dir={tmp_path}", "tracking.system_metrics=true"])
    preflight.check(jobs)
    monkeypatch.setattr(preflight, "find_spec", lambda _: None)
    with pytest.raises(ValueError, match=r"psutil: pip install 'ablate-ultrasound\[system\]'"):
        preflight.check(jobs)
