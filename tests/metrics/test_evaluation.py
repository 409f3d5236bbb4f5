"""One image, all metrics: names, what is left out, extremes, speed."""

import sys
import time

import numpy as np
import pytest

from ablate.metrics import METRICS, Metric, Pair, evaluate_image, psnr

NAMES = {
    "psnr", "psnr_fan", "mae", "mae_fan", "pchi2", "pchi2_fan", "pchi2_tissue",
    "shadow_contrast", "mae_smooth", "thin_contrast", "nyquist_excess",
    "octave_sd", "crps", "noise_sd",
}  # fmt: skip


def test_names_are_those_that_runs_log(make_frame):
    frame = make_frame(0)
    images = np.stack([make_frame(k).image for k in (1, 2)])
    values = evaluate_image(frame.pair(images[0], draws=images))
    assert set(values) == {name for name, metric in METRICS.items() if metric.of_image or metric.of_draws} == NAMES
    assert values["psnr"] == psnr(make_frame(1).image, frame.image)
    assert values["pchi2"] < values["pchi2_fan"], "patches outside the fan are right for nothing"


def test_patches_of_the_frame_the_fan_and_tissue(make_frame):
    """Each figure from the patches' own histograms, patch by patch."""
    frame, other = make_frame(0), make_frame(1)
    edges = np.linspace(0, 255, 51)
    squares = {"pchi2": [], "pchi2_fan": [], "pchi2_tissue": []}
    for i in range(0, frame.image.shape[0] - 19, 20):
        for j in range(0, frame.image.shape[1] - 19, 20):
            window = (slice(i, i + 20), slice(j, j + 20))
            h, k = (np.histogram(x[window], edges)[0] / 400 for x in (frame.image, other.image))
            chi2 = 0.5 * np.sum((h - k)[h + k > 0] ** 2 / (h + k)[h + k > 0])
            squares["pchi2"].append(chi2**2)
            if frame.mask[window].all():
                squares["pchi2_fan"].append(chi2**2)
            if frame.mask[window].all() and frame.tissue[window].all():
                squares["pchi2_tissue"].append(chi2**2)
    values = evaluate_image(frame.pair(other.image))
    for name, found in squares.items():
        assert values[name] == pytest.approx(np.sqrt(np.mean(found)), rel=1e-12)


def test_metrics_without_their_input_are_left_out(make_frame):
    frame = make_frame(0)
    bare = evaluate_image(Pair(frame.image, frame.image, frame.mask))
    of_maps, of_draws = {"pchi2_tissue", "shadow_contrast", "thin_contrast", "octave_sd"}, {"crps", "noise_sd"}
    assert set(bare) == NAMES - of_maps - of_draws
    assert set(evaluate_image(frame.pair(frame.image))) == NAMES - of_draws
    outside = evaluate_image(frame.pair(frame.image, mask=np.zeros_like(frame.mask)))
    assert set(outside) == {"psnr", "mae", "pchi2"}
    for wrong in ({"depth_mm": frame.depth_mm[1:]}, {"draws": frame.image[None]}, {"target": frame.image[1:]}):
        with pytest.raises(ValueError, match="must"):
            frame.pair(frame.image, **wrong)


@pytest.mark.parametrize(
    "write",
    [
        lambda pair: np.copyto(pair.prediction, pair.target, where=pair.mask),
        lambda pair: pair.mask[:40].fill(False),
        lambda pair: np.multiply(pair.depth_mm, 2, out=pair.depth_mm),
        lambda pair: pair.draws.__setitem__(0, 0),
        lambda pair: pair.chi2_map.sort(),
    ],
    ids=["prediction", "mask", "depth", "draws", "chi2_map"],
)
def test_a_metric_that_writes_to_its_pair_is_refused_by_name(make_frame, write):
    frame = make_frame(0, shape=(100, 140))
    kept = frame.image.copy(), frame.mask.copy(), frame.depth_mm.copy()
    wrong = Metric("careless", of_image=write)
    pair = frame.pair(frame.image // 2, draws=np.stack([frame.image] * 2))
    with pytest.raises(ValueError, match="the metric careless writes to an array of its pair"):
        evaluate_image(pair, [wrong, METRICS["mae"]])
    for before, after in zip(kept, (frame.image, frame.mask, frame.depth_mm), strict=True):
        np.testing.assert_array_equal(before, after)
    frame.image[0, 0] += 1  # the caller's own arrays are not locked


def test_a_metric_is_one_module_and_stands_where_it_says():
    places = [metric.place for metric in METRICS.values()]
    assert places == sorted(set(places)), "in rising order, no two alike"
    modules = [module for name, module in sys.modules.items() if name.startswith("ablate.metrics.")]
    owners = {n: [m for m in modules if any(METRICS[n] is value for value in vars(m).values())] for n in METRICS}
    assert {len(found) for found in owners.values()} == {1}


@pytest.mark.slow
def test_a_full_size_frame_takes_well_under_a_second(make_frame):
    frame, other = (make_frame(k, shape=(1000, 1386)) for k in (0, 1))
    evaluate_image(frame.pair(other.image))
    times = []
    for _ in range(5):
        start = time.process_time()
        evaluate_image(frame.pair(other.image))
        times.append(time.process_time() - start)
    assert min(times) < 0.2
