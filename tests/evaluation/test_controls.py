"""Each component's primary metric sees what the component is for: a positive control on simulated frames."""

from collections.abc import Callable, Mapping

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from ablate.command.compose import jobs_of
from ablate.dataset import Part
from ablate.evaluation import ImageSource, Scorer, resimulation_images
from ablate.metrics import METRICS, choose_metrics
from ablate.networks import Space
from ablate.settings.components import components
from ablate.sources.data_set import DataSet, maps_needed
from ablate.sources.prepare import prepare_data

_FIND = ["preset=tiny", "simulator.scanlines=64", "simulator.axial_samples=384", "simulator.image_shape=[256,355]"]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    (job,) = jobs_of([*_FIND, "dataset.test=0.5", f"runs_dir={tmp_path_factory.mktemp('runs')}"])
    return prepare_data(job.settings, job.data, job.identity["data"], maps_needed([job.settings.model]))


def _checkerboard(frames: np.ndarray) -> np.ndarray:
    return frames + 20 * (-1) ** np.indices(frames.shape[1:]).sum(axis=0)


def _rougher(frames: np.ndarray) -> np.ndarray:
    smooth = np.stack([gaussian_filter(frame, 4) for frame in frames])
    return smooth + 1.3 * (frames - smooth)


#: What goes wrong without a component, by its metric, of frames in beam space; (k, rows, scanlines) float.
WRONG: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "shadow_contrast": lambda frames: np.maximum(frames, 60),
    "thin_contrast": lambda frames: np.minimum(frames, 150),
    "nyquist_excess": _checkerboard,
    "mae_smooth": lambda frames: frames + np.linspace(-25, 25, frames.shape[1])[:, None],
    "octave_sd": _rougher,
    "pchi2_tissue": lambda frames: frames + 15,
}


def _scores(data: DataSet, metric: str, wrong: Callable[[np.ndarray], np.ndarray]) -> float:
    """The mean score of re-simulated frames with something wrong, as of a network that works in beam space."""
    pairs = data.pairs
    assert pairs.probe is not None

    def in_beam(frames: np.ndarray, _: int) -> np.ndarray:
        changed = wrong(pairs.read("resimulation", frames, Space.beam).astype(float))
        return np.clip(np.rint(changed), 0, 255).astype(np.uint8)

    images: ImageSource = lambda frames, draw: pairs.converter.to_image(in_beam(frames, draw))  # noqa: E731
    scorer = Scorer(pairs, data.tissues, pairs.probe, metrics=choose_metrics([metric]))
    return scorer.score(Part.test, images, draws_noise=False, beam_images=in_beam).scalars[metric]


#: What moves with the body is told by `tests/metrics/mechanism/test_motion.py`.
OF_FRAMES = [component for component in components() if not METRICS[component.metric].of_motion]


@pytest.mark.parametrize("component", OF_FRAMES, ids=lambda component: component.name)
def test_a_metric_sees_what_its_component_is_for(data: DataSet, component) -> None:
    right = _scores(data, component.metric, lambda frames: frames)
    assert _scores(data, component.metric, WRONG[component.metric]) - right > component.band


def test_scan_conversion_hides_the_pattern_that_is_seen_on_the_networks_grid(data: DataSet) -> None:
    pairs = data.pairs
    assert pairs.probe is not None
    scorer = Scorer(pairs, data.tissues, pairs.probe, metrics=choose_metrics(["nyquist_excess"]))
    clean = scorer.score(Part.test, resimulation_images(pairs), draws_noise=False).scalars["nyquist_excess"]

    def patterned(frames: np.ndarray, _: int) -> np.ndarray:
        changed = _checkerboard(pairs.read("resimulation", frames, Space.beam).astype(float))
        return pairs.converter.to_image(np.clip(np.rint(changed), 0, 255).astype(np.uint8))

    hidden = scorer.score(Part.test, patterned, draws_noise=False).scalars["nyquist_excess"]
    assert hidden - clean < 1 < _scores(data, "nyquist_excess", _checkerboard) - clean
