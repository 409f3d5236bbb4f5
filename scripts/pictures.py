"""Draw the pictures of docs/simulator.md, at the paper's size.

gallery: six frames, each above its segmentation: the standard planes of the built-in anatomy or, of a scene folder, the
pose that shows most of a tissue, for each of its six smallest tissues.
frame: image, segmentation and attenuation map side by side; and the probe on the body, as `task=preview` draws it.
frequencies: one plane at three frequencies, with a part of each enlarged.
probes: one plane as a convex, a linear and a phased array of conf/probe see it, from the same place on the skin.
compounding: one plane without and with spatial compounding; above of a convex probe, below of a linear one.

python scripts/pictures.py gallery
python scripts/pictures.py gallery --folder path/to/scene --out runs/gallery.png
python scripts/pictures.py probes
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from ablate.analysis import preview_figure
from ablate.analysis.figures.scene_parts import tissue_colours
from ablate.analysis.figures.style import PAGE_IN, PNG_DPI, house_style
from ablate.anatomy import Scene, fetal_abdomen, fetal_planes, fetal_sites, load_scene, load_sites
from ablate.command.compose import jobs_of
from ablate.dataset import probe_poses
from ablate.settings.study import StudySettings
from ablate.ultrasound import ConvexProbe, Frame, Probe, Simulator, SimulatorSettings, with_patient_gain
from ablate.ultrasound.probe import fan_of

DOCS = Path(__file__).parents[1] / "docs"
GALLERY_MHZ = 3.5  # usual at this depth
COLUMNS = 3
SCOUT_SHAPE = (100, 139)  # of the label maps from which the poses are chosen
FRAME_MHZ = 3.0  # of the quick preset; at the paper's 8 MHz little of the attenuation map is left to see
FRAME_PLANE = "spine"
LEAST_SHARE = 0.002  # of the fan, or a tissue is not named
PROBES = {"c5-2v": "convex, C5-2v", "l11-5v": "linear, L11-5v", "p4-2v": "phased, P4-2v"}
COMPOUNDED = {"c5-2v": "spine", "l11-5v": "abdomen"}  # plane of each probe
ANGLES = (1, 5)
FREQUENCIES_MHZ = (2, 5, 12)
FREQUENCIES_PLANE = "abdomen"
ENLARGED_MM = (-20.0, 20.0, 62.0, 36.0)  # left, right, bottom, top
#: Noise, gain and pulse of a scanner at the paper's image size.
SIZE = ["preset=fine", "simulator.image_shape=${fan_shape:1000}", "simulator.axial_samples=3072"]
MANY_RAYS = [*SIZE, "simulator.rays=32"]
GREY: dict[str, Any] = {"cmap": "gray", "vmin": 0, "vmax": 255, "interpolation": "antialiased"}


def colours_of(scene: Scene) -> np.ndarray:
    """(tissues + 1, 3): black, then the colour of each label."""
    return np.concatenate([[(0.0, 0.0, 0.0)], tissue_colours(scene.tissues)])


def extent_of(probe: Probe) -> tuple[float, float, float, float]:
    """Left, right, bottom and top of an image, mm from the middle of the probe's face."""
    (height, width), top = fan_of(probe).size_mm, -fan_of(probe).sag_mm
    return -width / 2, width / 2, top + height, top


def poses_by_tissue(folder: Path, scene: Scene) -> dict[str, np.ndarray]:
    """At most six poses: for each tissue but the background, the smallest first, the one that shows most of it."""
    scout = Simulator(scene, ConvexProbe(), SimulatorSettings(image_shape=SCOUT_SHAPE))
    poses = probe_poses(scene, load_sites(folder), press_mm=8)
    counts = np.array([np.bincount(scout.maps(p)[0].ravel(), minlength=len(scene.tissues) + 1)[1:] for p in poses])
    names = [tissue.name for tissue in scene.tissues]
    rarest_first = [i for i in np.argsort(counts.sum(axis=0), kind="stable") if i > 0][:6]
    return {names[i]: poses[int(counts[:, i].argmax())] for i in sorted(rarest_first)}


