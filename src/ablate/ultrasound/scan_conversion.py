"""From beam space, whose rows are depths and whose columns are scanlines, to the pixels of the image, and back.

A sample of a scanline has the same depth in every column; a pixel lies between four of them. In beam space every value
lies in the fan, shadows are columns, and the grain of speckle has one direction along a row.
"""

from functools import cached_property, lru_cache, partial

import numpy as np

from ablate.threads import in_parts
from ablate.ultrasound.compiled import Arrays, compiled
from ablate.ultrasound.probe import fan_mask, fan_of, pixel_coordinates_mm, pixel_polar, scanline_positions
from ablate.ultrasound.settings import Probe
from ablate.ultrasound.stages import Stage, stage

_RUNS_OF_A_PART = 64
Shape = tuple[int, int]


class ScanConverter:
    """Interpolation between beam space and the image of a probe; the places are computed once.

    Parameters
    ----------
    beam_shape : (rows, scanlines)
        Rows are the middles of equal parts of the imaging depth, columns the scanlines from edge to edge of the fan.
    image_shape : (H, W)
        Pixels of the fan's bounding box. The methods refuse an array of another shape by a ValueError.

    Attributes
    ----------
    mask : (H, W) bool
        The fan.
    """

    def __init__(self, probe: Probe, beam_shape: Shape, image_shape: Shape) -> None:
        self.probe, self.beam_shape, self.image_shape = probe, beam_shape, image_shape
        self.mask = fan_mask(probe, image_shape)
        depth, position = (polar[self.mask] for polar in pixel_polar(probe, image_shape))
        rows, lines = beam_shape
        along = np.clip(depth * (rows / probe.depth_mm) - 0.5, 0, rows - 1)
        across = np.clip((position / fan_of(probe).outer + 1) / 2 * (lines - 1), 0, lines - 1)
        row, line = (np.minimum(x.astype(np.int32), max(n - 2, 0)) for x, n in ((along, rows), (across, lines)))
        edges = np.flatnonzero(np.diff(np.pad(self.mask, ((0, 0), (1, 1))).ravel()))
        pixel_row, column = np.divmod(edges, image_shape[1] + 2)  # two edges a run of pixels
        wide = column[1::2] - column[::2]
        self._runs = np.stack([pixel_row[::2], column[::2], column[1::2], np.cumsum(wide) - wide], axis=-1)
        self._places = (
            (row * lines + line).astype(np.uint32),  # negative numbers would be looked for
            (across - line).astype(np.float32),
            (along - row).astype(np.float32),
        )

    @stage(Stage.scan_conversion)
    def to_image(self, beam: np.ndarray) -> np.ndarray:
        """Bilinear interpolation of (..., rows, scanlines) to (..., H, W); bytes are rounded. It is 0 outside the fan.

        The result is uint8 of uint8, else float32.
        """
        if beam.ndim > 2:
            return np.stack([self.to_image(one) for one in beam])
        is_bytes = beam.dtype == np.uint8
        image = np.zeros(self.mask.shape, np.uint8 if is_bytes else np.float32)
        fill = partial(_interpolate, _checked(beam, self.beam_shape), 0.5 * is_bytes)
        in_parts(partial(fill, self._runs, self._places, image), len(self._runs), _RUNS_OF_A_PART)
        return image

    @stage(Stage.scan_conversion)
    def labels_to_image(self, beam: np.ndarray) -> np.ndarray:
        """The label, (rows, scanlines) uint8, that is nearest to each pixel, (H, W); 0 outside the fan."""
        if beam.dtype != np.uint8:
            raise ValueError(f"labels: allowed are uint8, not {beam.dtype}")
        image = np.zeros(self.mask.shape, np.uint8)
        fill = partial(_nearest, _checked(beam, self.beam_shape), self._runs, self._places, image)
        in_parts(fill, len(self._runs), _RUNS_OF_A_PART)
        return image

    @property
    def places(self) -> np.ndarray:
        """Where each pixel lies among the scanlines and the rows, (H, W, 2) float32, NaN outside the fan.

        -1 and 1 are the first and the last of them, as `torch.nn.functional.grid_sample` takes it.
        """
        (first, across, along), (rows, lines) = self._places, self.beam_shape
        row, line = np.divmod(first, lines)
        places = np.full((*self.mask.shape, 2), np.nan, np.float32)
        for axis, value, count in ((0, line + across, lines), (1, row + along, rows)):
            places[self.mask, axis] = 2 * value / max(count - 1, 1) - 1
        return places

    def to_beam(self, image: np.ndarray) -> np.ndarray:
        """Bilinear interpolation of an image, (H, W), at the samples of the scanlines, (rows, scanlines).

        The result is uint8 of uint8, else float32. A pixel outside the fan counts as the nearest one in it.
        """
        from scipy.ndimage import map_coordinates

        filled = self._filled(image).astype(np.float32)
        values: np.ndarray = map_coordinates(filled, self._samples_px(), order=1, mode="nearest")
        return np.rint(values).astype(np.uint8) if image.dtype == np.uint8 else values

    def labels_to_beam(self, image: np.ndarray) -> np.ndarray:
        """The label of the nearest pixel of the fan, of (H, W) uint8, at each sample, (rows, scanlines)."""
        row, column = np.rint(self._samples_px()).astype(int)
        height, width = self.image_shape
        return self._filled(image)[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]

    def _filled(self, image: np.ndarray) -> np.ndarray:
        """An image whose pixels outside the fan are as the nearest one in it."""
        filled: np.ndarray = _checked(image, self.image_shape)[self._inside]
        return filled

    @cached_property
    def _inside(self) -> tuple[np.ndarray, ...]:
        """Rows and columns of the nearest pixel of the fan, (H, W) each."""
        from scipy.ndimage import distance_transform_edt

        return tuple(distance_transform_edt(~self.mask, return_distances=False, return_indices=True))

    def _samples_px(self) -> np.ndarray:
        """Row and column of each sample in the image, (2, rows, scanlines) float64, px."""
        rows, lines = self.beam_shape
        depths = (np.arange(rows) + 0.5) * (self.probe.depth_mm / rows)
        starts, directions = fan_of(self.probe).lines(scanline_positions(self.probe, lines))
        points = starts[None] + depths[:, None, None] * directions[None]
        x, z = pixel_coordinates_mm(self.probe, self.image_shape)
        spacing_x, spacing_z = fan_of(self.probe).size_mm[1] / len(x), fan_of(self.probe).size_mm[0] / len(z)
        return np.stack([(points[..., 2] - z[0]) / spacing_z, (points[..., 0] - x[0]) / spacing_x])


