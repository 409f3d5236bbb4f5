"""Metrics that no pair of images gives: of the simulator's signal, and what a network costs."""

from ablate.metrics.metric import FRAME_TIME, Direction, Group, Metric, Resimulation, Shown

ENVELOPE_RMS = Metric(
    name="envelope_rms",
    label="Envelope error",
    unit="relative RMS",
    better=Direction.lower,
    resimulation=Resimulation.level,
    group=Group.simulation,
    decimals=4,
    place=120,
)
TIME = Metric(
    name=FRAME_TIME,
    label="Time",
    unit="ms/frame",
    better=Direction.lower,
    group=Group.cost,
    decimals=1,
    shown=Shown.screen | Shown.report,
    place=130,
)
PARAMETERS = Metric(
    name="parameters",
    label="Parameters",
    group=Group.cost,
    decimals=0,
    shown=Shown.table | Shown.report,
    place=140,
)
