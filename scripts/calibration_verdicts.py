"""Do verdicts keep their word? Simulated studies in the design of a file of conf/study: false verdicts and power.

python scripts/calibration_verdicts.py --repetitions 100                                # the tables of docs/study.md
python scripts/calibration_verdicts.py --study extension --component grain --repetitions 100   # of its extension
"""

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import pandas as pd
from tqdm import trange

from ablate.analysis import Design, Verdict, find_design, run_means, verdict_table
from ablate.command.compose import jobs_of
from ablate.settings.components import components
from ablate.study.comparable import levels_of

COMPONENTS = components("full_model")  # as docs/study.md registered them, for its extension too
NAMES = tuple(component.name for component in COMPONENTS)
EFFECTS = (0.5, 1.0, 1.5, 2.0, 3.0)
BANDS = (0.5, 1.0, 1.5, 2.0)


def runs_of(study: str) -> tuple[pd.DataFrame, Design]:
    """The runs of a study without a value, as `run_means` gives them, and their design.

    Returns
    -------
    DataFrame
        One row a primary metric of a run; value is 0.
    Design
    """
    jobs = jobs_of([f"+study={study}"])
    levels = {job.label: levels_of(job.identity) for job in jobs}
    design = find_design(levels, [component.key for component in COMPONENTS])
    assert design is not None
    rows = [
        (job.label, job.settings.seed, "0", "0", metric, 0.0, str(job.settings.scene.anatomy_seed))
        for metric in dict.fromkeys(component.metric for component in COMPONENTS)
        for job in jobs
        if job.label in design.cells.index  # others are beside it
    ]
    columns = ["variant", "seed", "frame", "site", "metric", "value", "data"]
    return run_means(pd.DataFrame(rows, columns=columns), None, design), design


def verdicts(runs: pd.DataFrame, design: Design, effects: Mapping[str, float], band: float, seed: int) -> pd.DataFrame:
    """Verdicts of one simulated study; the standard deviation of a run is 1, and metrics are independent.

    Parameters
    ----------
    runs, design
        What `runs_of` gives.
    effects : mapping of str to float
        By component, by how much it improves its metric: less is better in all primary metrics.
    band : float
        Of all components that vary in the design.
    seed : int
        Of the chance.
    """
    values = np.random.default_rng(seed).normal(size=len(runs))
    varied = [component for component in COMPONENTS if component.key in design.factors]
    for component in varied:
        on = runs[component.key] == design.cells.loc["sa2h", component.key]
        values -= effects.get(component.name, 0.0) * (on & (runs["metric"] == component.metric))
    return verdict_table(runs.assign(value=values), design, [replace(c, band=band) for c in varied]).set_index(
        "component"
    )


def shares(
    runs: pd.DataFrame, design: Design, component: str, effects: Mapping[str, float], band: float, repetitions: int
) -> dict[str, float]:
    """How often each verdict is given in simulated studies; arguments as for `verdicts`.

    Returns
    -------
    dict
        `<answer>`: of that component; `any_<answer>`: of at least one component.
    """
    counts = {f"{prefix}{word}": 0 for word in Verdict for prefix in ("", "any_")}
    for k in trange(repetitions, desc=f"{effects}, band {band:g}", leave=False, mininterval=1.0, disable=None):
        said = verdicts(runs, design, effects, band, k)["verdict"]
        for word in Verdict:
            counts[word] += int(said[component] == word)
            counts[f"any_{word}"] += int((said == word).any())
    return {name: count / repetitions for name, count in counts.items()}


def report(repetitions: int, name: str, component: str) -> Iterator[str]:
    """The tables of a study in Markdown, line by line; power is that of one component."""
    yield f"{repetitions} simulated studies a number; effects and bands in standard deviations of a run.\n"
    yield f"| improvement by one component (band 0.5) | {' | '.join(f'{size:g}' for size in (0.0, *EFFECTS))} |"
    yield f"| --- |{' --- |' * (1 + len(EFFECTS))}"
    study = runs_of(name)
    found = [shares(*study, component, {component: size}, 0.5, repetitions) for size in (0.0, *EFFECTS)]
    for word in Verdict:
        yield f"| `{word}` | {' | '.join(f'{rates[word]:.2f}' for rates in found)} |"
    yield f"\n| band, where no component improves anything | {' | '.join(f'{band:g}' for band in BANDS)} |"
    yield f"| --- |{' --- |' * len(BANDS)}"
    none = [found[0], *(shares(*study, component, {}, band, repetitions) for band in BANDS[1:])]
    for label, row in (("`does_not`, one component", "does_not"), ("`earns`, at least one component", "any_earns")):
        yield f"| {label} | {' | '.join(f'{rates[row]:.3f}' for rates in none)} |"
    at_band = shares(*study, component, dict.fromkeys(NAMES, 1.0), 1.0, repetitions)
    yield (
        "\nWhere every component improves its metric by exactly the band, a share of "
        f"{at_band['any_does_not']:.3f} of the studies says `does_not` of at least one."
    )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=500)
    parser.add_argument("--study", default="full_model", help="a file of conf/study")
    parser.add_argument("--component", default="att", help="whose power is shown")
    arguments = parser.parse_args()
    for line in report(arguments.repetitions, arguments.study, arguments.component):
        print(line, flush=True)


if __name__ == "__main__":
    main()
