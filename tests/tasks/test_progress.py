"""What `task=plan` expects, against times written down here."""

from pathlib import Path

import pytest
import torch

from ablate.command.compose import jobs_of
from ablate.storage import write_json
from ablate.study.job import Job, claim
from ablate.tasks.plan import progress, show_progress
from support.finished_runs import PARAMETERS
from support.finished_runs import finish as write_finished


def finish(job: Job, seconds: float | None) -> None:
    write_finished(job, scalars=PARAMETERS | ({} if seconds is None else {"train/seconds": seconds}))


@pytest.fixture
def jobs(tmp_path: Path) -> list[Job]:
    return jobs_of(["-m", "variant=sa2h,nsa2h,sa2h-att", "seed=0,1,2", f"runs_dir={tmp_path}", "training.steps=100"])


def test_nothing_is_known_before_the_first_run(jobs: list[Job]) -> None:
    table = progress(jobs)
    assert set(table["state"]) == {"missing"}
    assert table["seconds"].isna().all()


def test_time_is_the_median_of_the_label_or_of_the_study(jobs: list[Job]) -> None:
    sa2h, nsa2h, _ = jobs[:3], jobs[3:6], jobs[6:]
    finish(sa2h[0], 100.0)
    finish(sa2h[1], 140.0)
    finish(nsa2h[0], 30.0)
    finish(nsa2h[1], None)  # resumed: it tells no time
    claim(sa2h[2])
    torch.save({"steps_done": 75}, sa2h[2].folder / "last.ckpt")
    table = progress(jobs).set_index("job")
    assert table.loc["sa2h/seed2", ["state", "done", "seconds"]].tolist() == ["resumable", 0.75, 0.25 * 120]
    assert table.loc["nsa2h/seed2", ["state", "seconds"]].tolist() == ["missing", 30.0]
    assert table.loc["sa2h-att/seed0", "seconds"] == 100.0
    assert table.loc["sa2h/seed0", ["state", "seconds"]].tolist() == ["finished", 0.0]


def test_a_longer_training_takes_longer(jobs: list[Job], tmp_path: Path) -> None:
    finish(jobs[0], 50.0)
    longer = jobs_of(["variant=nsa2h", f"runs_dir={tmp_path}", "training.steps=400"])
    assert progress(longer)["seconds"].tolist() == [200.0]


def test_pairs_that_are_there_in_part_are_to_be_simulated(jobs: list[Job], capsys: pytest.CaptureFixture[str]) -> None:
    folder = jobs[0].data.folder
    (folder / "pairs.zarr").mkdir(parents=True)
    write_json(folder / "about.json", {"motions": ["lateral"]})  # those after motions are not there
    show_progress(jobs)
    assert f"data: {folder} (to be simulated)" in capsys.readouterr().out


def test_a_damaged_checkpoint_is_named_and_stops_nothing(jobs: list[Job], capsys: pytest.CaptureFixture[str]) -> None:
    claim(jobs[0])
    (jobs[0].folder / "last.ckpt").write_bytes(b"nothing")
    assert show_progress(jobs) == 0
    printed = capsys.readouterr()
    assert "last.ckpt: not a readable checkpoint" in printed.err
    assert printed.out.count(" unusable ") == 1
    assert printed.out.count(" missing ") == len(jobs) - 1
