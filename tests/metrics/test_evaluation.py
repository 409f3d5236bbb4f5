"""One image, all metrics: names, what is left out, what is written to."""

import sys

import numpy as np
import pytest
import torch

from ablate.metrics import METRICS, Metric, Pair, evaluate_image, patch_chi2, psnr

NAMES = {name for name, metric in METRICS.items() if metric.of_image or metric.of_draws}


def test_names_are_those_that_runs_log(make_frame):
    frame = make_frame(0)
    images = np.stack([make_frame(k).image for k in (1, 2)])
    values = evaluate_image(frame.pair(images[0], draws=images))
    assert set(values) == NAMES
    assert values["psnr"] == psnr(make_frame(1).image, frame.image)
    assert values["pchi2"] < values["pchi2_fan"], "patches outside the fan are right for nothing"


def test_a_metric_of_images_and_of_draws_reads_the_draws_where_there_are_some(make_frame):
    frame, both = make_frame(0), Metric("both", of_image=lambda _: 1.0, of_draws=lambda _: 2.0)
    assert evaluate_image(frame.pair(frame.image), [both]) == {"both": 1.0}
    assert evaluate_image(frame.pair(frame.image, draws=np.stack([frame.image] * 2)), [both]) == {"both": 2.0}


def test_patches_of_the_frame_the_fan_and_tissue(make_frame):
    frame, other = make_frame(0), make_frame(1)
    values, chi2 = evaluate_image(frame.pair(other.image)), patch_chi2(other.image, frame.image)
    whole = np.ones_like(frame.mask)
    for name, mask in (("pchi2", whole), ("pchi2_fan", frame.mask), ("pchi2_tissue", frame.tissue)):
        squares = [
            chi2[i, j] ** 2 for i, j in np.ndindex(chi2.shape) if mask[20 * i : 20 * i + 20, 20 * j : 20 * j + 20].all()
        ]
        assert values[name] == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-12)


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


def test_arrays_of_another_type_are_refused(make_frame):
    """A mask of 0 and 1 would count as the numbers of rows: the smooth error of a frame was 12 for 54."""
    frame = make_frame(0)
    numbers = frame.mask.astype(np.uint8)
    wrong = {**dict.fromkeys(("mask", "tissue_mask", "bone_mask"), numbers), "segmentation": numbers / 2}
    for name, array in (wrong | {"draws": np.stack([frame.image] * 2) / 255}).items():
        with pytest.raises(ValueError, match=f"{name} must be (bool|uint8|integers), got (uint8|float64)"):
            frame.pair(frame.image, **{name: array})
    with pytest.raises(ValueError, match="attenuation must be finite"):
        frame.pair(frame.image, attenuation=np.where(frame.mask, np.nan, 1.0))
    with pytest.raises(ValueError, match="draws must begin with the prediction"):
        frame.pair(frame.image, draws=np.stack([255 - frame.image, frame.image]))


@pytest.mark.parametrize(
    "write",
    [
        lambda pair: np.copyto(pair.prediction, pair.target, where=pair.mask),
        lambda pair: pair.draws.__setitem__(0, 0),
        lambda pair: pair.chi2_map.sort(),
    ],
    ids=["prediction", "draws", "chi2_map"],
)
def test_a_metric_that_writes_to_its_pair_is_refused_by_name(make_frame, write):
    frame = make_frame(0, shape=(100, 140))
    kept = frame.image.copy(), frame.mask.copy(), frame.depth_mm.copy()
    wrong = Metric("careless", of_image=write)
    pair = frame.pair(frame.image // 2, draws=np.stack([frame.image // 2] * 2))
    with pytest.raises(ValueError, match="read-only\\nby the metric careless"):
        evaluate_image(pair, [wrong, METRICS["mae"]])
    for before, after in zip(kept, (frame.image, frame.mask, frame.depth_mm), strict=True):
        np.testing.assert_array_equal(before, after)
    frame.image[0, 0] += 1  # the caller's own arrays are not locked


IN_PLACE = {
    "prediction": lambda pair: torch.from_numpy(pair.prediction).zero_(),
    "mask": lambda pair: torch.from_numpy(pair.mask).logical_not_(),
    "depth_mm": lambda pair: torch.from_numpy(pair.depth_mm).div_(10),
    "attenuation": lambda pair: torch.from_numpy(pair.attenuation).log1p_(),
    "draws": lambda pair: torch.from_numpy(pair.draws).neg_(),
    "chi2_map": lambda pair: torch.from_numpy(pair.chi2_map).fill_(1),
    "target": lambda pair: np.lib.stride_tricks.as_strided(pair.target.base).fill(0),
    "segmentation": lambda pair: pair.segmentation.base.fill(0),
}


@pytest.mark.filterwarnings("ignore:The given NumPy array is not writable")
@pytest.mark.parametrize("array", IN_PLACE)
def test_what_a_metric_changes_past_numpy_is_its_own(make_frame, array):
    """Torch asks no flag of NumPy; neither the caller's arrays nor those of other metrics change."""
    frame = make_frame(0, shape=(100, 140))
    draws, maps = np.stack([frame.image // 2, frame.image // 3]), {"segmentation": frame.mask.astype(np.uint8)}
    values = [METRICS["mae"], METRICS["mae_fan"], METRICS["pchi2"], METRICS["shadow_contrast"]]
    before = evaluate_image(frame.pair(draws[0], draws=draws, **maps), values)
    pair = frame.pair(draws[0], draws=draws, **maps)
    kept = {name: np.copy(getattr(pair, name)) for name in IN_PLACE}
    careless = Metric("careless", of_image=lambda own: float(np.asarray(IN_PLACE[array](own) is None)))
    after = evaluate_image(pair, [careless, *values])
    assert after == before | {"careless": after["careless"]}
    for name, value in kept.items():
        np.testing.assert_array_equal(getattr(pair, name), value)


def test_a_metric_is_one_module_and_stands_where_it_says():
    places = [metric.place for metric in METRICS.values()]
    assert places == sorted(set(places)), "in rising order, no two alike"
    modules = [module for name, module in sys.modules.items() if name.startswith("ablate.metrics.")]
    owners = {n: [m for m in modules if any(METRICS[n] is value for value in vars(m).values())] for n in METRICS}
    assert {len(owner) for owner in owners.values()} == {1}
