"""The order in which variants and metrics are shown, the same everywhere."""

from collections.abc import Sequence

from ablate.metrics import METRICS, Group, metric_of

REFERENCE = "sa2h"
RESIMULATION = "re-simulation"  # shown among the variants
CHANGED = 3


def ordered_variants(variants: Sequence[str], reference: str = REFERENCE) -> list[str]:
    """Re-simulation, reference, the other variants by name, then `sa2h.depth-8` and the like; each once."""
    return sorted(set(variants), key=lambda name: (variant_group(name, reference), name.replace(".", " ")))


def variant_group(name: str, reference: str = REFERENCE) -> int:
    """Block of rows of a variant: 0 re-simulation, 1 reference, 2 variants, `CHANGED` what was changed beside one."""
    return {RESIMULATION: 0, reference: 1}.get(name, CHANGED if "." in name else 2)


def ordered_metrics(metrics: Sequence[str]) -> list[str]:
    """Metrics in the order of `METRICS`, unknown ones last by name; each once."""
    place = {name: k for k, name in enumerate(METRICS)}
    return sorted(set(metrics), key=lambda name: (place.get(name, len(place)), name))


def judged_metrics(metrics: Sequence[str]) -> list[str]:
    """Metrics that claims are made about, in the same order: all but what a network costs."""
    return [name for name in ordered_metrics(metrics) if metric_of(name).group is not Group.cost]
