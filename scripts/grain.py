"""What the grain of the body brings: a table of the scores of a study, and a cine of a probe that is rocked.

python -m ablate +study=noise
python scripts/grain.py table runs/noise              # scores on validation sites, means over the seeds
python scripts/grain.py table runs/noise --part test
python scripts/grain.py table runs/representation --metrics mae_smooth pchi2_tissue shadow_contrast crps
python scripts/grain.py cine                          # docs/grain.webp, and docs/pair.png
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial.transform import Rotation

import ablate
from ablate.anatomy import Scene, fetal_abdomen, fetal_planes
from ablate.metrics import metric_of
from ablate.networks.spec import Noise
from ablate.pretrained import Renderer
from ablate.study.network import renderer_of
from ablate.study.training import trainings_in
from ablate.ultrasound import Frame, Simulator
from numerics import markdown

DOCS = Path(__file__).parents[1] / "docs"
SHOWN = ("psnr", "mae", "mae_smooth", "pchi2_tissue", "thin_contrast", "octave_sd", "fd_speckle")
OF_TEST_FRAMES = ("motion", "motion_screen")
PLANE = "abdomen"
TRIANGLES = 160_000  # of the training
FRAMES, MOST_DEG, FRAME_MS = 32, 6.0, 80
LETTERS = 15


def table(study: Path, part: str, metrics: Sequence[str] = SHOWN) -> pd.DataFrame:
    """A row a network, mean over its trainings, and one of re-simulation; with minutes of training of one core."""
    prefix = "test" if part == "test" else "val"
    names = (*metrics, *(OF_TEST_FRAMES if part == "test" else ()))
    rows = []
    for run in ablate.open_study(study).usable.runs:
        values = {name: run.scalars.get(f"{prefix}/{name}", np.nan) for name in names}
        floors = {name: run.scalars.get(f"{prefix}/floor_{name}", np.nan) for name in names}
        rows += [{"network": "re-simulation", **floors}]
        rows += [{"network": run.label, **values, "minutes": run.scalars.get("train/seconds", np.nan) / 60}]
    means = pd.DataFrame(rows).groupby("network", sort=False).mean()
    return means.rename(columns={name: metric_of(name).label for name in names})


def rocked(pose: np.ndarray, radius_mm: float) -> list[np.ndarray]:
    """Poses of a probe that is rocked about its centre of curvature, there and back."""
    poses = []
    for angle in MOST_DEG * np.sin(np.linspace(0, 2 * np.pi, FRAMES, endpoint=False)):
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_euler("y", angle, degrees=True).as_matrix()
        turn[:3, 3] = turn[:3, :3] @ (0, 0, radius_mm) - (0, 0, radius_mm)
        poses.append(pose @ turn)
    return poses


def panels(frame: Frame, scene: Scene, renderers: Sequence[tuple[str, Renderer]]) -> Image.Image:
    """The simulated image and the generated ones side by side, with their names."""
    images = [("simulated", frame.image)]
    images += [(name, renderer.render(frame, scene.tissues)) for name, renderer in renderers]
    height, width = frame.image.shape
    picture = Image.new("L", (len(images) * width, height + 2 * LETTERS))
    draw = ImageDraw.Draw(picture)
    for number, (name, image) in enumerate(images):
        draw.text((number * width + width // 2, LETTERS), name, 220, ImageFont.load_default(LETTERS), anchor="mm")
        picture.paste(Image.fromarray(image), (number * width, 2 * LETTERS))
    return picture


def cine(studies: Sequence[Path]) -> None:
    """Write the cine of all networks, and its first frame with the first network as a picture of their pair."""
    trained = (training for study in studies for training in trainings_in(study) if training.seed == 0)
    by_pixel = next(training for training in trained if training.settings.model.noise is Noise.inject)
    renderers = [
        ("generated, grain of the body", ablate.load("sa2h")),
        ("generated, noise by pixel", renderer_of(by_pixel)),
    ]
    scene = fetal_abdomen(TRIANGLES)
    probe, settings = renderers[0][1].probe, renderers[0][1].simulator
    poses = rocked(fetal_planes()[PLANE], getattr(probe, "radius_mm", 0.0))
    simulator = Simulator(scene, probe, settings, poses=poses)
    frames = [simulator.render(pose) for pose in poses]
    pictures = [panels(frame, scene, renderers) for frame in frames]
    pictures[0].save(
        DOCS / "grain.webp", save_all=True, append_images=pictures[1:], duration=FRAME_MS, loop=0, quality=50, method=6
    )
    panels(frames[0], scene, [("generated", renderers[0][1])]).save(DOCS / "pair.png")
    print(f"{DOCS / 'grain.webp'}: {(DOCS / 'grain.webp').stat().st_size / 1e6:.1f} MB")


def main() -> None:
    """Print the table, or write the pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("table", "cine"))
    parser.add_argument("study", type=Path, nargs="*", default=[Path("runs/noise")])
    parser.add_argument("--part", choices=("validation", "test"), default="validation")
    parser.add_argument("--metrics", nargs="+", default=SHOWN)
    arguments = parser.parse_args()
    if arguments.what == "cine":
        cine(arguments.study)
    else:
        print(markdown(table(arguments.study[0], arguments.part, arguments.metrics).map("{:.3g}".format)))


if __name__ == "__main__":
    main()
