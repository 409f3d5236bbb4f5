"""The variants under conf/variant, and the leave-one-out that they must equal."""

from dataclasses import replace

from ablate.jobs.compose import job_of
from ablate.networks import GeneratorSpec
from ablate.runs.job import CUSTOM
from ablate.settings.components import components
from ablate.settings.conf_folder import conf_folder

#: The components that a generator is made of, by the name of their field; others are options of data or training.
OF_THE_NETWORK = {
    component.key.removeprefix("model."): component for component in components() if component.key.startswith("model.")
}


def leave_one_out(full: GeneratorSpec) -> dict[str, GeneratorSpec]:
    """The full specification with one component off at a time, by component name."""
    return {c.name: replace(full, **{field: c.off}) for field, c in OF_THE_NETWORK.items()}  # type: ignore[arg-type]


def variant_names() -> tuple[str, ...]:
    """Every network of conf/variant, in the order of the paper's Table II, others after; `custom` names none."""
    names = {path.stem for path in (conf_folder() / "variant").glob("*.yaml")} - {CUSTOM}
    order = ("lsa2h", "nsa2h", "sa2h-att", "sa2h-concat", "sa2h-conv", "sa2h-noise", "sa2h", "sa2h-depth")
    return (*[n for n in order if n in names], *sorted(names - set(order)))


def variant_model(name: str) -> GeneratorSpec:
    """The generator of a variant as conf/variant has it."""
    return job_of([f"variant={name}"]).settings.model
