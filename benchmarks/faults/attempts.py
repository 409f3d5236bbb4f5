"""One damaged input after another, of each kind, and the part of the program that reads it."""

import json
import random
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from faults.bench import STUDY, SWEEP, VARIANTS
from faults.mutations import bytes_of, name, tree_of

if TYPE_CHECKING:
    import trimesh
    from ablate.runs.job import Job

# Damages an input and reads it; what is refused is a ConfigurationError.
Attempt = Callable[[random.Random], None]
_SIMULATED = 0.02  # share of the folders that are taken which are also simulated
_TINY = ("preset=tiny", "simulator.image_shape=[96,134]", "dataset.frames=4", "dataset.grid=[2,2,1,1]")


def _job(*arguments: str) -> "Job":
    from ablate.jobs.compose import jobs_of

    return jobs_of(arguments)[0]


def _scenes(_: Path, place: Path) -> Attempt:
    """A scene.yaml, its text or its values."""
    import yaml

    _write_meshes(place / "in")
    job = _job(*_TINY, "scene=folder", f"scene.folder={place / 'in'}", f"runs_dir={place / 'runs'}", "task=simulate")
    good = {
        "unit": "mm",
        "background": "coupling_gel",
        "structures": [{"mesh": "0.obj", "tissue": "fat"}, {"mesh": "1.stl", "tissue": "graft"}],
        "tissues": {"graft": {"speed_m_s": 1600, "texture_mm": [1, 2, 3]}, "fat": {"scatterer_sd": 0.5}},
        "sites": {
            "axis": [0, 0, 1],
            "front": [0, -1, 0],
            "heights": {"range": [-20, 20], "count": 3},
            "angles": [0, 20],
        },
    }

    def attempt(rng: random.Random) -> None:
        if rng.random() < 0.5:
            content = bytes_of(rng, yaml.safe_dump(good).encode())
        else:
            content = yaml.safe_dump(tree_of(rng, good), allow_unicode=True).encode()
        (place / "in" / "scene.yaml").write_bytes(content)
        _load_scene(job, rng)

    return attempt


def _meshes(_: Path, place: Path) -> Attempt:
    """The bytes of a mesh, of each format."""
    _write_meshes(place / "in")
    files = {path: path.read_bytes() for path in sorted((place / "in").iterdir())}
    job = _job(*_TINY, "scene=folder", f"scene.folder={place / 'in'}", f"runs_dir={place / 'runs'}", "task=simulate")

    def attempt(rng: random.Random) -> None:
        victim = rng.choice(list(files))
        mesh = next(path for path in files if path.suffix == ".gltf") if victim.suffix == ".bin" else victim
        (place / "in" / "scene.yaml").write_text(
            f"structures: [{{mesh: {mesh.name}, tissue: fat}}]\nsites: {{heights: [0, 10], angles: [0, 20]}}\n"
        )
        victim.write_bytes(bytes_of(rng, files[victim]))
        try:
            _load_scene(job, rng)
        finally:
            victim.write_bytes(files[victim])

    return attempt


def _write_meshes(folder: Path) -> None:
    from ablate.anatomy.scene_folder import MESH_SUFFIXES

    for number, suffix in enumerate(MESH_SUFFIXES):
        write_mesh(folder, number, suffix)


def _through_vtk(mesh: "trimesh.Trimesh", path: Path) -> None:
    """Write a mesh in one of VTK's own formats, by VTK."""
    from vtkmodules.vtkIOGeometry import vtkSTLReader
    from vtkmodules.vtkIOLegacy import vtkPolyDataWriter
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

    beside = path.with_suffix(".made.stl")
    mesh.export(beside)
    reader, writer = vtkSTLReader(), vtkPolyDataWriter() if path.suffix == ".vtk" else vtkXMLPolyDataWriter()
    reader.SetFileName(str(beside))
    writer.SetInputConnection(reader.GetOutputPort())
    writer.SetFileName(str(path))
    writer.Write()
    beside.unlink()


def write_mesh(folder: Path, number: int, suffix: str) -> str:
    """Write a box or a sphere in a format, named by its number; a glTF has its buffers beside it. Returns its name."""
    import trimesh

    from ablate.anatomy.meshes.vtk_files import VTK_SUFFIXES

    mesh = trimesh.creation.box((60 + number, 60, 60)) if number % 2 else trimesh.creation.icosphere(1, 40)
    name = f"{number}{suffix}"
    if suffix in VTK_SUFFIXES:
        _through_vtk(mesh, folder / name)
        return name
    made = mesh.export(file_type=suffix[1:])
    if isinstance(made, dict):  # glTF beside its buffers
        for file, content in made.items():
            (folder / (name if file.endswith(".gltf") else file)).write_bytes(content)
    else:
        (folder / name).write_bytes(made.encode() if isinstance(made, str) else made)
    return name


def _load_scene(job: "Job", rng: random.Random) -> None:
    """Check and load as a simulation does, and now and then simulate."""
    from ablate.jobs.preflight import check

    from ablate.anatomy import load_scene, load_sites
    from ablate.settings.study import refusing

    check([job])
    with refusing():
        load_scene(str(job.settings.scene.folder))
        load_sites(str(job.settings.scene.folder))
        if rng.random() < _SIMULATED:
            _prepare(job)


def _prepare(job: "Job") -> None:
    from ablate.runs.data_set import maps_needed
    from ablate.runs.prepare import prepare_data

    prepare_data(job, maps_needed([job.settings.model]))


