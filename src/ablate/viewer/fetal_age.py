"""Weeks of gestation from one measure of a fetus, by the regressions of Hadlock et al. 1984.

F. P. Hadlock, R. L. Deter, R. B. Harrist and S. K. Park: Estimating fetal age: computer-assisted analysis of multiple
fetal growth parameters. Radiology 152 (1984) 497-501; 361 fetuses of 14 to 42 weeks.
"""

import math
from enum import StrEnum

import numpy as np
from numpy.polynomial import Polynomial

from ablate.viewer.calipers import MOST_POINTS, circumference

_WEEKS_OF_THE_STUDY = (14, 42)


class Biometry(StrEnum):
    """What of a fetus is measured: between two points, or around the ellipse of two diameters."""

    bpd = "BPD, biparietal diameter"
    hc = "HC, head circumference"
    ac = "AC, abdominal circumference"
    fl = "FL, femur length"


# Weeks as a polynomial of cm.
_REGRESSIONS = {
    Biometry.bpd: Polynomial([9.54, 1.482, 0.1676]),
    Biometry.hc: Polynomial([8.96, 0.540, 0.0, 0.0003]),
    Biometry.ac: Polynomial([8.14, 0.753, 0.0036]),
    Biometry.fl: Polynomial([10.35, 2.460, 0.170]),
}
_POINTS = {Biometry.bpd: 2, Biometry.hc: MOST_POINTS, Biometry.ac: MOST_POINTS, Biometry.fl: 2}


def weeks(measure: Biometry, length_mm: float) -> float:
    """Weeks of gestation that a length of a fetus, mm, is the mean of."""
    return float(_REGRESSIONS[measure](length_mm / 10))


def dated(measure: Biometry, points: np.ndarray) -> str:
    """The measure between points of the image plane, (n, 2) mm, and its weeks, in Markdown."""
    name = measure.partition(",")[0]
    if len(points) != _POINTS[measure]:
        return f" {name} needs {_POINTS[measure]} points."
    length_mm = math.dist(*points) if len(points) == 2 else circumference(points)
    age = weeks(measure, length_mm)
    first, last = _WEEKS_OF_THE_STUDY
    if not first <= age <= last:
        return f" {name} {length_mm:.0f} mm is none of {first} to {last} weeks (Hadlock 1984)."
    whole, days = divmod(round(7 * age), 7)
    return f" {name} **{length_mm:.0f} mm**: **{whole} weeks and {days} days** (Hadlock 1984)."
