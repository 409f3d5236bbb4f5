"""A body that renders in milliseconds, a probe on it, a port for a page, and patience."""

import socket
import time
from collections.abc import Callable
from contextlib import closing

import numpy as np
import trimesh

from ablate.anatomy import Scene, Structure, Tissue
from ablate.ultrasound import ConvexProbe, SimulatorSettings
from ablate.viewer.session import ViewerState

_SKIN, _BONE = Tissue("soft_tissue", 1540, 1.6, 0.5, 0.6, 0.0, 1.0), Tissue("bone", 3200, 6.0, 10.0)
_CYLINDERS = (
    Structure(trimesh.creation.cylinder(radius=radius, height=height, sections=180), tissue)
    for radius, height, tissue in ((100, 200.0, _SKIN), (20, 150.0, _BONE))
)
#: A cylinder of tissue along z with a bone in its middle; the probe looks along +y from angle 0.
BODY = Scene(tuple(_CYLINDERS), Tissue("gel"), "body")
_POSE = np.array([[1.0, 0, 0, 0], [0, 0, 1, -95], [0, -1, 0, 10], [0, 0, 0, 1]])  # x across, y down the body, z into it
_SIZE = SimulatorSettings(scanlines=16, axial_samples=128, rays=8, layers=3, image_shape=(48, 66))
STATE = ViewerState(_POSE, ConvexProbe(frequency_mhz=3.0), _SIZE, None)


def free_port() -> int:
    """A port that nothing listens on, another one each time."""
    with closing(socket.socket()) as trial:
        trial.bind(("127.0.0.1", 0))
        return int(trial.getsockname()[1])


def until(holds: Callable[[], object], within_s: float = 20.0) -> None:
    """Wait until something holds."""
    end = time.monotonic() + within_s
    while not holds():
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.005)
