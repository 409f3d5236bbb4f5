"""A phantom with a cyst and two lesions in ablate and in PyMUST, an independent simulator of point scatterers.

python scripts/against_pymust/compare.py

Prints the table of docs/against_pymust.md and writes it as docs/against_pymust/table.csv.
"""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from lesion_phantom import Lesion, Phantom, scatterers, scene
from pymust_array import Array, PointWidths, Scatterers, images, point_widths
from speckle_measures import (
    cell_size,
    contrast_db,
    expected_cell,
    expected_contrast_db,
    expected_mean_over_sd,
    lesion_diameter,
    level,
    mean_over_sd,
    radial_profile,
    rayleigh_distance,
    scatterers_per_cell,
)

from ablate.ultrasound import ConvexProbe, Simulator, SimulatorSettings

HERE = Path(__file__).parents[2] / "docs" / "against_pymust"
MARGIN_MM = 2.0  # left out on both sides of a lesion's edge
RINGS_MM = np.concatenate([[0.0], np.arange(1.5, 12.1, 0.5)])
PHANTOM = Phantom(
    near_mm=30.0,
    far_mm=70.0,
    fov_deg=50.0,
    per_mm2=18.0,
    lesions=(
        Lesion("-6 dB lesion", -16.0, 50.0, 7.0, -6.0),
        Lesion("cyst", 0.0, 50.0, 7.0, -math.inf),
        Lesion("+6 dB lesion", 16.0, 50.0, 7.0, 6.0),
    ),
)
SIDE_LOBES = 20.0  # width of the side lobes of ablate, in widths of the main lobe
PYMUST_SEEDS, ABLATE_SEEDS = range(3), range(100)


def matched_settings(phantom: Phantom, widths: PointWidths) -> SimulatorSettings:
    """Settings whose pulse has the widths of PyMUST's points; one ray and one layer, as PyMUST has two dimensions."""
    angle = float((widths.lateral_mm / (phantom.face_mm + widths.depth_mm)).mean())
    return SimulatorSettings(
        scanlines=phantom.lines, axial_samples=phantom.samples, rays=1, layers=1, image_shape=(64, 64),
        axial_fwhm_mm=float(widths.axial_mm.mean()), lateral_fwhm_mm=angle * (phantom.face_mm + 70), focus_mm=70.0,
        aperture_mm=0.0, elevational_aperture_mm=0.0,
    )  # fmt: skip


def lateral_fwhm_mm(phantom: Phantom, settings: SimulatorSettings, depth_mm: float) -> float:
    """Width of ablate's main lobe at a depth: it has one angular width."""
    return settings.lateral_fwhm_mm * (phantom.face_mm + depth_mm) / (phantom.face_mm + settings.focus_mm)


def render(phantom: Phantom, array: Array, settings: SimulatorSettings, seeds: Sequence[int]) -> list[np.ndarray]:
    """Envelopes of ablate on the phantom's grid, (n, lines) float64 each."""
    probe = ConvexProbe(phantom.face_mm, phantom.fov_deg, phantom.far_mm, array.frequency_mhz)
    simulator = Simulator(scene(phantom), probe, settings)
    shown = len(phantom.depths_mm)
    return [simulator.render(np.eye(4), seed).envelope[-shown:].astype(np.float64) for seed in seeds]


def flattened(phantom: Phantom, envelope: np.ndarray) -> np.ndarray:
    """The envelope with uniform tissue at unit mean power."""
    return level(envelope, phantom.depths_mm, phantom.angles_rad, phantom.clear(MARGIN_MM))


def bands(phantom: Phantom) -> dict[str, np.ndarray]:
    """Rows above and below the lesions, (n,) bool each."""
    depth = phantom.depths_mm
    first = min(lesion.depth_mm - lesion.radius_mm for lesion in phantom.lesions) - MARGIN_MM
    last = max(lesion.depth_mm + lesion.radius_mm for lesion in phantom.lesions) + MARGIN_MM
    return {
        "near": (depth > phantom.near_mm + MARGIN_MM) & (depth < first),
        "far": (depth > last) & (depth < phantom.far_mm - MARGIN_MM),
    }


