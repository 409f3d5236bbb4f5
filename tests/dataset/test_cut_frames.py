"""Frames that are cut off where a volume ends, against the labels that the simulator finds there."""

from pathlib import Path

import nibabel
import numpy as np
import pytest
import yaml

from ablate.anatomy import Scene, load_scene
from ablate.dataset.cut_frames import cut_frames, cut_share
from ablate.ultrasound import LinearProbe, Simulator, SimulatorSettings

PROBE = LinearProbe(width_mm=40, depth_mm=60)
MM = 2.0


def cylinder(folder: Path) -> Scene:
    """A body along z that the volume cuts at both ends, at z of -1 and 99 mm, of 60 mm radius."""
    x, y, _ = np.indices((70, 70, 50))
    values = (np.hypot(x - 34.5, y - 34.5) < 30).astype(np.uint8)
    affine = np.diag([MM, MM, MM, 1.0])
    affine[:2, 3] = -34.5 * MM
    nibabel.save(nibabel.Nifti1Image(values, affine), folder / "labels.nii.gz")
    content = {"labels": {"file": "labels.nii.gz", "tissues": {1: "liver"}}}
    (folder / "scene.yaml").write_text(yaml.safe_dump(content))
    return load_scene(folder)


def sagittal(z_mm: float) -> np.ndarray:
    """A probe on the front of the body whose scanlines lie along z."""
    pose = np.eye(4)
    pose[:3, :3] = np.array([[0, 0, 1.0], [1.0, 0, 0], [0, 1.0, 0]]).T  # x of the probe along z, its beam along y
    pose[:3, 3] = 0, -58, z_mm
    return pose


def test_the_share_beyond_the_end_is_that_of_the_background_in_the_segmentation(tmp_path: Path) -> None:
    scene = cylinder(tmp_path)
    assert len(scene.end_walls) == 2, "its sides lie within the volume"
    simulator = Simulator(scene, PROBE, SimulatorSettings.low_quality(image_shape=(120, 80)))
    for z_mm in (5.0, 50.0, 84.0, 95.0):
        labels = simulator.maps(sagittal(z_mm))[0]
        assert abs(cut_share(scene, PROBE, sagittal(z_mm)) - (labels == 1).mean()) < 0.04
    said = cut_frames(scene, PROBE, [sagittal(z_mm) for z_mm in (5.0, 50.0, 84.0)])
    assert said.startswith("2 of 3 frames are cut off straight where the volume ends")
    assert said.endswith("behind it is only coupling_gel: 0, 2")
    assert cut_frames(scene, PROBE, [sagittal(50.0)]) == ""


def test_the_end_moves_with_the_body(tmp_path: Path) -> None:
    scene, motion = cylinder(tmp_path), np.eye(4)
    motion[:3, 3] = 7, -3, 25
    pose = sagittal(90.0)
    assert cut_share(scene, PROBE, pose) > 0.1
    assert cut_share(scene.moved(motion), PROBE, motion @ pose) == pytest.approx(
        cut_share(scene, PROBE, pose), abs=0.02
    )
    assert cut_share(scene.moved(motion), PROBE, pose) == 0
