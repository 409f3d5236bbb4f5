"""Frames are spread over sites, and no site is on two sides."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ablate.dataset import Part, SplitBy, choose_frames, split_frames


@given(st.integers(3, 40), st.integers(1, 6), st.integers(0, 5))
def test_no_site_is_on_two_sides(sites: int, per_site: int, seed: int) -> None:
    site = np.repeat(np.arange(sites), per_site)
    part = split_frames(site, SplitBy.site, 0.1, 0.2, seed)
    for s in range(sites):
        assert len(set(part[site == s])) == 1
    for p in Part:
        assert (part == p).any()


@given(st.integers(1, 20), st.integers(1, 6), st.data())
def test_chosen_frames_are_spread_equally(sites: int, per_site: int, data: st.DataObject) -> None:
    site = np.repeat(np.arange(sites), per_site)
    frames = data.draw(st.integers(1, len(site)))
    chosen = choose_frames(site, frames, 0)
    assert len(np.unique(chosen)) == frames
    counts = np.bincount(site[chosen], minlength=sites)
    assert counts.max() - counts.min() <= 1


def test_paper_split_draws_frames() -> None:
    site = np.repeat(np.arange(10), 100)
    part = split_frames(site, SplitBy.frame, 0.05, 0.1, 0)
    assert np.bincount(part).tolist() == [850, 50, 100]
    assert len(set(part[site == 0])) > 1


def test_too_few_sites_are_refused() -> None:
    with pytest.raises(ValueError, match="2 sites cannot be split"):
        split_frames([0, 0, 1, 1], SplitBy.site, 0.1, 0.2, 0)


@pytest.mark.parametrize("sites", [[0, 0, 1, 1], [0, 1, 2]])
def test_what_cannot_be_split_both_ways_is_said_of_both(sites: list[int]) -> None:
    with pytest.raises(ValueError, match=r"^dataset\.split=both: .* cannot be split"):
        split_frames(sites, SplitBy.both, 0.1, 0.2, 0)


def test_a_word_is_the_kind_of_split_that_it_names() -> None:
    sites = np.repeat(np.arange(10), 4)
    named = split_frames(sites, "site", 0.2, 0.2, 0)  # type: ignore[arg-type]
    np.testing.assert_array_equal(named, split_frames(sites, SplitBy.site, 0.2, 0.2, 0))
    with pytest.raises(ValueError, match="sites"):
        split_frames(sites, "sites", 0.2, 0.2, 0)  # type: ignore[arg-type]


@given(st.integers(8, 40), st.integers(4, 8), st.integers(0, 5))
def test_both_ways_half_of_the_test_frames_are_of_sites_that_nothing_else_has(
    sites: int, per_site: int, seed: int
) -> None:
    site = np.repeat(np.arange(sites), per_site)
    part = split_frames(site, SplitBy.both, 0.05, 0.2, seed)
    of_others = np.isin(site[part == Part.test], site[part != Part.test])
    assert abs((~of_others).sum() - 0.1 * len(site)) <= per_site
    assert abs(of_others.sum() - 0.1 * len(site)) <= per_site
    assert abs((part == Part.validation).sum() - 0.05 * len(site)) <= 1
