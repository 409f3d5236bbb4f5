"""Figures made of pictures: the qualitative grid and the patch chi-square maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from ablate.analysis.figure_style import PAGE_IN, house_style, new_figure, save_figure
from ablate.metrics import patch_chi2, patches_inside, rms

COLUMN_PICTURE_IN = 1.8  # narrower, and speckle is lost in print
INSET = 0.30  # of the picture's width and height: what fits beside a 70 degree fan


@dataclass(frozen=True, eq=False)
class FramePictures:
    """What was rendered of one test frame.

    Attributes
    ----------
    name : str
        Shown at the left of its row.
    target : (H, W) uint8
    predictions : dict of str to (H, W) uint8
        By variant, in the order shown; the re-simulation goes first, under its own name.
    mask : (H, W) bool, optional
        The fan.
    segmentation : (H, W) uint8, optional
        Labels, shown in a corner.
    attenuation : (H, W) float in [0, 1], optional
        Shown in the other corner.
    """

    name: str
    target: np.ndarray
    predictions: dict[str, np.ndarray] = field(default_factory=dict)
    mask: np.ndarray | None = None
    segmentation: np.ndarray | None = None
    attenuation: np.ndarray | None = None


def _picture(axes: Axes, image: np.ndarray) -> None:
    axes.imshow(image, cmap="gray", vmin=0, vmax=255, interpolation="antialiased")
    _bare(axes)


def _bare(axes: Axes) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(False)


def _insets(axes: Axes, frame: FramePictures) -> None:
    """S at the top left and A at the top right: the corners that a fan leaves black."""
    outside = np.zeros(frame.target.shape, bool) if frame.mask is None else ~frame.mask
    if frame.segmentation is not None:
        labels = np.ma.masked_array(frame.segmentation, outside | (frame.segmentation == 0))
        corner = axes.inset_axes((0.0, 1 - INSET, INSET, INSET))
        corner.imshow(labels, cmap="cividis", interpolation="nearest")
        _bare(corner)
        corner.set_facecolor("none")
    if frame.attenuation is not None:
        corner = axes.inset_axes((1 - INSET, 1 - INSET, INSET, INSET))
        # Attenuation falls over decades with depth: its logarithm is what shows shadows.
        log = np.log10(np.maximum(frame.attenuation.astype(np.float32), 1e-4))
        corner.imshow(np.ma.masked_array(log, outside), cmap="gray", interpolation="nearest")
        _bare(corner)
        corner.set_facecolor("none")


def _columns(frames: Sequence[FramePictures]) -> list[str]:
    if not frames:
        raise ValueError("no frame to draw")
    return list(dict.fromkeys(name for frame in frames for name in frame.predictions))


def qualitative_figure(frames: Sequence[FramePictures], stem: Path) -> list[Path]:
    """Target, re-simulation and every variant side by side, a row a frame, S and A in the target's corners.

    Parameters
    ----------
    frames : sequence of FramePictures
        Rows.
    stem : Path
        Path without suffix, for instance `qualitative_0`.

    Returns
    -------
    list of Path
        PNG and PDF.

    Raises
    ------
    ValueError
        When there is no frame.
    """
    columns = _columns(frames)
    height, width = frames[0].target.shape
    across = len(columns) + 1
    page = max(PAGE_IN, COLUMN_PICTURE_IN * across)
    with house_style(page):
        figure = new_figure(page, 0.04 * page + len(frames) * page / across * height / width, pad_in=0.01)
        grid = figure.subplots(len(frames), across, squeeze=False)
        for row, frame in zip(grid, frames, strict=True):
            _picture(row[0], frame.target)
            _insets(row[0], frame)
            row[0].set_ylabel(frame.name)
            for axes, name in zip(row[1:], columns, strict=True):
                if name in frame.predictions:
                    _picture(axes, frame.predictions[name])
                else:
                    axes.set_axis_off()
        for axes, title in zip(grid[0], ["target", *columns], strict=True):
            axes.set_title(title)
        return save_figure(figure, stem)


def chi2_maps_figure(frame: FramePictures, stem: Path, patch: int = 20) -> list[Path]:
    """Patch chi-square maps on [0, 1] above their images; the target at the right, as in the paper.

    Parameters
    ----------
    frame : FramePictures
    stem : Path
        Path without suffix, for instance `pchi2_maps_0`.
    patch : int
        Side of a patch, px.

    Returns
    -------
    list of Path
        PNG and PDF.

    Raises
    ------
    ValueError
        When there is no prediction.
    """
    columns = _columns([frame])
    if not columns:
        raise ValueError(f"frame {frame.name} has no prediction to map")
    height, width = frame.target.shape
    inside = None if frame.mask is None else patches_inside(frame.mask, patch)
    across = len(columns) + 1
    page = max(PAGE_IN, COLUMN_PICTURE_IN * across)
    with house_style(page):
        figure = new_figure(page, 0.06 * page + 2 * page / across * height / width, pad_in=0.01)
        grid = figure.subplots(2, across, squeeze=False)
        for (upper, lower), name in zip(grid.T, columns, strict=False):
            chi2 = patch_chi2(frame.predictions[name], frame.target, patch)
            shown = chi2 if inside is None else np.ma.masked_array(chi2, ~inside)
            extent = (0, chi2.shape[1] * patch, chi2.shape[0] * patch, 0)
            drawn = upper.imshow(shown, cmap="inferno", vmin=0, vmax=1, extent=extent)
            upper.set(xlim=(0, width), ylim=(height, 0), aspect="equal")
            _bare(upper)
            upper.set_facecolor("#EEEEEE")
            upper.set_title(f"{name}\nRMS {rms(chi2, inside) or 0.0:.3f}")
            _picture(lower, frame.predictions[name])
        grid[0, -1].set_axis_off()
        bar = figure.colorbar(drawn, cax=grid[0, -1].inset_axes((0.15, 0.1, 0.09, 0.85)))
        bar.set_label("pχ²")
        bar.set_ticks([0, 0.5, 1])
        _picture(grid[1, -1], frame.target)
        grid[1, -1].set_title("target")
        return save_figure(figure, stem)
