"""The order in which variants and metrics are shown, the same everywhere."""

from __future__ import annotations

from collections.abc import Sequence

from ablate.analysis.metric_facts import METRICS, REFERENCE, RESIMULATION

CHANGED = 3


def ordered_variants(variants: Sequence[str], reference: str = REFERENCE) -> list[str]:
    """Re-simulation, reference, the other variants by name, then what was changed beside a variant (`sa2h.depth-8`).

    Parameters
    ----------
    variants : sequence of str
    reference : str

    Returns
    -------
    list of str
        Without repetitions.
    """
    return sorted(set(variants), key=lambda name: (variant_group(name, reference), name.replace(".", " ")))


def variant_group(name: str, reference: str = REFERENCE) -> int:
    """Which block of rows a variant belongs to: 0 re-simulation, 1 reference, 2 variants, `CHANGED` what was changed
    beside one.

    Parameters
    ----------
    name, reference : str

    Returns
    -------
    int
    """
    return {RESIMULATION: 0, reference: 1}.get(name, CHANGED if "." in name else 2)


def ordered_metrics(metrics: Sequence[str]) -> list[str]:
    """Metrics in the order of `METRICS`, unknown ones last by name.

    Parameters
    ----------
    metrics : sequence of str

    Returns
    -------
    list of str
        Without repetitions.
    """
    place = {name: k for k, name in enumerate(METRICS)}
    return sorted(set(metrics), key=lambda name: (place.get(name, len(place)), name))
