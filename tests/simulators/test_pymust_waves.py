"""PyMUST as `scene.target`: three small frames, made twice, and what it shows of points, speckle and surfaces."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene, Structure, Tissue
from ablate.command.compose import jobs_of
from ablate.sources.prepare import prepare_data
from ablate.ultrasound import ConvexProbe, LinearProbe, OwnSimulator, OwnSimulatorError, Simulator, SimulatorSettings

pytest.importorskip("pymust", reason="PyMUST is not installed: pip install with the extra [compare]")
TARGET = "ablate.simulators.pymust_waves.diverging_waves"
PROBE = ConvexProbe(depth_mm=60.0, fov_deg=50.0, frequency_mhz=3.0)
SETTINGS = SimulatorSettings(
    scanlines=49, axial_samples=384, rays=4, layers=1, image_shape=(64, 64), axial_fwhm_mm=0.53, lateral_fwhm_mm=1.7,
    focus_mm=45.0, tgc_db_cm_mhz=0.0, noise_level_db=-300.0, scatterer_level_db=-40.0,
)  # fmt: skip
GEL = Tissue("gel", 1540, 1.5, 0.0, 0.0, 0.0, 0.0, roughness=0.0)
TISSUE = Tissue("tissue", 1540, 1.5, 0.0, 0.6, 0.0, 1.0, roughness=0.0)


def slab(tissue: Tissue, near_mm: float, far_mm: float) -> Structure:
    box = trimesh.creation.box((400, 400, far_mm - near_mm))
    return Structure(box.apply_translation((0, 0, (near_mm + far_mm) / 2)), tissue)


@pytest.fixture(scope="module")
def speckled() -> tuple[Simulator, OwnSimulator]:
    """Ours and PyMUST's of uniform speckle from 15 to 55 mm."""
    scene = Scene((slab(TISSUE, 15, 55),), GEL, "speckle")
    return Simulator(scene, PROBE, SETTINGS), OwnSimulator(TARGET, scene, PROBE, SETTINGS)


@pytest.fixture(scope="module")
def middle() -> Iterator[np.ndarray]:
    """Samples from 22 to 48 mm."""
    depth = (np.arange(384) + 0.5) * 60 / 384
    return (depth > 22) & (depth < 48)


@pytest.mark.slow
def test_its_speckle_is_as_bright_as_ours_and_of_the_same_scatterers(
    speckled: tuple[Simulator, OwnSimulator], middle: np.ndarray
) -> None:
    """Two programs that share no code put the same pattern at the same place, if places and phases are understood."""
    ours, theirs = speckled
    envelope = theirs.render(np.eye(4), seed=3).envelope[middle, 6:-6]
    same, other = (ours.render(np.eye(4), seed=seed).envelope[middle, 6:-6] for seed in (3, 4))
    assert 20 * np.log10(np.sqrt((envelope**2).mean() / (same**2).mean())) == pytest.approx(0, abs=1)
    assert envelope.mean() / envelope.std() == pytest.approx(1.91, abs=0.15), "fully developed"
    alike, unlike = (np.corrcoef(envelope.ravel(), image.ravel())[0, 1] for image in (same, other))
    assert alike > 0.7
    assert abs(unlike) < 0.15


@pytest.mark.slow
def test_a_surface_is_as_bright_as_ours_and_lies_where_ours_does() -> None:
    """A plate of another impedance, which scatters nothing, met face on in the middle of the fan."""
    plate = Tissue("plate", 1540, 1.6, 0.0, 0.0, 0.0, 0.0, roughness=0.0)
    scene = Scene((slab(plate, 40, 90),), GEL, "plate")
    settings = replace(SETTINGS, rays=64, scanlines=197)
    ours, theirs = Simulator(scene, PROBE, settings), OwnSimulator(TARGET, scene, PROBE, settings)
    expected, envelope = (simulator.render(np.eye(4)).envelope[:, 98] for simulator in (ours, theirs))
    assert abs(int(expected.argmax()) - int(envelope.argmax())) <= 2
    assert 20 * np.log10(envelope.max() / expected.max()) == pytest.approx(0, abs=3)


@pytest.mark.slow
def test_three_small_frames_are_a_data_set_and_the_same_again(tmp_path: Path) -> None:
    words = ["preset=tiny", f"scene.target={TARGET}", "dataset.frames=3", "dataset.shard=1", "dataset.grid=[3,1,1,1]"]
    words += ["dataset.workers=1", "probe.depth_mm=80", "simulator.scanlines=32", "simulator.axial_samples=256"]
    targets = []
    for folder in ("once", "again"):
        (job,) = jobs_of([*words, f"runs_dir={tmp_path / folder}"])
        pairs = prepare_data(job.settings, job.data, job.identity["data"], frozenset({"segmentation", "target"})).pairs
        assert len(pairs) == 3
        targets.append(pairs.stored("target", np.arange(3)))
    np.testing.assert_array_equal(*targets)
    inside = pairs.mask()
    for image in targets[0]:
        assert 20 < image[inside].mean() < 200
        assert image[inside].std() > 15
    assert np.abs(targets[0][0].astype(int) - targets[0][1]).mean() > 10, "another pose is another frame"


def test_another_kind_of_probe_is_refused() -> None:
    settings = replace(SETTINGS, scanlines=8, axial_samples=64)
    scene = Scene((slab(TISSUE, 15, 55),), GEL, "speckle")
    said = r"diverging_waves: fails: ValueError: probe\.kind=linear: allowed is convex"
    with pytest.raises(OwnSimulatorError, match=said):
        OwnSimulator(TARGET, scene, LinearProbe(), settings).image(np.eye(4))


def test_where_it_is_missing_the_message_says_how_it_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymust", None)
    scene = Scene((slab(TISSUE, 15, 55),), GEL, "speckle")
    with pytest.raises(OwnSimulatorError, match=r"PyMUST is not installed: pip install -e '\.\[compare\]'"):
        OwnSimulator(TARGET, scene, PROBE, replace(SETTINGS, axial_samples=64)).image(np.eye(4))
