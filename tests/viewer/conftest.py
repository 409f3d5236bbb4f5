"""A body that renders in milliseconds, and a port for a page."""

import socket
from collections.abc import Callable
from contextlib import closing

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene, Structure, Tissue
from ablate.ultrasound import ConvexProbe, SimulatorSettings
from ablate.viewer.session import State

SKIN = Tissue("soft_tissue", 1540, 1.6, 0.5, 0.6, 0.0, 1.0)
BONE = Tissue("bone", 3200, 6.0, 10.0)
SIZE = SimulatorSettings(scanlines=16, axial_samples=128, rays=8, layers=3, image_shape=(48, 66))


def cylinder(radius: float, height: float = 200.0) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius=radius, height=height, sections=180)


@pytest.fixture(scope="session")
def body() -> Scene:
    """A cylinder of tissue along z with a bone in its middle; the probe looks along +y from angle 0."""
    return Scene((Structure(cylinder(100), SKIN), Structure(cylinder(20, 150.0), BONE)), Tissue("gel"), "body")


@pytest.fixture
def state() -> State:
    pose = np.eye(4)
    pose[:3, :3] = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]).T  # x across, y down the body, z into it
    pose[:3, 3] = 0, -95, 10
    return State(pose, ConvexProbe(frequency_mhz=3.0), SIZE, None)


@pytest.fixture(scope="session")
def free_port() -> Callable[[], int]:
    """Finds a port that nothing listens on, another one each time."""

    def find() -> int:
        with closing(socket.socket()) as trial:
            trial.bind(("127.0.0.1", 0))
            return int(trial.getsockname()[1])

    return find
