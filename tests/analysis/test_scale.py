"""Where networks stand between the formula and re-simulation, by hand; and what is said of those below."""

import pandas as pd
import pytest

from ablate.analysis import Component, cautions, comparison_table, scale_table, scaled_bands

MEANS = {  # by variant: PSNR, patch chi-square, noise sd
    "re-simulation": (22.0, 0.05, 20.0),
    "formula": (19.0, 0.20, 18.0),
    "sa2h": (23.5, 0.08, 19.0),
    "nsa2h": (18.0, 0.20, 19.0),
}


def per_image(means: dict[str, tuple[float, float, float]]) -> pd.DataFrame:
    return pd.DataFrame(
        [
            {
                "variant": variant,
                "seed": 0,
                "frame": frame,
                "site": frame,
                "metric": metric,
                "value": value,
                "data": "d",
            }
            for variant, values in means.items()
            for metric, value in zip(("psnr", "pchi2", "noise_sd"), values, strict=True)
            for frame in range(12)
        ]
    )


def test_zero_is_the_formula_and_one_is_resimulation() -> None:
    scale = scale_table(comparison_table(per_image(MEANS)))
    assert list(scale) == ["psnr", "pchi2"], "noise sd does not judge"
    assert scale.loc["sa2h"].tolist() == pytest.approx([1.5, 0.8])
    assert scale.loc["nsa2h"].tolist() == pytest.approx([-1 / 3, 0.0])
    assert "formula" not in scale.index


def test_without_a_baseline_or_where_they_are_equal_there_is_no_scale() -> None:
    assert scale_table(comparison_table(per_image({"sa2h": MEANS["sa2h"], "formula": MEANS["formula"]}))).empty
    equal = MEANS | {"formula": (22.0, 0.20, 18.0)}
    assert list(scale_table(comparison_table(per_image(equal)))) == ["pchi2"]


def judged(metric: str, share: float | None = 0.1) -> Component:
    return Component("mine", "model.noise", "body", "input", metric=metric, band=7.0, share=share)


def test_a_band_is_a_share_of_the_scale_in_the_mean_of_the_anatomies() -> None:
    """Of the PSNR, too, whose larger values are better; a row of a network changes nothing."""
    there = per_image(MEANS | {"formula": (17.0, 0.40, 18.0)}).assign(data="e")
    both = pd.concat([per_image(MEANS), there])
    psnr, chi2 = scaled_bands([judged("psnr"), judged("pchi2")], both)
    assert psnr.band == pytest.approx(0.1 * (3.0 + 5.0) / 2)
    assert chi2.band == pytest.approx(0.1 * (0.15 + 0.35) / 2)
    (alone,) = scaled_bands([judged("pchi2")], per_image(MEANS | {"sa2h": (0.0, 9.0, 0.0)}))
    assert (alone.band, alone.share) == (pytest.approx(0.015), 0.1)


@pytest.mark.parametrize(
    ("metric", "share", "means"),
    [
        ("pchi2", None, MEANS),  # a component that was registered with a band of its own
        ("noise_sd", 0.1, MEANS),  # which does not judge
        ("pchi2", 0.1, {"sa2h": MEANS["sa2h"], "re-simulation": MEANS["re-simulation"]}),  # no formula was scored
        ("pchi2", 0.1, MEANS | {"formula": (19.0, 0.05, 18.0)}),  # it is as good as re-simulation
        ("mae", 0.1, MEANS),  # of which there is no score
    ],
)
def test_without_a_scale_the_declared_band_counts(
    metric: str, share: float | None, means: dict[str, tuple[float, float, float]]
) -> None:
    (component,) = scaled_bands([judged(metric, share)], per_image(means))
    assert (component.band, component.share) == (7.0, None)


@pytest.mark.parametrize(("reference", "said"), [("sa2h", ""), ("nsa2h", "nsa2h is worse than the formula")])
def test_a_reference_below_the_formula_is_told(reference: str, said: str) -> None:
    told = " ".join(cautions(per_image(MEANS), reference))
    assert ("worse than the formula" in told) == bool(said)
    assert said in told


@pytest.mark.parametrize(("octave", "told"), [(0.4, False), (2.9, True)])
def test_networks_that_draw_no_speckle_pass_no_control(octave: float, told: bool) -> None:
    rows = per_image(MEANS)
    texture = rows[(rows["metric"] == "psnr") & (rows["variant"] == "sa2h")].assign(metric="octave_sd", value=octave)
    assert ("draws speckle" in " ".join(cautions(pd.concat([rows, texture])))) is told
