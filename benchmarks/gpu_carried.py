"""What travels to a machine with a GPU: pairs, jobs and received signals as plain files, which NumPy alone reads.

`make_carried` runs where the whole project is installed. Reading needs neither Zarr, Hydra, trimesh, Embree nor Numba.
"""

import json
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ablate.anatomy import Tissue
from ablate.config import build
from ablate.dataset import CropSettings, Part
from ablate.dataset.map_formats import decode_attenuation
from ablate.networks import GeneratorSpec
from ablate.training import TrainingSettings
from ablate.ultrasound import ConvexProbe, SimulatorSettings
from ablate.ultrasound.imaging.signal_chain import Received

POSES = 2  # whose signals travel
WIDTHS = (1.0, 0.5, 0.25)
_MAPS = ("segmentation", "attenuation", "target")
_STUDY_SIZE, _TINY_SIZE = (512, 710), (64, 89)


@dataclass(frozen=True)
class CarriedPairs:
    """The part of `ablate.dataset.Pairs` that trainings and scores read, from one file."""

    folder: Path

    @cached_property
    def _arrays(self) -> dict[str, np.ndarray]:
        with np.load(self.folder / "pairs.npz") as file:
            return {name: file[name] for name in file.files}

    @property
    def maps(self) -> frozenset[str]:
        return frozenset(_MAPS)

    @property
    def sites(self) -> np.ndarray:
        return self._arrays["sites"]

    @property
    def shape(self) -> tuple[int, int]:
        height, width = self._arrays["mask"].shape
        return height, width

    def mask(self) -> np.ndarray:
        return self._arrays["mask"]

    def frames(self, part: Part) -> np.ndarray:
        return np.flatnonzero(self._arrays["split"] == part)

    def stored(self, name: str, frames: Any) -> np.ndarray:
        return self._arrays[name][np.asarray(frames)]

    def read(self, name: str, frames: Any) -> np.ndarray:
        stack = self._arrays[name][np.asarray(frames)]
        return decode_attenuation(stack) if stack.dtype == np.uint16 else stack

    @cached_property
    def about(self) -> dict[str, Any]:
        """Tissues and probe of the frames."""
        found: dict[str, Any] = json.loads((self.folder / "about.json").read_text())
        tissues = tuple(build(Tissue, tissue) for tissue in found["tissues"])
        return {"tissues": tissues, "probe": build(ConvexProbe, found["probe"])}


@dataclass(frozen=True)
class CarriedJob:
    """A training and what it reads."""

    name: str
    data: str
    spec: GeneratorSpec
    training: TrainingSettings
    crops: CropSettings
    workers: int
    values: np.ndarray  # (labels,) float32, what the network reads for a label


