"""Random numbers of the paths: stratified, repeatable, unrelated."""

import numpy as np
from scipy.stats import kstest

from ablate.ultrasound.transport.rays import (
    CHOICE,
    COLUMNS,
    COS_AZIMUTH,
    LOG_U,
    SIN_AZIMUTH,
    SURVIVAL,
    THICKNESS,
    Draws,
    progressive,
    stratified,
    unstratified,
)


def test_unstratified_draws_are_uniform_and_unrelated() -> None:
    """Columns as in the table; neighbouring seeds, interfaces and rays have nothing in common."""
    row = np.empty(COLUMNS, np.float32)
    drawn = np.array([
        [[unstratified(np.uint64(seed), k, ray, row).copy() for ray in range(500)] for k in range(64, 74)]
        for seed in (0, 1, 2**64 - 1)
    ])  # fmt: skip
    flat = drawn.reshape(-1, COLUMNS)
    n = len(flat)
    for column in (flat[:, CHOICE], flat[:, SURVIVAL], np.exp(flat[:, LOG_U])):
        assert kstest(column, "uniform").pvalue > 1e-3
    assert kstest(flat[:, THICKNESS], "halfnorm").pvalue > 1e-3
    azimuth = np.arctan2(flat[:, SIN_AZIMUTH], flat[:, COS_AZIMUTH])
    assert kstest(azimuth, "uniform", (-np.pi, 2 * np.pi)).pvalue > 1e-3
    assert (np.abs(np.corrcoef(flat[:, [CHOICE, THICKNESS, LOG_U, SURVIVAL]].T) - np.eye(4)) < 4 / np.sqrt(n)).all()
    u = drawn[..., CHOICE]
    for one, other in ((u[0], u[1]), (u[:, 0], u[:, 1]), (u[..., 1:], u[..., :-1])):
        assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 4 / np.sqrt(one.size)


def test_draws_are_stratified_and_repeat() -> None:
    u = stratified(np.random.default_rng(0), 5, 16, 2)
    assert (np.sort(np.floor(u * 16), axis=-1) == np.arange(16)).all()
    a, b, other = (Draws(seed, 5, 16).table(10)[:10] for seed in (3, 3, 4))
    assert (a == b).all()
    assert abs(np.corrcoef(a[0, :, CHOICE], a[1, :, CHOICE])[0, 1]) < 0.4
    assert (a[9] != other[9]).any()


def test_any_first_rays_are_stratified_uniform_and_unrelated_where_not_all_are_traced() -> None:
    u = progressive(np.random.default_rng(0), 400, 50, 2)
    assert u.shape == (2, 400, 50)
    for n in (1, 2, 4, 8, 16, 32):
        assert (np.sort(np.floor(u[..., :n] * n), axis=-1) == np.arange(n)).all()
    for ray in (0, 1, 5, 31, 40, 49):
        assert kstest(u[:, :, ray].ravel(), "uniform").pvalue > 1e-3
    both = np.floor(4 * u).astype(int)
    counts = np.bincount((4 * both[0] + both[1]).ravel(), minlength=16)  # all squares, not those of a diagonal
    assert np.abs(counts / counts.mean() - 1).max() < 0.1


def test_draws_made_one_by_one_are_those_made_at_once() -> None:
    step_by_step = Draws(3, 5, 16)
    for k in range(10):
        step_by_step.table(k)
    assert (step_by_step.table(10)[:10] == Draws(3, 5, 16).table(10)[:10]).all()
