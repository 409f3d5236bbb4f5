"""Draw six simulated frames at the paper's size, each above its segmentation.

They are the standard planes of the built-in anatomy (docs/gallery.png) or, for a scene folder, the pose that shows
most of a tissue, for each of its six smallest tissues.

python scripts/gallery.py
python scripts/gallery.py --folder path/to/scene --frequency 5 --out runs/gallery.png
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from ablate.analysis.figures.scene_parts import tissue_colours
from ablate.anatomy import Scene, fetal_abdomen, fetal_planes, load_scene, load_sites
from ablate.command.compose import jobs_of
from ablate.dataset import probe_poses
from ablate.ultrasound import ConvexProbe, Frame, Simulator, SimulatorSettings, with_patient_gain

#: A scanner's noise, gain and pulse at the paper's image size.
SETTINGS = ["preset=fine", "simulator.image_shape=[1000,1386]", "simulator.axial_samples=3072", "simulator.rays=32"]
FREQUENCY_MHZ = 5.0  # usual for a second-trimester examination
SCOUT_SHAPE = (100, 139)  # of the label maps from which the poses are chosen
COLUMNS = 3


def poses_by_tissue(folder: Path, scene: Scene) -> dict[str, np.ndarray]:
    """At most six poses: for each tissue but the background, the smallest first, the one that shows most of it."""
    scout = Simulator(scene, ConvexProbe(), SimulatorSettings(image_shape=SCOUT_SHAPE))
    poses = probe_poses(scene, load_sites(folder), press_mm=8)
    counts = np.array([np.bincount(scout.maps(p)[0].ravel(), minlength=len(scene.tissues) + 1)[1:] for p in poses])
    names = [tissue.name for tissue in scene.tissues]
    rarest_first = [i for i in np.argsort(counts.sum(axis=0), kind="stable") if i > 0][:6]
    return {names[i]: poses[int(counts[:, i].argmax())] for i in sorted(rarest_first)}


def draw(scene: Scene, frames: dict[str, Frame], path: Path) -> None:
    """Write the frames, each above its segmentation."""
    colours = np.concatenate([[(0.0, 0.0, 0.0)], tissue_colours(scene.tissues)])
    rows = -(-len(frames) // COLUMNS)
    figure, axes = plt.subplots(2 * rows, COLUMNS, figsize=(11, 2.9 * 2 * rows), squeeze=False)
    for each in axes.ravel():
        each.set_axis_off()
    for number, (name, frame) in enumerate(frames.items()):
        row, column = divmod(number, COLUMNS)
        axes[2 * row, column].imshow(frame.image, cmap="gray", vmin=0, vmax=255, interpolation="antialiased")
        axes[2 * row, column].set_title(name.replace("_", " "), fontsize=10)
        axes[2 * row + 1, column].imshow(colours[frame.segmentation], interpolation="nearest")
    figure.subplots_adjust(0, 0, 1, 0.97, 0.01, 0.09)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    """Render and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=None)
    parser.add_argument("--frequency", type=float, default=FREQUENCY_MHZ, help="MHz")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "gallery.png")
    args = parser.parse_args()
    scene = load_scene(args.folder) if args.folder else fetal_abdomen()
    poses = poses_by_tissue(args.folder, scene) if args.folder else fetal_planes()
    probe, patient = ConvexProbe(frequency_mhz=args.frequency), jobs_of(SETTINGS)[0].settings.simulator
    simulator = Simulator(scene, probe, with_patient_gain(scene, probe, patient, np.array(list(poses.values()))))
    draw(scene, {name: simulator.render(pose) for name, pose in poses.items()}, args.out)


if __name__ == "__main__":
    main()
