"""The compiled sum of scatterers against the same sum by operations of torch, which a GPU uses."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from ablate.anatomy import Tissue
from ablate.ultrasound import ConvexProbe, SimulatorSettings
from ablate.ultrasound.imaging import speckle
from ablate.ultrasound.imaging.speckle import InsonifiedLines, Speckle
from ablate.ultrasound.settings import SimulatorPrecision


def lines_of(settings: SimulatorSettings, anchor: tuple[float, ...], ranges: tuple[int, ...]) -> InsonifiedLines:
    """Samples of random tissues, a fourth of them without any sound."""
    generator = torch.Generator().manual_seed(3)
    shape = settings.layers, settings.scanlines, settings.axial_samples
    dtype = getattr(torch, settings.precision.value)
    starts = 60 * torch.randn((*shape[:2], 3), generator=generator)
    directions = torch.nn.functional.normalize(torch.randn((*shape[:2], 3), generator=generator), dim=-1)
    along = torch.linspace(0.05, 150, shape[2]).expand(ranges).contiguous()
    amplitude = torch.randn(shape, generator=generator, dtype=dtype).exp()
    amplitude[torch.rand(shape, generator=generator) < 0.25] = 0
    tissue = torch.randint(0, 3, shape, generator=generator).to(torch.uint8)
    return InsonifiedLines(starts, directions, np.array(anchor), along, tissue, amplitude)


@pytest.mark.parametrize("precision", list(SimulatorPrecision))
@pytest.mark.parametrize("anchor", [(0, 0, 0), (-(2**20), 3 * 2**20, 2**33)], ids=["near", "far"])
@pytest.mark.parametrize("of_line", [False, True], ids=["equal-ranges", "ranges-of-each-line"])
def test_equals_the_sum_by_torch(gel: Tissue, tissue: Tissue, precision, anchor, of_line, monkeypatch) -> None:
    settings = replace(SimulatorSettings(), scanlines=40, axial_samples=300, layers=3, precision=precision)
    ranges = (3, 40, 300) if of_line else (300,)
    sparse = replace(tissue, name="sparse", scatterer_density=0.01)
    dtype = getattr(torch, precision.value)
    chain = Speckle((gel, tissue, sparse), ConvexProbe(), settings, dtype)
    lines = lines_of(settings, anchor, ranges)
    compiled = chain(lines, seed=5)
    monkeypatch.setattr(speckle, "_compiled_sum", lambda: None)
    by_torch = chain(lines, seed=5)
    assert compiled.dtype is by_torch.dtype is dtype
    assert (by_torch.abs().amax(dim=(0, 2)) > 0).all()
    # They differ where a processor rounds a product and a sum once, and compiled code each.
    torch.testing.assert_close(
        compiled, by_torch, rtol=0, atol=8 * torch.finfo(dtype).eps * float(by_torch.abs().max())
    )