def _pngs(unbroken: Path, place: Path) -> Attempt:
    """The bytes of a PNG, of labels.csv or of frames.csv, of pairs that were made elsewhere."""
    import numpy as np
    from ablate.jobs.preflight import check
    from ablate.runs.data_set import DataSet
    from skimage.io import imsave

    from ablate.dataset import Part
    from ablate.settings.study import refusing

    pairs = DataSet(next(unbroken.glob("data/*/about.json")).parent).pairs
    for map_name, folder in {"segmentation": "segmentation", "target": "image", "attenuation": "attenuation"}.items():
        (place / "in" / folder).mkdir()
        for i in range(len(pairs)):
            image = pairs.read(map_name, [i])[0]
            if map_name == "attenuation":
                image = np.rint(image.astype(np.float64) * 65535).astype(np.uint16)
            imsave(place / "in" / folder / f"{i}.png", image, check_contrast=False)
    rows = [
        f"{i},{site},{Part(part).name}" for i, (site, part) in enumerate(zip(pairs.sites, pairs.split, strict=True))
    ]
    (place / "in" / "frames.csv").write_text("\n".join(["name,site,part", *rows]))
    labels = [f"{i},{tissue}" for i, tissue in enumerate(pairs.tissues, start=1)]
    (place / "in" / "labels.csv").write_text("\n".join(["label,tissue", *labels]))
    files = {path: path.read_bytes() for path in sorted((place / "in").rglob("*.*"))}
    job = _job(
        "preset=tiny", "scene=pairs", f"scene.folder={place / 'in'}", f"runs_dir={place / 'runs'}", "task=simulate"
    )

    def attempt(rng: random.Random) -> None:
        victim = rng.choice([*files, *[path for path in files if path.suffix == ".csv"] * 5])
        victim.write_bytes(bytes_of(rng, files[victim]))
        try:
            check([job])
            with refusing():
                _prepare(job)
        finally:
            victim.write_bytes(files[victim])
            shutil.rmtree(place / "runs" / "data", ignore_errors=True)

    return attempt


def _run_files(*names: str) -> Callable[[Path, Path], Attempt]:
    def made(unbroken: Path, place: Path) -> Attempt:
        """Files of a finished run, as `task=plan` and `task=compare` read them."""
        for folder in ("data", STUDY):
            shutil.copytree(unbroken / folder, place / "runs" / folder)
        job = _job(*SWEEP, f"runs_dir={place / 'runs'}", "task=compare")
        folders = [place / "runs" / STUDY / variant / "seed0" for variant in VARIANTS]
        files = {folder / file: (folder / file).read_bytes() for folder in folders for file in names}

        def attempt(rng: random.Random) -> None:
            victim = rng.choice(list(files))
            if victim.suffix == ".json" and rng.random() < 0.7:
                content = json.dumps(tree_of(rng, json.loads(files[victim]))).encode()
            else:
                content = bytes_of(rng, files[victim])
            victim.write_bytes(content)
            try:
                _read_study(job)
            finally:
                victim.write_bytes(files[victim])

        return attempt

    return made


def _read_study(job: "Job") -> None:
    """What `task=plan` and `task=compare` read of a study, without figures and without MLflow."""
    from ablate.comparison.reading import answers, pictures, provenance, scored_frames
    from ablate.comparison.usable_runs import usable_runs
    from ablate.jobs.preflight import check

    from ablate.analysis import cautions
    from ablate.tasks.plan import show_progress

    check([job])
    show_progress([job])
    usable = usable_runs(job.settings.study_dir, job.settings.reference)
    if usable.runs:
        per_image, _ = scored_frames(usable.runs)
        answers(usable.all, job.settings.reference)
        with suppress(OSError, ValueError, KeyError):  # as `write_comparison` does
            pictures(usable.runs, job.settings.reference)
        provenance(usable.all), cautions(per_image, job.settings.reference)


def _scene_caches(_: Path, place: Path) -> Attempt:
    """The cache of a built scene: read, or built again; never another scene."""
    import numpy as np

    from ablate.anatomy import load_scene
    from ablate.anatomy.scene import cached_scene

    _write_meshes(place / "in")
    (place / "in" / "scene.yaml").write_text("structures: [{mesh: 0.obj, tissue: fat}]\n")
    scene = load_scene(place / "in")
    cached_scene(place / "runs", lambda: scene, seed=0)
    (path,) = (place / "runs").glob("scene-*.npz")
    whole = path.read_bytes()

    def attempt(rng: random.Random) -> None:
        path.write_bytes(bytes_of(rng, whole))
        for own, there in zip(
            scene.structures, cached_scene(place / "runs", lambda: scene, seed=0).structures, strict=True
        ):
            if own.tissue != there.tissue or not np.array_equal(own.mesh.triangles, there.mesh.triangles):
                raise AssertionError("another scene came out of the cache")

    return attempt


def _names(_: Path, place: Path) -> Attempt:
    """Names on the command line, composed and checked."""
    from ablate.jobs.compose import jobs_of
    from ablate.jobs.preflight import check

    keys = ("study_name", "variant", "reference", "metrics", "tracking.experiment", "scene.folder")

    def attempt(rng: random.Random) -> None:
        word = f"{rng.choice(keys)}={name(rng)}"
        arguments = [*_TINY, f"runs_dir={place / 'runs'}", "task=plan", word]
        if word.startswith("scene.folder"):
            arguments.append("scene=folder")
        check(jobs_of(arguments))

    return attempt


KINDS: dict[str, Callable[[Path, Path], Attempt]] = {
    "scene.yaml": _scenes,
    "mesh": _meshes,
    "PNG and its tables": _pngs,
    "npz": _run_files("pictures.npz"),
    "scene cache": _scene_caches,
    "result.json": _run_files("result.json"),
    "spec.json": _run_files("spec.json"),
    "name": _names,
}
