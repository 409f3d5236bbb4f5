"""The figure of docs/against_pymust.md: both images, the distribution of the envelope, profiles of the lesions."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from lesion_phantom import Phantom
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from speckle_measures import radial_profile

from ablate.analysis.figures.style import COLOURS, PAGE_IN, PNG_DPI, house_style, new_figure

IMAGE_DB = (-40.0, 15.0)
PROFILE_DB = (-32.0, 10.0)
SILENCE_DB = -200.0


def draw(
    path: Path,
    phantom: Phantom,
    flat: Mapping[str, Sequence[np.ndarray]],
    clear: np.ndarray,
    rings_mm: np.ndarray,
) -> None:
    """Write the figure.

    Parameters
    ----------
    path : Path
        A PNG.
    phantom : Phantom
    flat : mapping of str to sequence of (n, lines) float
        Images of each simulator, envelopes with uniform tissue at unit mean power; the first is shown.
    clear : (n, lines) bool
        Uniform tissue.
    rings_mm : (m,) float
        Edges of the rings that profiles are averaged over.
    """
    with house_style():
        figure = new_figure(PAGE_IN, 4.35)
        axes = figure.subplots(2, 2, height_ratios=(1, 1.05))
        for panel, letter, (name, images) in zip(axes[0], "ab", flat.items(), strict=True):
            mesh = _b_mode(panel, phantom, images[0])
            panel.set_title(f"({letter}) {name}")
        axes[0, 0].set_ylabel("depth (mm)")
        bar = axes[0, 1].inset_axes((1.03, 0, 0.03, 1))
        figure.colorbar(mesh, cax=bar, label="dB, mean speckle 0", ticks=np.arange(-40, 16, 10))
        axes[1, 0].set_title("(c) uniform tissue")
        _distribution(axes[1, 0], {name: [image[clear] for image in images] for name, images in flat.items()})
        axes[1, 1].set_title("(d) lesions")
        _profiles(axes[1, 1], phantom, flat, rings_mm)
        figure.savefig(path, dpi=PNG_DPI)


def _decibels(power: np.ndarray) -> np.ndarray:
    return 10 * np.log10(np.maximum(power, 10 ** (SILENCE_DB / 10)))


def _b_mode(axes: Axes, phantom: Phantom, envelope: np.ndarray) -> QuadMesh:
    x, z = phantom.grid_mm
    axes.set_facecolor("black")
    low, high = IMAGE_DB
    mesh = axes.pcolormesh(x, z, _decibels(envelope**2), cmap="gray", vmin=low, vmax=high, shading="gouraud")
    axes.set_aspect("equal")
    axes.set_xlim(x.min() - 1, x.max() + 1)
    axes.set_ylim(z.max() + 1, z.min() - 1)
    axes.set_xlabel("lateral (mm)")
    return mesh


def _distribution(axes: Axes, values: Mapping[str, Sequence[np.ndarray]]) -> None:
    edges = np.linspace(0, 3.2, 41)
    at = (edges[1:] + edges[:-1]) / 2
    axes.plot(at, 2 * at * np.exp(-(at**2)), color="black", linewidth=0.8, label="Rayleigh")
    for (name, parts), colour, marker in zip(values.items(), COLOURS, "os", strict=False):
        density = np.histogram(np.concatenate(parts), edges, density=True)[0]
        axes.plot(at, density, marker, color=colour, markersize=3, markerfacecolor="none", label=name)
    axes.set_xlabel("envelope over its root mean square")
    axes.set_ylabel("density")
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False)


def _profiles(axes: Axes, phantom: Phantom, flat: Mapping[str, Sequence[np.ndarray]], rings_mm: np.ndarray) -> None:
    r = (rings_mm[1:] + rings_mm[:-1]) / 2
    for number, lesion in enumerate(phantom.lesions):
        distance = phantom.distance_mm(lesion, *phantom.grid_mm)
        inside = max(lesion.contrast_db, SILENCE_DB)
        axes.plot(
            [0, lesion.radius_mm, lesion.radius_mm, rings_mm[-1]], [inside, inside, 0, 0],
            color="black", linewidth=0.8, label="scatterers" if number == 0 else None,
        )  # fmt: skip
        for (name, images), colour, marker in zip(flat.items(), COLOURS, "os", strict=False):
            profile = np.mean([radial_profile(image**2, distance, rings_mm) for image in images], axis=0)
            axes.plot(
                r, _decibels(profile), marker, color=colour, markersize=3, markerfacecolor="none",
                label=name if number == 0 else None,
            )  # fmt: skip
    axes.set_xlabel("distance from the lesion's centre (mm)")
    axes.set_ylabel("mean power (dB)")
    axes.set_xlim(0, rings_mm[-1])
    axes.set_ylim(*PROFILE_DB)
    axes.legend(frameon=False, loc="lower right")
