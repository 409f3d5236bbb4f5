"""The variants under conf/variant, and the leave-one-out that they must equal."""

from dataclasses import replace

from ablate.networks import COMPONENTS, GeneratorSpec
from ablate.studies.jobs.compose import jobs_of
from ablate.studies.jobs.conf_folder import configuration_dir
from ablate.studies.jobs.job import CUSTOM

#: The components that a generator is made of; the others are options of the data set.
OF_THE_NETWORK = tuple(component for component in COMPONENTS if hasattr(GeneratorSpec, component.field))


def leave_one_out(full: GeneratorSpec) -> dict[str, GeneratorSpec]:
    """The full specification with one component off at a time, by component name."""
    return {c.name: replace(full, **{c.field: c.off}) for c in OF_THE_NETWORK}


def variant_names() -> tuple[str, ...]:
    """Every network of conf/variant, in the order of the paper's Table II, others after; `custom` names none."""
    found = {path.stem for path in (configuration_dir() / "variant").glob("*.yaml")} - {CUSTOM}
    order = ("lsa2h", "nsa2h", "sa2h-att", "sa2h-concat", "sa2h-conv", "sa2h-noise", "sa2h", "sa2h-depth")
    return (*[n for n in order if n in found], *sorted(found - set(order)))


def variant_model(name: str) -> GeneratorSpec:
    """The generator of a variant as conf/variant has it."""
    return jobs_of([f"variant={name}"])[0].settings.model
