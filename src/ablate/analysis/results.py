"""What a study came to, as one value: the tables and pictures that its figures and its report are made from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import pandas as pd

from ablate.analysis.components import Component, told_by
from ablate.analysis.pictures import FramePictures
from ablate.analysis.scored import REFERENCE, RESIMULATION, ordered_metrics
from ablate.analysis.statistics.component_claims import seed_claims
from ablate.analysis.statistics.designs import Design, effects_table
from ablate.analysis.statistics.paired import paired_table
from ablate.analysis.statistics.verdicts import verdict_table
from ablate.analysis.summaries import comparison_table


@dataclass(frozen=True, eq=False)
class StudyResults:
    """The scores and pictures of a study; the tables that follow from them are made when they are first asked for.

    Attributes
    ----------
    per_image : DataFrame
        Columns variant, seed, frame, site, metric, value: one row a metric of a test frame of a run. The variant
        `re-simulation` is the same frames simulated again.
    scalars : DataFrame, optional
        Columns variant, seed, metric, value, lower, upper: one row a metric that only a run has.
    reference : str
        The variant that the others are compared with.
    blocks : DataFrame, optional
        Rows as in `per_image` of runs on other anatomies or data sets, which verdicts use too; then both tables have a
        column data.
    design : Design, optional
        Which experiment the runs make up; None where no component varies.
    means : DataFrame, optional
        What `run_means` gives of the runs of the design.
    components : sequence of Component
        What can be judged.
    levels : mapping of str to list, optional
        By dotted key, the levels that runs have: verdicts are of components of keys in which runs differ. Without it
        they are of all.
    spreads : mapping of str to float
        By cost, the spread of its measurement, as for `verdict_table`.
    pictures : sequence of FramePictures
        Test frames to show.
    machine : str
        The device that the networks were timed on.
    """

    per_image: pd.DataFrame
    scalars: pd.DataFrame | None = None
    reference: str = REFERENCE
    blocks: pd.DataFrame | None = None
    design: Design | None = None
    means: pd.DataFrame = field(default_factory=pd.DataFrame)
    components: Sequence[Component] = ()
    levels: Mapping[str, Sequence[object]] | None = None
    spreads: Mapping[str, float] = field(default_factory=dict)
    pictures: Sequence[FramePictures] = ()
    machine: str = ""

    @property
    def metrics(self) -> list[str]:
        """The metrics of images that its frames have, in the order of tables."""
        return ordered_metrics(list(self.per_image["metric"]))

    @property
    def resimulated(self) -> bool:
        """Whether its frames were simulated again, which pairs made elsewhere may lack."""
        return RESIMULATION in set(self.per_image["variant"])

    @cached_property
    def table(self) -> pd.DataFrame:
        """Mean and spread of every metric of every variant; see `comparison_table`."""
        return comparison_table(self.per_image, self.scalars, self.reference)

    @cached_property
    def paired(self) -> pd.DataFrame:
        """Every variant beside the reference, frame by frame; see `paired_table`."""
        return paired_table(self.per_image, self.reference)

    @cached_property
    def claims(self) -> pd.DataFrame:
        """Which variants may be said to differ from the reference; see `seed_claims`."""
        return seed_claims(self.per_image, self.scalars, self.reference)

    @cached_property
    def effects(self) -> pd.DataFrame:
        """Effects of all components on all metrics, see `effects_table`; empty without a design."""
        return pd.DataFrame() if self.design is None else effects_table(self.means, self.design)

    @cached_property
    def verdicts(self) -> pd.DataFrame:
        """What is known of every component in which runs differ; see `verdict_table`."""
        judged = self.components if self.levels is None else told_by(self.levels, self.components)
        return verdict_table(self.means, self.design, judged, self.spreads)
