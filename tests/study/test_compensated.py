"""A variant that reads the compensated attenuation: trained and scored on pairs that another variant made."""

import shutil
from pathlib import Path

import numpy as np

from ablate.command.compose import jobs_of
from ablate.dataset import Part
from ablate.networks import Attenuation
from ablate.sources.source import source_of
from ablate.study.run import run_of
from ablate.study.work import do
from ablate.ultrasound import TimeGain, compensated_attenuation, with_patient_gain
from support.studies import TINY, TinyStudy


def test_it_reads_what_the_frames_were_simulated_with_and_is_scored(tiny_study: TinyStudy, runs: Path) -> None:
    shutil.copytree(tiny_study.runs / "data", runs / "data")
    before = {p: p.stat().st_mtime_ns for p in runs.glob("data/*/pairs.zarr/**/*")}
    (job,) = jobs_of([*TINY, "variant=sa2h-compensated", f"runs_dir={runs}"])
    do(job)
    assert {p: p.stat().st_mtime_ns for p in runs.glob("data/*/pairs.zarr/**/*")} == before
    assert job.training.settings.model.attenuation is Attenuation.compensated
    assert "test/shadow_contrast" in run_of(job).scalars
    pairs, settings = job.data.pairs, job.settings
    training, (scene, _) = pairs.poses[pairs.frames(Part.train)], source_of(settings).scene()
    gain = with_patient_gain(scene, settings.probe, settings.simulator, training).time_gain_db
    assert settings.simulator.tgc is TimeGain.patient
    assert gain == pairs.simulator.time_gain_db == job.data.time_gain_db
    frames = pairs.frames(Part.test)
    limited = pairs.simulator.time_gain
    expected = compensated_attenuation(pairs.read("attenuation", frames), settings.probe, limited)
    np.testing.assert_allclose(pairs.read("compensated", frames), expected, atol=0.6 / 65535)
