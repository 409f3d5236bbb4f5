"""What `task=describe` prints: the components of variants, what they see of a frame beside the paper's, their sizes."""

from collections.abc import Sequence
from dataclasses import replace

import pandas as pd

from ablate import networks
from ablate.anatomy import load_tissues
from ablate.command.compose import job_of
from ablate.command.scale import PAPER_CROP, PAPER_ROWS, paper_levels
from ablate.command.words import quoted
from ablate.dataset.encoding import label_values
from ablate.networks import GeneratorSpec, PatchDiscriminator, Space
from ablate.networks.spec import Fold, rows_of_a_cell
from ablate.settings.components import components_of_networks, named_components
from ablate.settings.conf import variant_names
from ablate.settings.study import StudySettings
from ablate.study.job import Job, parameters
from ablate.ultrasound.probe import fan_of
from ablate.ultrasound.pulse import pulse_in_words
from ablate.ultrasound.settings import ConvexProbe, Probe, SimulatorSettings

_UNKNOWN = "-"
_PAPER_MM = fan_of(ConvexProbe()).size_mm[0]


def described(jobs: Sequence[Job]) -> pd.DataFrame:
    """One row a variant, indexed by it: components, inputs, and receptive field and parameters at two sizes.

    A single job asks for all variants at its sizes; a sweep for its own. Lengths are px, mm and per cent of the frame's
    height; in beam space, of a scanline. The paper's size is the levels that a network has in the paper's
    frame, and width 1; it is None where no network of the paper's frame is so deep.
    """
    rows = {label: _row(settings) for label, settings in _variants(jobs)}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("variant")


def description(jobs: Sequence[Job]) -> str:
    """`described` as text of at most 120 columns (with the variants of conf/), and what is the same for all of them."""
    table = described(jobs).map(_cell).reset_index()
    paper = "paper's size: "
    parts = {
        "components": {n: n for n in ("family", *(c.name for c in components_of_networks().values()))},
        "inputs": {"inputs": "inputs"},
        "receptive field of the generator: px, mm, and % of the frame's height": {
            "depth": "levels",
            "field_px": "px",
            "field_mm": "mm",
            "field_percent": "%",
            "paper_depth": paper + "levels",
            "paper_field_px": "px",
            "paper_field_mm": "mm",
            "paper_field_percent": "%",
        },
        "parameters, at the paper's size with width 1 and the paper's levels": {
            "total_here": "here: total",
            "generator": paper + "generator",
            "discriminator": "discriminator",
            "total": "total",
        },
    }
    tables = [
        f"{title}\n{table[['variant', *columns]].rename(columns=columns).to_string(index=False)}"
        for title, columns in parts.items()
    ]
    same = dict.fromkeys(line for job in jobs for line in _same_for_all(job.settings))
    return "\n\n".join([*tables, "\n".join(same)])


def _variants(jobs: Sequence[Job]) -> list[tuple[str, StudySettings]]:
    """Label and settings of each row: the generator and the loss of the variant, the frames of the job."""
    if len(jobs) > 1:
        return [(job.label, job.settings) for job in jobs]
    s = jobs[0].settings
    height, width = s.simulator.image_shape
    sizes = [f"preset={s.preset}", f"model.width={s.model.width}", f"simulator.image_shape=[{height},{width}]"]
    sizes.append(f"scene={s.scene.kind}")  # pairs made elsewhere have other maps
    if s.scene.folder:
        sizes.append(f"scene.folder={quoted(s.scene.folder)}")
    rows = {} if jobs[0].label in variant_names() else {jobs[0].label: s}
    for name in variant_names():
        m = job_of([*sizes, f"variant={name}"]).settings
        rows[name] = replace(s, model=m.model, encoding=m.encoding, training=replace(s.training, loss=m.training.loss))
    return [*rows.items()]


def _row(settings: StudySettings) -> dict[str, object]:
    values = label_values(tuple(load_tissues().values()), settings.encoding)
    spec, labels = settings.model, values.shape[1]
    rows = settings.simulator.image_shape[0]
    at_paper = paper_levels(spec.depth, rows)
    row: dict[str, object] = {
        **named_components(spec),
        **_field(spec, labels, "field", *_height(spec.space, settings.simulator, settings.probe)),
        "total_here": sum(parameters(settings, spec, labels).values()),
        "paper_depth": at_paper,
    }
    if at_paper is None:
        return row
    paper = replace(spec, width=1.0, depth=at_paper, fold=Fold.none)
    at_width_1 = replace(settings.training, discriminator_width=None)
    generator, discriminator = parameters(replace(settings, training=at_width_1), paper, labels).values()
    sizes = {"generator": generator, "discriminator": discriminator, "total": generator + discriminator}
    return row | _field(paper, labels, "paper_field", *_height(spec.space, SimulatorSettings(), ConvexProbe())) | sizes


def _height(space: Space, simulator: SimulatorSettings, probe: Probe) -> tuple[int, float]:
    """Rows of a frame in the space of a network, and their mm."""
    if space is Space.beam:
        return simulator.beam_shape[0], probe.depth_mm
    return simulator.image_shape[0], fan_of(probe).size_mm[0]


def _field(spec: GeneratorSpec, labels: int, name: str, rows: int, height_mm: float) -> dict[str, object]:
    px = networks.receptive_field(spec, labels)
    if px is None:
        return dict.fromkeys((f"{name}_px", f"{name}_mm", f"{name}_percent"))
    px *= rows_of_a_cell(spec)
    return {f"{name}_px": px, f"{name}_mm": px * height_mm / rows, f"{name}_percent": 100 * px / rows}


def _same_for_all(settings: StudySettings) -> list[str]:
    """The frame, the crop and the discriminator's patch, in the space of the network, beside the paper's; the pulse."""
    simulator, space = settings.simulator, settings.model.space
    rows, height = _height(space, simulator, settings.probe)
    columns = (simulator.beam_shape if space is Space.beam else simulator.image_shape)[1]
    patch = networks.patch_size(PatchDiscriminator(networks.discriminator_channels(settings.model), 0.01))
    lengths = {"crop": (settings.training.crop or rows, PAPER_CROP), "patch of the discriminator": (patch, patch)}
    simulated = [] if settings.scene.kind == "pairs" else [pulse_in_words(settings.probe, simulator)]
    return [
        f"frame: {rows} x {columns} px of {height / rows:.2f} mm (in the paper: {PAPER_ROWS} rows of "
        f"{_PAPER_MM / PAPER_ROWS:.2f} mm)",
        *(
            f"{name}: {_length(px, rows, height)} of the frame's height (in the paper: "
            f"{_length(paper, PAPER_ROWS, _PAPER_MM)})"
            for name, (px, paper) in lengths.items()
        ),
        *simulated,
    ]


def _length(px: int, rows: int, height_mm: float) -> str:
    return f"{px} px, {px * height_mm / rows:.0f} mm, {100 * px / rows:.0f} %"


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value
    if value is None or value != value:
        return _UNKNOWN
    return f"{value:,.0f}"
