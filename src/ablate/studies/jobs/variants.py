"""The variants under conf/variant, the leave-one-out that they must equal, and the table that describes them."""

from collections.abc import Sequence
from dataclasses import replace

import pandas as pd

from ablate import networks
from ablate.networks import COMPONENTS, Component, ExtraInput, GeneratorSpec, Noise
from ablate.studies.jobs.compose import jobs_of
from ablate.studies.jobs.job import Job
from ablate.studies.jobs.schema import configuration_dir

_OF_THE_NETWORK = tuple(component for component in COMPONENTS if hasattr(GeneratorSpec, component.field))


def leave_one_out(full: GeneratorSpec) -> dict[str, GeneratorSpec]:
    """The full specification with one component off at a time, by component name."""
    return {c.name: replace(full, **{c.field: c.off}) for c in _OF_THE_NETWORK}


def variant_names() -> tuple[str, ...]:
    """Every file of conf/variant, in the order of the paper's Table II, others after."""
    found = {path.stem for path in (configuration_dir() / "variant").glob("*.yaml")}
    order = ("lsa2h", "nsa2h", "sa2h-att", "sa2h-concat", "sa2h-conv", "sa2h-noise", "sa2h", "sa2h-depth")
    return (*[n for n in order if n in found], *sorted(found - set(order)))


def variant_model(name: str) -> GeneratorSpec:
    """The generator of a variant as conf/variant has it."""
    return jobs_of([f"variant={name}"])[0].settings.model


def describe(jobs: Sequence[Job]) -> pd.DataFrame:
    """One row a variant: components, inputs, receptive field, parameters at the paper's width and at this preset's.

    A single job asks for all variants; a sweep for its own.
    """
    if len(jobs) == 1:
        base = [f"preset={jobs[0].settings.preset}", f"model.width={jobs[0].settings.model.width}"]
        jobs = jobs_of(["-m", *base, f"variant={','.join(variant_names())}"])
        labels = [j.settings.variant for j in jobs]
    else:
        labels = [j.label for j in jobs]
    specs = dict(zip(labels, [j.settings.model for j in jobs], strict=True))
    return pd.DataFrame([_row(label, spec) for label, spec in specs.items()])


def _row(label: str, spec: GeneratorSpec) -> dict[str, object]:
    paper = replace(spec, width=1.0)
    generator, discriminator = networks.count_generator(paper), networks.count_discriminator(paper)
    row: dict[str, object] = {
        "variant": label,
        "family": spec.family.value,
        **{component.name: _level(spec, component) for component in _OF_THE_NETWORK},
        "inputs": "+".join(networks.inputs(spec)),
        "receptive_field_px": networks.receptive_field(spec),
        "generator": generator,
        "discriminator": discriminator,
        "total": generator + discriminator,
    }
    if spec.width != 1.0:
        row[f"total_at_width_{spec.width:g}"] = networks.count_generator(spec) + networks.count_discriminator(spec)
    return row


def _level(spec: GeneratorSpec, component: Component) -> object:
    """Whether a component with two levels is on, or else its level."""
    level = getattr(spec, component.field)
    if len(component.levels) == 2:
        return level == component.on
    if component.field == "noise" and spec.extra_input is ExtraInput.noise:
        return Noise.input.value
    return str(level) if isinstance(level, str) else level
