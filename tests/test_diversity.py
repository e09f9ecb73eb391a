"""Diversity: pairwise distance, mean-distance bands, nearest windows, against sums written out and cases known."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch

from tutorial_lib import diversity
from tutorial_lib.errors import TutorialError


@pytest.fixture
def poses():
    return np.random.default_rng(0).normal(size=(7, 5, 6))  # (K, T, P)


def test_pairwise_distance_is_the_mean_over_all_pairs(poses):
    by_hand = [np.mean([np.linalg.norm(a[t] - b[t]) for a, b in itertools.combinations(poses, 2)]) for t in range(5)]
    np.testing.assert_allclose(diversity.pairwise_distance(poses), by_hand)
    assert diversity.pairwise_distance(np.repeat(poses[:1], 3, 0)).max() == 0
    as_torch = diversity.pairwise_distance(torch.from_numpy(poses))
    assert isinstance(as_torch, torch.Tensor) and np.allclose(as_torch, by_hand)


def test_the_band_is_of_the_distances_to_the_mean_pose(poses):
    distance = np.linalg.norm(poses - poses.mean(0), axis=-1)
    band = diversity.mean_distance_band(poses)
    np.testing.assert_allclose(band.mean, distance.mean(0))
    np.testing.assert_allclose(band.deviation, distance.std(0))
    as_torch = diversity.mean_distance_band(torch.from_numpy(poses))
    np.testing.assert_allclose(as_torch.mean, band.mean)
    np.testing.assert_allclose(as_torch.deviation, band.deviation)
    data = diversity.mean_distance_band(poses.reshape(35, 1, 6))
    assert data.mean.shape == (1,)


def test_a_band_covers_what_it_shares():
    coverage = diversity.band_coverage
    low, high = np.array([0.0, 1.0]), np.array([1.0, 3.0])
    one = np.ones(1)
    assert coverage(low, high, low, high) == pytest.approx(1.0)
    assert coverage(low, high, 0 * one, 2 * one) == pytest.approx((1 + 1) / 4)
    assert coverage(low, high, 5 * one, 6 * one) == 0
    for kind in (np.asarray, torch.from_numpy):  # plain numbers are the same
        assert float(coverage(kind(low), kind(high), 0, 2.0)) == pytest.approx((1 + 1) / 4)
        assert float(coverage(kind(low), kind(high), 0.2, 0.8)) == coverage(low, high, 0.2 * one, 0.8 * one)
    assert coverage(0.0, 1.0, 0.5, 2.5) == pytest.approx(0.25)
    with pytest.raises(TutorialError, match="no area"):
        coverage(low, high, 0.8, 0.2)
    with pytest.raises(TutorialError, match="no area"):
        coverage(low, high, one, one)


def test_the_nearest_window_is_metres_a_joint(poses):
    moved = poses.copy()
    moved[..., 0::3] += 0.03  # every joint 3 cm to one side
    moved[..., 1::3] += 0.04
    np.testing.assert_allclose(diversity.nearest_window(moved, poses), 0.05, rtol=1e-3)
    np.testing.assert_allclose(diversity.nearest_window(poses, np.concatenate([moved, poses])), 0, atol=1e-6)
    with pytest.raises(TutorialError, match="4 frames of 6"):
        diversity.nearest_window(poses[:, :4], poses)


def test_windows_are_all_stretches(poses):
    windows = diversity.windows_of(poses, 3, 2)  # (7, 2, 3, 6)
    np.testing.assert_array_equal(windows[:, 1], poses[:, 2:5])
    assert diversity.windows_of(poses[0], 5).shape == (1, 5, 6)
    with pytest.raises(TutorialError, match="windows of 6 frames"):
        diversity.windows_of(poses, 6)


def test_windows_overlap_and_nobody_writes_to_two_at_once(poses):
    before = poses.copy()
    windows = diversity.windows_of(poses, 3)
    with pytest.raises(ValueError, match="read-only"):
        windows -= windows.mean(-2, keepdims=True)
    assert np.shares_memory(windows, poses), "thousands of motions are not copied a window's length times"
    tensor = torch.from_numpy(poses)
    windows = diversity.windows_of(tensor, 3)
    truth = np.stack([before[:, k : k + 3] for k in range(3)], 1)
    windows -= windows.mean(-2, keepdim=True)
    np.testing.assert_allclose(windows, truth - truth.mean(-2, keepdims=True))
    np.testing.assert_array_equal(poses, before)


def test_one_motion_is_no_distribution(poses):
    with pytest.raises(TutorialError, match="2 motions or more"):
        diversity.pairwise_distance(poses[:1])
    with pytest.raises(TutorialError, match="expected .motions, frames"):
        diversity.mean_distance(poses[0])


def test_thousands_of_windows_are_all_looked_up():
    windows = np.random.default_rng(1).normal(size=(1100, 2, 6))
    found = diversity.nearest_window(windows, windows[:3])
    assert found.shape == (1100,)
    by_hand = [np.sqrt(3 * np.square(windows[k] - windows[:3]).mean((1, 2))).min() for k in (0, 600, 1099)]
    np.testing.assert_allclose(found[[0, 600, 1099]], by_hand, atol=1e-6)
