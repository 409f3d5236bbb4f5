"""What a change of structure must not change: frames, weights, scores and the tables of a comparison.

python scripts/unchanged.py record FOLDER            # with the code of this checkout
python scripts/unchanged.py record FOLDER --code DIR # with the code of another checkout of this project
python scripts/unchanged.py compare BEFORE AFTER     # what differs; exit code 1 where something does

Everything is computed with one thread and fixed seeds, so equal code gives equal bits. Only the public surface of the
package is used, so the script records a checkout from before a change and from after it.
"""

import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

ROOT = Path(__file__).resolve().parents[1]
VARIANTS = "sa2h,sa2h-att,sa2h-conv,nsa2h"
TINY = ["preset=tiny", "simulator.image_shape=[256,355]", "training.threads=1"]
TIMES = re.compile(r"ms_per_frame|seconds|resumed|^ms$")  # measured, never equal twice


def record(folder: Path, code: Path) -> None:
    """Compute everything that is compared by the checkout `code`, into `folder`; what is there is replaced."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    environment = {
        **os.environ,
        "PYTHONPATH": str(code / "src"),
        "OMP_NUM_THREADS": "1",
        "COLUMNS": "200",
        "MLFLOW_DISABLE_TELEMETRY": "true",
    }

    def must(*command: str) -> str:
        done = subprocess.run(
            [sys.executable, *command], capture_output=True, text=True, check=False, env=environment, cwd=folder
        )
        if done.returncode:
            sys.exit(f"{' '.join(command)} failed:\n{done.stderr}")
        return done.stdout

    print("frames ...", flush=True)
    must(str(Path(__file__).resolve()), "frames", str(folder / "frames.npz"))
    print("runs ...", flush=True)
    must("-m", "ablate", "-m", f"variant={VARIANTS}", "runs_dir=runs", "study_name=tiny", *TINY)
    weights = {}
    for checkpoint in sorted((folder / "runs" / "tiny").rglob("last.ckpt")):
        label = checkpoint.parent.name.rpartition("-")[0]
        weights[label] = must(str(Path(__file__).resolve()), "weights", str(checkpoint)).splitlines()
    (folder / "weights.json").write_text(json.dumps(weights, indent=1))
    for kept in sorted(path for path in (code / "docs" / "results").iterdir() if path.is_dir()):
        print(f"comparison of the kept study {kept.name} ...", flush=True)
        shutil.copytree(kept, folder / "runs" / kept.name)
        must("-m", "ablate", "task=compare", f"study_name={kept.name}", "runs_dir=runs")
    print("stability ...", flush=True)
    must("-m", "ablate", "task=stability", "runs_dir=runs")


def frames(path: Path) -> None:
    """Every map of a frame of solids that overlap and of the built-in anatomy, at high and at low quality."""
    import torch
    import trimesh

    from ablate.anatomy import Scene, Structure, fetal_abdomen, fetal_planes, load_tissues
    from ablate.ultrasound import ConvexProbe, Simulator, SimulatorSettings

    torch.set_num_threads(1)
    tissues = load_tissues()

    def ball(name: str, depth_mm: float, radius_mm: float) -> Structure:
        mesh = trimesh.creation.icosphere(4, radius_mm)
        mesh.apply_translation((0.0, 0.0, depth_mm))
        return Structure(mesh, tissues[name])

    balls = (ball("liver", 63.0, 60.0), ball("fat", 50.0, 30.0), ball("fetal_bone", 70.0, 20.0))
    scenes = {
        "overlap": (Scene(balls, tissues["coupling_gel"], "overlap"), np.eye(4)),
        "fetal": (fetal_abdomen(triangles=20_000), fetal_planes()["abdomen"]),
    }
    size = {"scanlines": 96, "axial_samples": 768, "image_shape": (256, 355), "axial_fwhm_mm": 1.2}
    kinds = {
        "high": SimulatorSettings(rays=16, layers=3, **size),
        "low": SimulatorSettings.low_quality(**size),
        "full": SimulatorSettings(rays=4, layers=1, plan="full", depth_mode="time_of_flight", **size),
    }
    made = {}
    for name, (scene, pose) in scenes.items():
        for kind, settings in kinds.items():
            frame = Simulator(scene, ConvexProbe(frequency_mhz=3.0), settings).render(pose, seed=3)
            for part in ("segmentation", "attenuation", "image", "mask", "envelope"):
                made[f"{name}/{kind}/{part}"] = getattr(frame, part)
    np.savez_compressed(path, **made)


def weights(path: Path) -> None:
    """The SHA-256 of every tensor of a checkpoint, sorted: names may change, values may not."""
    import torch

    found: list[str] = []

    def walk(value: object) -> None:
        if isinstance(value, torch.Tensor):
            found.append(f"{tuple(value.shape)} {hashlib.sha256(value.detach().numpy().tobytes()).hexdigest()[:24]}")
        elif isinstance(value, dict):
            for item in value.values():
                walk(item)
        elif isinstance(value, list | tuple):
            for item in value:
                walk(item)

    walk(torch.load(path, map_location="cpu", weights_only=True))
    print("\n".join(sorted(found)))


def compare(before: Path, after: Path) -> int:
    """Print what is equal and what is not; returns how many items differ."""
    rows: list[tuple[str, str]] = []
    with np.load(before / "frames.npz") as a, np.load(after / "frames.npz") as b:
        for name in a.files:
            rows.append((f"frame {name}", _arrays(a[name], b[name] if name in b.files else None)))
    old, new = (json.loads((side / "weights.json").read_text()) for side in (before, after))
    rows += [(f"weights {name}", "equal" if old[name] == new.get(name) else "differ") for name in old]
    for path in sorted((before / "runs").rglob("*")):
        name = path.relative_to(before)
        if "artifacts" in name.parts:
            continue  # copies, in folders that are named at random
        if path.suffix == ".csv":
            other = after / name
            rows.append((str(name), _tables(pd.read_csv(path), pd.read_csv(other)) if other.exists() else "missing"))
        elif path.suffix in (".tex", ".md"):
            other = after / name
            same = other.exists() and path.read_text() == other.read_text()
            rows.append((str(name), "equal" if same else "differs"))
    for study in sorted(path.name for path in (before / "runs").iterdir() if path.is_dir()):
        old, new = (dict(_trainings(side / "runs" / study)) for side in (before, after))
        for label, (table, scalars) in old.items():
            if label not in new:
                rows.append((f"{study} {label}", "missing"))
                continue
            rows.append((f"{study} {label} values", _tables(table, new[label][0])))
            rows.append((f"{study} {label} scalars", _scalars(scalars, new[label][1])))
    worse = [row for row in rows if not row[1].startswith("equal")]
    for name, verdict in worse:
        print(f"{name}: {verdict}")
    print(f"\n{len(rows) - len(worse)} of {len(rows)} items equal to the bit")
    return len(worse)


def _arrays(a: np.ndarray, b: np.ndarray | None) -> str:
    if b is None or a.shape != b.shape or a.dtype != b.dtype:
        return "missing or of another shape"
    if np.array_equal(a, b, equal_nan=a.dtype.kind == "f"):
        return "equal"
    apart = np.abs(a.astype(np.float64) - b.astype(np.float64))
    return f"{np.mean(apart > 0):.2%} differ, by {apart.max():.3g} at most"


def _trainings(study: Path) -> Iterator[tuple[str, tuple[pd.DataFrame, dict[str, float]]]]:
    """Values of frames and scalars of each training, by the name of its folder without its hash."""
    for result in sorted(study.glob("*/trained.json")):
        scalars = json.loads(result.read_text())["scalars"]
        files = sorted(result.parent.glob("scores/*.parquet"))
        for file in files:
            about = (pq.read_schema(file).metadata or {}).get(b"ablate", b"{}")
            scalars |= json.loads(about).get("scalars", {})
        table = pd.concat(map(pd.read_parquet, files)).sort_values(["metric", "source", "split", "frame"])
        yield result.parent.name.rpartition("-")[0], (table.reset_index(drop=True), scalars)


def _tables(a: pd.DataFrame, b: pd.DataFrame) -> str:
    gone, new = set(a) - set(b), set(b) - set(a)
    if gone or len(a) != len(b):
        return f"columns gone {sorted(gone)}, new {sorted(new)}; {len(a)} rows, then {len(b)}"
    keys = [c for c in a if a[c].dtype.kind not in "fiub"]
    # A table without a row has none either.
    measured = np.array([bool(TIMES.search(" ".join(map(str, row)))) for row in a[keys].to_numpy()], dtype=bool)
    verdicts = []
    for column in a:
        if TIMES.search(column):
            continue
        x, y = (frame[column][~measured] for frame in (a, b))
        if x.reset_index(drop=True).equals(y.reset_index(drop=True).astype(x.dtype)):
            continue
        if x.dtype.kind == "f":
            verdicts.append(f"{column} by {np.nanmax(np.abs(x.to_numpy() - y.to_numpy(dtype=float))):.3g}")
        else:
            verdicts.append(f"{column} in {int((x.to_numpy() != y.to_numpy()).sum())} rows")
    if verdicts:
        return "differs: " + "; ".join(verdicts)
    return f"equal{f', with new columns {sorted(new)}' if new else ''}"


def _scalars(old: dict[str, float], new: dict[str, float]) -> str:
    old = {k: v for k, v in old.items() if not TIMES.search(k)}
    apart = [k for k, v in old.items() if k not in new or new[k] != v]
    return f"differs: {', '.join(apart)}" if apart else "equal"


def main() -> int:
    """Record or compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    recording = commands.add_parser("record")
    recording.add_argument("folder", type=Path)
    recording.add_argument("--code", type=Path, default=ROOT)
    comparing = commands.add_parser("compare")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    for name in ("frames", "weights"):
        commands.add_parser(name).add_argument("path", type=Path)
    args = parser.parse_args()
    if args.command == "record":
        record(args.folder.resolve(), args.code.resolve())
    elif args.command == "compare":
        return int(compare(args.before, args.after) > 0)
    else:
        {"frames": frames, "weights": weights}[args.command](args.path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
