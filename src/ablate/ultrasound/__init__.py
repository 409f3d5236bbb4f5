"""Monte-Carlo ray tracing of B-mode frames, with the label and attenuation maps that go with them."""

from ablate.ultrasound.probe import fan_mask
from ablate.ultrasound.settings import (
    SIMULATOR_VERSION,
    ConvexProbe,
    DepthMode,
    Frame,
    Plan,
    Precision,
    SimulatorSettings,
)
from ablate.ultrasound.simulator import Simulator

__all__ = [
    "SIMULATOR_VERSION",
    "ConvexProbe",
    "DepthMode",
    "Frame",
    "Plan",
    "Precision",
    "Simulator",
    "SimulatorSettings",
    "fan_mask",
]