class Carried:
    """A folder made by `make_carried`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.about: dict[str, Any] = json.loads((folder / "carried.json").read_text())

    def jobs(self, group: str) -> list[CarriedJob]:
        """The trainings of a group, `study` or `paper`."""
        return [
            CarriedJob(
                name=job["name"],
                data=job["data"],
                spec=build(GeneratorSpec, job["spec"]),
                training=build(TrainingSettings, job["training"]),
                crops=CropSettings(**job["crops"]),
                workers=job["workers"],
                values=np.asarray(job["values"], np.float32),
            )
            for job in self.about["jobs"][group]
        ]

    def pairs(self, data: str) -> CarriedPairs:
        return CarriedPairs(self.folder / data)

    def signal(self, number: int) -> tuple[Received, np.ndarray, np.ndarray]:
        """What the rays of a pose bring back, the pose, and the image that the whole simulator makes of it."""
        with np.load(self.folder / f"signal_{number}.npz") as file:
            arrays = {name: file[name] for name in file.files}
        pose, image = arrays.pop("pose"), arrays.pop("image")
        return Received(**{"clutter": None, **arrays}), pose, image

    def simulation(self) -> tuple[tuple[Tissue, ...], ConvexProbe, SimulatorSettings]:
        """Tissues, probe and settings of the signals."""
        found = self.about["simulation"]
        tissues = tuple(build(Tissue, tissue) for tissue in found["tissues"])
        return tissues, build(ConvexProbe, found["probe"]), build(SimulatorSettings, found["settings"])


def make_carried(folder: Path, study_frames: int, paper_frames: int, tiny: bool) -> None:
    """Simulate and write everything that travels; `tiny` sizes are for a dry run on a CPU."""
    folder.mkdir(parents=True, exist_ok=True)
    size = _TINY_SIZE if tiny else _STUDY_SIZE
    small = (
        ["scene.triangles=6000", "dataset.workers=1", "simulator.rays=2", "training.steps=2", "model.width=0.05"]
        if tiny
        else []
    )
    study = [f"dataset.frames={study_frames}", f"simulator.image_shape=[{size[0]},{size[1]}]", "training.threads=0"]
    paper = ["preset=paper", f"dataset.frames={paper_frames}", "dataset.split=frame", "dataset.shard=1"]
    paper += ["simulator.image_shape=[64,89]", "training.batch_size=2"] if tiny else []
    with tempfile.TemporaryDirectory() as runs:
        common = [*small, f"runs_dir={runs}"]
        jobs = {
            "study": _jobs(folder, ["+study=answer", *study, *common], 2 if tiny else None),
            "paper": _jobs(folder, ["-m", "variant=sa2h,sa2h-att", *paper, *common], None),
        }
    about = {
        "jobs": jobs,
        "simulation": _signals(folder, tiny),
        "tiny": tiny,
        "size": (64, 90) if tiny else (1000, 1386),
    }
    about |= {"widths": (0.05,) if tiny else WIDTHS, "signals": POSES, "made": time.strftime("%Y-%m-%d")}
    (folder / "carried.json").write_text(json.dumps(about, default=str))


def _jobs(folder: Path, arguments: list[str], most: int | None) -> list[dict[str, Any]]:
    """Compose jobs, simulate their pairs and write them."""
    from ablate.dataset import label_values
    from ablate.studies.jobs.compose import jobs_of
    from ablate.studies.pairs.data import dataset_folder, maps_needed, prepare_data

    written = []
    for job in jobs_of(arguments)[:most]:
        s, name = job.settings, dataset_folder(job.settings).name
        data = prepare_data(s, maps_needed([s.model]) | {"attenuation"})
        if not (folder / name).exists():
            _write_pairs(folder / name, data.pairs, data.tissues, s.probe)
        crops = CropSettings(s.training.crop, s.training.batch_size, s.crops.fan_fraction, s.crops.flip, s.seed)
        training = replace(s.training, validate_every=0, checkpoint_every=max(s.training.steps // 4, 1), device="auto")
        values = label_values(data.tissues, s.encoding, s.encoding_seed).tolist()
        what = {"spec": asdict(s.model), "training": asdict(training), "crops": asdict(crops), "values": values}
        written.append({"name": job.name.replace("/", "-"), "data": name, "workers": s.crops.workers, **what})
    return written


def _write_pairs(folder: Path, pairs: Any, tissues: tuple[Tissue, ...], probe: ConvexProbe) -> None:
    folder.mkdir()
    stacks = {name: pairs.stored(name, range(len(pairs))) for name in _MAPS}
    stacks |= {"mask": pairs.mask(), "sites": pairs.sites, "split": pairs.split}
    np.savez_compressed(folder / "pairs.npz", **stacks)
    about = {"tissues": [asdict(tissue) for tissue in tissues], "probe": asdict(probe)}
    (folder / "about.json").write_text(json.dumps(about))


def _signals(folder: Path, tiny: bool) -> dict[str, Any]:
    """Write what some poses bring back at the paper's size, with their images."""
    from ablate.anatomy import fetal_abdomen, fetal_sites
    from ablate.dataset import probe_poses
    from ablate.ultrasound import Simulator

    scene, probe, settings = fetal_abdomen(triangles=6000 if tiny else 675_000), ConvexProbe(), SimulatorSettings()
    if tiny:
        settings = replace(settings, scanlines=24, axial_samples=256, rays=2, image_shape=(64, 89))
    poses = [pose.probe_to_world for pose in probe_poses(scene, fetal_sites(), 8)]
    simulator = Simulator(scene, probe, settings)
    for number in range(POSES):
        pose = poses[number * (len(poses) - 1) // POSES]
        arrays = {"pose": pose, "image": simulator.image(pose)}
        for name, values in vars(simulator.received(pose)).items():
            if values is not None:  # float32, as the signal chain computes; places stay exact
                narrow = name in ("surfaces", "clutter") or values.dtype == np.float32
                arrays[name] = values.astype(np.float32) if narrow else values
        np.savez_compressed(folder / f"signal_{number}.npz", **arrays)
    tissues = [asdict(tissue) for tissue in scene.tissues]
    return {"tissues": tissues, "probe": asdict(probe), "settings": asdict(settings)}
