"""Where the probe may be put on the built-in anatomy."""

from ablate.anatomy.site_grid import SiteGrid


def fetal_sites() -> SiteGrid:
    """Probe sites that look at the uterus of `fetal_abdomen` through the mother's front: mm and degrees."""
    return SiteGrid(
        axis=(0.0, 0.0, 1.0),
        front=(0.0, -1.0, 0.0),
        heights_mm=tuple(float(height) for height in range(-60, 75, 15)),
        angles_deg=tuple(float(angle) for angle in range(-48, 49, 12)),
        tilts_deg=(-15.0, 0.0, 15.0),
        rolls_deg=(0.0, 90.0),
        region=("uterus",),
    )