def gallery(folder: Path | None, path: Path) -> None:
    """Write gallery.png, of the built-in anatomy or of a scene folder."""
    scene = load_scene(folder) if folder else fetal_abdomen()
    poses = poses_by_tissue(folder, scene) if folder else fetal_planes()
    probe, patient = ConvexProbe(frequency_mhz=GALLERY_MHZ), jobs_of(MANY_RAYS)[0].settings.simulator
    simulator = Simulator(scene, probe, with_patient_gain(scene, probe, patient, np.array(list(poses.values()))))
    rows = -(-len(poses) // COLUMNS)
    figure, axes = plt.subplots(2 * rows, COLUMNS, figsize=(11, 2.9 * 2 * rows), squeeze=False)
    for each in axes.ravel():
        each.set_axis_off()
    for number, (name, pose) in enumerate(poses.items()):
        frame = simulator.render(pose)
        row, column = divmod(number, COLUMNS)
        axes[2 * row, column].imshow(frame.image, **GREY)
        axes[2 * row, column].set_title(name.replace("_", " "), fontsize=10)
        axes[2 * row + 1, column].imshow(colours_of(scene)[frame.segmentation], interpolation="nearest")
    figure.subplots_adjust(0, 0, 1, 0.97, 0.01, 0.09)
    figure.savefig(path, dpi=110)


def frame() -> None:
    """Write frame.png and preview.png."""
    scene, probe, planes = fetal_abdomen(), ConvexProbe(frequency_mhz=FRAME_MHZ), fetal_planes()
    patient, pose = jobs_of(MANY_RAYS)[0].settings.simulator, planes[FRAME_PLANE]
    settings = with_patient_gain(scene, probe, patient, np.array(list(planes.values())))
    shown = Simulator(scene, probe, settings).render(pose)
    write_panels(scene, probe, shown)
    title = f"sagittal plane of the {FRAME_PLANE}"
    preview_figure(DOCS / "preview.png", title, scene, probe, pose, shown.image, shown.segmentation, fetal_sites())


def write_panels(scene: Scene, probe: ConvexProbe, shown: Frame) -> None:
    """Write frame.png: image, segmentation with the names of its tissues, and attenuation map, by depth in mm."""
    colours, extent = colours_of(scene), extent_of(probe)
    with house_style():
        figure = Figure(figsize=(PAGE_IN, 0.4 * PAGE_IN))
        image, segmentation, attenuation = figure.subplots(
            1, 3, sharey=True, gridspec_kw={"left": 0.075, "right": 0.9, "top": 0.93, "bottom": 0.3, "wspace": 0.05}
        )
        image.imshow(shown.image, extent=extent, **GREY)
        segmentation.imshow(colours[shown.segmentation], extent=extent, interpolation="antialiased")
        shares = attenuation.imshow(shown.attenuation, extent=extent, **{**GREY, "vmax": 1})
        image.set_ylabel("depth (mm)")
        for axes, title in zip(figure.axes, ("B-mode image", "segmentation S", "attenuation map A"), strict=True):
            axes.set_title(title, pad=3)
            axes.set_xlabel("lateral (mm)")
            axes.set_xticks((-50, 0, 50))
        box = attenuation.get_position()
        figure.colorbar(shares, cax=figure.add_axes((0.91, box.y0, 0.012, box.height)), label="share of the sound left")
        seen = np.bincount(shown.segmentation.ravel())
        most_first = [i for i in np.argsort(-seen, kind="stable") if i and seen[i] > LEAST_SHARE * seen[1:].sum()]
        named = [Patch(facecolor=colours[i], label=scene.tissues[i - 1].name.replace("_", " ")) for i in most_first]
        figure.legend(
            handles=named, frameon=False, loc="lower center", ncols=7, handlelength=0.9, handleheight=0.9, fontsize=7
        )
        figure.savefig(DOCS / "frame.png", dpi=PNG_DPI)


def settings_of(probe: str) -> StudySettings:
    """The settings of the pictures with a probe of conf/probe."""
    return jobs_of([f"probe={probe}", *SIZE])[0].settings


def draw_plane(axes: Axes, scene: Scene, settings: StudySettings, plane: str, angles: int = 1) -> None:
    """Render a plane of the built-in anatomy and draw its image."""
    pose = fetal_planes(press_mm=settings.dataset.press_mm)[plane]
    chosen = with_patient_gain(scene, settings.probe, settings.simulator, pose[None])
    chosen = replace(chosen, compound_angles=angles)
    image = Simulator(scene, settings.probe, chosen, poses=[pose]).render(pose).image
    axes.imshow(image, extent=extent_of(settings.probe), **GREY)
    axes.set_xlabel("lateral (mm)")


def probes() -> None:
    """Write probes.png."""
    scene, settings = fetal_abdomen(), [settings_of(name) for name in PROBES]
    widths = [columns / rows for rows, columns in (one.simulator.image_shape for one in settings)]
    with house_style():
        figure = Figure(figsize=(PAGE_IN, PAGE_IN / sum(widths) + 0.35), layout="constrained")
        panels = figure.subplots(1, len(settings), width_ratios=widths)
        for axes, one, title in zip(panels, settings, PROBES.values(), strict=True):
            draw_plane(axes, scene, one, "abdomen")
            axes.set_title(f"{title}, {one.probe.frequency_mhz:g} MHz")
        panels[0].set_ylabel("depth (mm)")
        figure.savefig(DOCS / "probes.png", dpi=PNG_DPI)


def compounding() -> None:
    """Write compounding.png."""
    scene, settings = fetal_abdomen(), [settings_of(name) for name in COMPOUNDED]
    tall = [rows / columns for rows, columns in (one.simulator.image_shape for one in settings)]
    with house_style():
        figure = Figure(figsize=(PAGE_IN, PAGE_IN / len(ANGLES) * sum(tall) + 0.9), layout="constrained")
        rows = figure.subplots(len(COMPOUNDED), len(ANGLES), height_ratios=tall)
        for panels, one, (name, plane) in zip(rows, settings, COMPOUNDED.items(), strict=True):
            for axes, angles in zip(panels, ANGLES, strict=True):
                draw_plane(axes, scene, one, plane, angles)
                axes.set_title(f"{name}, {angles} angle{'s' if angles > 1 else ''}")
            panels[0].set_ylabel("depth (mm)")
        figure.savefig(DOCS / "compounding.png", dpi=PNG_DPI)


def frequencies() -> None:
    """Write frequencies.png."""
    scene, planes = fetal_abdomen(), np.array([*fetal_planes().values()])
    pose, (left, right, bottom, top) = fetal_planes()[FREQUENCIES_PLANE], ENLARGED_MM
    with house_style():
        figure = Figure(figsize=(PAGE_IN, 0.5 * PAGE_IN), layout="constrained")
        panels = figure.subplots(2, len(FREQUENCIES_MHZ), height_ratios=(1.0, 0.85))
        for (whole, enlarged), frequency_mhz in zip(panels.T, FREQUENCIES_MHZ, strict=True):
            (job,) = jobs_of([*SIZE, "simulator.scanlines=256", f"probe.frequency_mhz={frequency_mhz}"])
            chosen = with_patient_gain(scene, job.settings.probe, job.settings.simulator, planes)
            image = Simulator(scene, job.settings.probe, chosen, poses=[pose]).render(pose).image
            for axes in (whole, enlarged):
                axes.imshow(image, extent=extent_of(job.settings.probe), **GREY)
            whole.set_title(f"{frequency_mhz} MHz")
            whole.add_patch(Rectangle((left, top), right - left, bottom - top, fill=False, ec="#f0e442", lw=0.6))
            enlarged.set_xlim(left, right)
            enlarged.set_ylim(bottom, top)
            enlarged.set_xlabel("lateral (mm)")
        for axes in panels[:, 0]:
            axes.set_ylabel("depth (mm)")
        figure.savefig(DOCS / "frequencies.png", dpi=0.8 * PNG_DPI)


def main() -> None:
    """Draw what is asked for."""
    others = {"frame": frame, "frequencies": frequencies, "probes": probes, "compounding": compounding}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("gallery", *others))
    parser.add_argument("--folder", type=Path, help="a scene folder for the gallery")
    parser.add_argument("--out", type=Path, default=DOCS / "gallery.png", help="of the gallery")
    args = parser.parse_args()
    if args.what == "gallery":
        gallery(args.folder, args.out)
    else:
        others[args.what]()


if __name__ == "__main__":
    main()
