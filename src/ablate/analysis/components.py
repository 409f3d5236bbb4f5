"""A component of a study, as values."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Component:
    """One switch of a study.

    Attributes
    ----------
    name : str
        The variant without this component is `sa2h-<name>`.
    key : str
        The dotted configuration key that it switches, such as `model.attenuation`.
    on, off : object
        The level of the full model, and the level that stands for "without the component"; None where not declared.
    label, purpose : str
        A short name, and one sentence.
    metric : str or None
        Its primary metric, named before the runs are scored.
    band : float or None
        The improvement that is too small to matter, in units of the metric, fixed before the runs are scored.
    """

    name: str
    key: str
    on: object = None
    off: object = None
    label: str = ""
    purpose: str = ""
    metric: str | None = None
    band: float | None = None
