"""The variants under conf/variant, the leave-one-out that they must equal, and the table that describes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from ablate.networks import (
    Attenuation,
    Concat,
    ExtraInput,
    Family,
    GeneratorSpec,
    Noise,
    Upsampling,
    count_discriminator,
    count_generator,
    inputs,
    receptive_field,
)
from ablate.studies.sweep import Job, configuration_dir, jobs_of

# What "without the component" means, for each component of the paper and the receptive field.
OFF: dict[str, dict[str, object]] = {
    "att": {"attenuation": Attenuation.none},
    "concat": {"concat": Concat.input},
    "conv": {"upsampling": Upsampling.transposed},
    "noise": {"noise": Noise.input},
    "depth": {"depth": 8},
}


def leave_one_out(full: GeneratorSpec) -> dict[str, GeneratorSpec]:
    """The full specification with one component off at a time, by component name."""
    return {name: replace(full, **change) for name, change in OFF.items()}  # type: ignore[arg-type]


def variant_names() -> tuple[str, ...]:
    """Every file of conf/variant, in the order of the paper's Table II, others after."""
    found = {path.stem for path in Path(configuration_dir() / "variant").glob("*.yaml")}
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
        jobs = [jobs_of([*base, f"variant={name}"])[0] for name in variant_names()]
        labels = [j.settings.variant for j in jobs]
    else:
        labels = [j.label for j in jobs]
    specs = dict(zip(labels, [j.settings.model for j in jobs], strict=True))
    return pd.DataFrame([_row(label, spec) for label, spec in specs.items()])


def _row(label: str, spec: GeneratorSpec) -> dict[str, object]:
    paper = replace(spec, width=1.0)
    generator, discriminator = count_generator(paper), count_discriminator(paper)
    row: dict[str, object] = {
        "variant": label,
        "family": spec.family.value,
        "att": spec.attenuation is Attenuation.integral,
        "concat": spec.concat is Concat.every_level,
        "conv": spec.upsampling is Upsampling.texture,
        "noise": spec.noise.value if spec.extra_input is not ExtraInput.noise else "input",
        "depth": spec.depth,
        "inputs": "+".join(inputs(spec)),
        "receptive_field_px": receptive_field(spec),
        "generator": generator,
        "discriminator": discriminator,
        "total": generator + discriminator,
    }
    if spec.width != 1.0:
        row[f"total_at_width_{spec.width:g}"] = count_generator(spec) + count_discriminator(spec)
    if spec.family is Family.unet:
        row["concat"] = row["conv"] = False
    return row
