"""A trained generator, ready for the frames of a scene, and how far it was trained for what is seen."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from ablate.dataset import maps_read, network_inputs
from ablate.dataset.frame_maps import FrameMaps
from ablate.networks import Space, conditions
from ablate.pretrained import Renderer, trained_with
from ablate.ultrasound import Probe, scan_converter
from ablate.viewer.fast_generator import FastGenerator
from ablate.viewer.session import ViewerState


@dataclass(frozen=True, eq=False)
class Trained:
    """A generator, ready to render frames of a scene.

    `values`, (labels, channels) float32, is what it reads for each label of the scene; `unknown` says which tissues of
    the scene it was not trained on, and is empty if there are none.
    """

    renderer: Renderer
    engine: FastGenerator
    values: np.ndarray
    unknown: str

    @property
    def reads(self) -> tuple[str, ...]:
        return conditions(self.renderer.generator.spec)

    @property
    def space(self) -> Space:
        return self.renderer.generator.spec.space

    def render(
        self, maps: FrameMaps, low: np.ndarray | None, mask: np.ndarray, probe: Probe, seed: int, fast: bool
    ) -> np.ndarray:
        """Render a frame of the scene.

        Parameters
        ----------
        maps : FrameMaps
            S and A, (H, W) each, and the maps in beam space.
        low : array or None
            The low-quality image in the space of the generator, where it reads one.
        mask : (H, W) bool
            The fan.
        probe : Probe
            Of the frame.
        seed : int
            Of the noise.
        fast : bool
            Whether the image may come from OpenVINO.

        Returns
        -------
        (H, W) uint8
        """
        read = maps_read(self.reads, self.space, maps, probe, self.renderer.simulator.time_gain)
        if low is not None:
            read["low"] = low
        if self.space is Space.image:
            return self._generated(read, mask, seed, fast)
        rows, lines = maps[2].segmentation.shape
        image = self._generated(read, np.ones((rows, lines), bool), seed, fast)
        return scan_converter(probe, (rows, lines), (mask.shape[0], mask.shape[1])).to_image(image)

    def _generated(self, read: Mapping[str, np.ndarray], mask: np.ndarray, seed: int, fast: bool) -> np.ndarray:
        """The image in the space of the generator."""
        inputs = network_inputs({name: value[None] for name, value in read.items()}, self.values, mask)
        return self.engine.render(inputs, torch.from_numpy(mask), torch.tensor([seed]), fast)

    def reservation(self, state: ViewerState) -> str:
        """Say in what a state differs from the training; empty if it does not."""
        trained = self.renderer.probe, self.renderer.simulator
        said = trained_with(trained, (state.probe, state.simulator), self.space)
        return "; ".join(words for words in (said, self.unknown) if words)