def _checked(array: np.ndarray, shape: Shape) -> np.ndarray:
    """An array of this shape as compiled code reads it, which does not look where arrays end; else a ValueError."""
    if array.shape != tuple(shape):
        raise ValueError(f"the array to convert must be {shape}, got {array.shape}")
    return np.ascontiguousarray(array)


@lru_cache(maxsize=4)
def scan_converter(probe: Probe, beam_shape: Shape, image_shape: Shape) -> ScanConverter:
    """The converter of a probe and two sizes; the last few are kept."""
    return ScanConverter(probe, beam_shape, image_shape)


@compiled
def _interpolate(
    beam: np.ndarray, added: float, runs: np.ndarray, places: Arrays, image: np.ndarray, begin: int, end: int
) -> None:
    """Fill some runs of pixels, (n, 4): row, columns, first pixel; for each, the first of four neighbours and parts."""
    (first, across, along), values, lines = places, beam.ravel(), beam.shape[1]
    line, deeper = np.uint64(lines > 1), np.uint64(lines if len(beam) > 1 else 0)  # to the next
    for run in range(begin, end):
        row, column, stop, pixel = runs[run]
        for ahead in range(stop - column):
            place, part = np.uint64(first[pixel + ahead]), across[pixel + ahead]
            below = place + deeper
            a, b = np.float32(values[place]), np.float32(values[place + line])
            c, d = np.float32(values[below]), np.float32(values[below + line])
            above, under = a + part * (b - a), c + part * (d - c)
            image[row, column + ahead] = above + along[pixel + ahead] * (under - above) + added


@compiled
def _nearest(beam: np.ndarray, runs: np.ndarray, places: Arrays, image: np.ndarray, begin: int, end: int) -> None:
    """Fill some runs of pixels, as `_interpolate`, with the nearest value."""
    (first, across, along), values, lines = places, beam.ravel(), beam.shape[1]
    for run in range(begin, end):
        row, column, stop, pixel = runs[run]
        for ahead in range(stop - column):
            place = np.uint64(first[pixel + ahead])
            if across[pixel + ahead] >= 0.5 and lines > 1:
                place += np.uint64(1)
            if along[pixel + ahead] >= 0.5 and len(beam) > 1:
                place += np.uint64(lines)
            image[row, column + ahead] = values[place]