def point_depths_mm(phantom: Phantom) -> dict[str, float]:
    """Where single points are looked at: in the middle of the bands and of the lesions."""
    depths = {name: float(phantom.depths_mm[rows].mean()) for name, rows in bands(phantom).items()}
    return depths | {"middle": float(np.mean([lesion.depth_mm for lesion in phantom.lesions]))}


def points(phantom: Phantom) -> list[Scatterers]:
    """A cloud for each of `point_depths_mm`, of one scatterer on the axis."""
    return [Scatterers(np.zeros(1), np.array([depth]), np.ones(1)) for depth in point_depths_mm(phantom).values()]


def pulse_points(phantom: Phantom, settings: SimulatorSettings) -> list[np.ndarray]:
    """Images of `points` by ablate's pulse, (n, lines) float64 each: a Gaussian, and side lobes of random signs."""
    x, z = phantom.grid_mm
    r = np.hypot(x, z + phantom.face_mm)
    signs = np.random.default_rng(0).choice((-1.0, 1.0), 1000)
    signs[0] = 0.0  # within a width there is the main lobe alone
    reach = SIDE_LOBES / math.sqrt(8 * math.log(2))
    # Squares integrate to sqrt(pi / (8 ln 2)) widths for the main lobe, and to sqrt(pi) * reach for the side lobes.
    height = 10 ** (settings.sidelobe_db / 20) * (8 * math.log(2)) ** -0.25 / math.sqrt(reach)
    pictures = []
    for depth_mm in point_depths_mm(phantom).values():
        along = (r - phantom.face_mm - depth_mm) / settings.axial_fwhm_mm
        across = r * np.arctan2(x, z + phantom.face_mm) / lateral_fwhm_mm(phantom, settings, depth_mm)
        side = height * np.exp(-0.5 * (across / reach) ** 2) * signs[np.abs(across).astype(int)]
        pictures.append(2.0 ** (-4 * along**2) * (2.0 ** (-4 * across**2) + side))
    return pictures


def spacing_mm(phantom: Phantom, depth_mm: float) -> tuple[float, float]:
    """Axial and lateral distance of neighbouring samples at a depth."""
    depth, angle = phantom.depths_mm, phantom.angles_rad
    return depth[1] - depth[0], (phantom.face_mm + depth_mm) * (angle[1] - angle[0])


def measured(phantom: Phantom, envelope: np.ndarray) -> dict[str, float]:
    """Every figure of one image."""
    clear = phantom.clear(MARGIN_MM)
    flat = flattened(phantom, envelope)
    found = {"mean / sd": mean_over_sd(flat[clear]), "distance to Rayleigh": rayleigh_distance(flat[clear])}
    for name, rows in bands(phantom).items():
        axial_mm, lateral_mm = spacing_mm(phantom, phantom.depths_mm[rows].mean())
        uniform = flat[rows][:, clear[rows].all(axis=0)]
        found[f"axial cell, {name} (mm)"] = cell_size(uniform, 0) * axial_mm
        found[f"lateral cell, {name} (mm)"] = cell_size(uniform, 1) * lateral_mm
    for lesion in phantom.lesions:
        distance = phantom.distance_mm(lesion, *phantom.grid_mm)
        inside = flat[distance < lesion.radius_mm - MARGIN_MM]
        outside = flat[clear & (distance < RINGS_MM[-1])]
        profile = radial_profile(flat**2, distance, RINGS_MM)
        found[f"{lesion.name}: contrast (dB)"] = contrast_db(inside, outside)
        found[f"{lesion.name}: diameter (mm)"] = lesion_diameter(profile, RINGS_MM, 2 * lesion.radius_mm)
    return found


