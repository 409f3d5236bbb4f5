"""Figures are a subject of other rooms."""

from collections.abc import Iterator
from unittest import mock

import pytest


@pytest.fixture(autouse=True, scope="module")
def no_figures(request: pytest.FixtureRequest) -> Iterator[None]:
    """Comparisons of these tests draw nothing; the study that all rooms read has its figures before."""
    request.getfixturevalue("tiny_study") if hasattr(request.module, "TinyStudy") else None
    if hasattr(request.module, "Unrendered"):  # which chooses for each test
        yield
        return
    with mock.patch("ablate.study.compare.draw_figures", return_value=[]):
        yield
