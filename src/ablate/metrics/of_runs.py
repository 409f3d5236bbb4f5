"""Metrics that no pair of images gives: the simulator's error, and what a network costs."""

from ablate.metrics.metric import Direction, Group, Metric, Resimulation, Shown
from ablate.metrics.stored_names import FRAME_TIME

_COST = (Resimulation.none, Group.cost)
ENVELOPE_RMS = Metric(
    *("envelope_rms", "Envelope error", "relative RMS", Direction.lower, Resimulation.level, Group.simulation, 4),
    place=120,
)
TIME = Metric(FRAME_TIME, "Time", "ms/frame", Direction.lower, *_COST, 1, Shown.screen | Shown.report, place=130)
PARAMETERS = Metric("parameters", "Parameters", "", Direction.none, *_COST, 0, Shown.table | Shown.report, place=140)