def expected(phantom: Phantom, point_images: Sequence[np.ndarray], per_mm2: float) -> dict[str, float]:
    """The same figures for speckle of the given density of scatterers that are seen as in the images of `points`."""
    depths = point_depths_mm(phantom)
    of = dict(zip(depths, point_images, strict=True))
    middle = np.abs(of["middle"]) ** 2
    per_cell = scatterers_per_cell(middle, math.prod(spacing_mm(phantom, depths["middle"])), per_mm2)
    found = {"mean / sd": expected_mean_over_sd(per_cell), "distance to Rayleigh": 0.0}
    for name in bands(phantom):
        axial_mm, lateral_mm = spacing_mm(phantom, depths[name])
        axial, lateral = expected_cell(of[name])
        found[f"axial cell, {name} (mm)"] = axial * axial_mm
        found[f"lateral cell, {name} (mm)"] = lateral * lateral_mm
    power = np.ones(middle.shape)
    for lesion in phantom.lesions:
        power[phantom.distance_mm(lesion, *phantom.grid_mm) < lesion.radius_mm] = 10 ** (lesion.contrast_db / 10)
    for lesion in phantom.lesions:
        distance = phantom.distance_mm(lesion, *phantom.grid_mm)
        outside = phantom.clear(MARGIN_MM) & (distance < RINGS_MM[-1])
        contrast = expected_contrast_db(power, middle, distance < lesion.radius_mm - MARGIN_MM, outside)
        found[f"{lesion.name}: contrast (dB)"] = contrast
        found[f"{lesion.name}: diameter (mm)"] = 2 * lesion.radius_mm
    return found


def table(columns: Mapping[str, Sequence[Mapping[str, float]]]) -> list[list[str]]:
    """Rows of text: for each column the mean of its dictionaries and, where there are several, its standard error."""

    def cell(values: np.ndarray) -> str:
        if not np.isfinite(values).all():
            return f"{values.mean():.0f}"
        error = f" ± {values.std(ddof=1) / math.sqrt(len(values)):.3f}" if len(values) > 1 else ""
        return f"{values.mean():.3f}{error}"

    keys = next(iter(columns.values()))[0].keys()
    body = [[key, *(cell(np.array([found[key] for found in column])) for column in columns.values())] for key in keys]
    return [["", *columns], *body]


def main() -> None:
    """Simulate, measure, print and write."""
    torch.set_num_threads(1)
    array = Array()
    widths = point_widths(array, np.arange(30.0, 71.0, 10.0))
    settings = matched_settings(PHANTOM, widths)
    for depth, axial, lateral in zip(widths.depth_mm, widths.axial_mm, widths.lateral_mm, strict=True):
        print(
            f"a point in PyMUST at {depth:.0f} mm: {axial:.3f} mm axially, {lateral:.3f} mm laterally; in ablate: "
            f"{settings.axial_fwhm_mm:.3f} mm and {lateral_fwhm_mm(PHANTOM, settings, depth):.3f} mm; "
            f"{PHANTOM.per_mm2 * axial * lateral:.1f} of PyMUST's scatterers in that area"
        )
    alone = points(PHANTOM)
    clouds = [*alone, *(scatterers(PHANTOM, seed) for seed in PYMUST_SEEDS)]
    seen = images(array, clouds, PHANTOM.depths_mm, PHANTOM.angles_rad)
    theirs = [np.abs(image) for image in seen[len(alone) :]]
    ours = render(PHANTOM, array, settings, ABLATE_SEEDS)

    rows = table(
        {
            f"PyMUST, {len(theirs)} images": [measured(PHANTOM, image) for image in theirs],
            "PyMUST expected": [expected(PHANTOM, seen[: len(alone)], PHANTOM.per_mm2)],
            f"ablate, {len(ours)} images": [measured(PHANTOM, image) for image in ours],
            "ablate expected": [expected(PHANTOM, pulse_points(PHANTOM, settings), math.inf)],
        }
    )
    for number, row in enumerate(rows):
        print("|", " | ".join(row), "|")
        if number == 0:
            print("|", " | ".join(["---"] * len(row)), "|")
    with (HERE / "table.csv").open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows(rows)


if __name__ == "__main__":
    main()
