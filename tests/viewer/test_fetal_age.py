"""Weeks of gestation against the built-in fetus, which is one of 22 weeks, and against term."""

import numpy as np
import pytest

from ablate.viewer.fetal_age import Biometry, dated, weeks


@pytest.mark.parametrize(
    ("measure", "length_mm"), [(Biometry.bpd, 54.0), (Biometry.hc, 200.0), (Biometry.ac, 175.0), (Biometry.fl, 39.0)]
)
def test_the_built_in_fetus_is_of_22_weeks_by_each_measure(measure: Biometry, length_mm: float) -> None:
    """docs/anatomy.md has these lengths; tests/anatomy/fetal measures them on the meshes."""
    assert weeks(measure, length_mm) == pytest.approx(22.4, abs=0.3)
    assert weeks(measure, 1.1 * length_mm) > weeks(measure, length_mm) + 1


def test_a_measure_needs_its_number_of_points_and_an_age_that_the_study_had() -> None:
    line = np.array([[0.0, 50.0], [54.0, 50.0]])
    assert "**22 weeks and 3 days**" in dated(Biometry.bpd, line)  # 9.54 + 1.482 x 5.4 + 0.1676 x 5.4^2 = 22.43
    assert "HC needs 4 points" in dated(Biometry.hc, line)
    assert "none of 14 to 42 weeks" in dated(Biometry.fl, 3 * line)
    radius = 200 / (2 * np.pi)
    circle = np.array([[-radius, 60], [radius, 60], [0, 60 - radius], [0, 60 + radius]])
    assert "HC **200 mm**: **22 weeks" in dated(Biometry.hc, circle)
    assert "BPD needs 2 points" in dated(Biometry.bpd, circle)
