"""The classifier of actions on the sample motions, and changes of action in motions put together by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from tutorial_lib import actions
from tutorial_lib.data import load
from tutorial_lib.errors import TutorialError
from tutorial_lib.motion.retarget import to_common
from tutorial_lib.representations import make_representation

FPS = 30.0


@pytest.fixture(scope="module")
def clips():
    """Features of two clips of each action."""
    found = {}
    for action in ("walking", "boxing"):
        motions = [to_common(m) for m in load(f"samples/{action}")[:2]]
        representation = make_representation("body-frame", motions[0].skeleton, FPS)
        found[action] = [representation.encode(m) for m in motions]
    return found


@pytest.fixture(scope="module")
def classifier(clips):
    return actions.train_classifier({a: x[:1] for a, x in clips.items()}, steps=60)


def test_it_tells_clips_that_it_has_not_seen(classifier, clips):
    assert actions.accuracy(classifier, {a: x[1:] for a, x in clips.items()}) > 0.95
    swapped = {"walking": clips["boxing"][1:], "boxing": clips["walking"][1:]}
    assert actions.accuracy(classifier, swapped) < 0.05
    p = classifier.probabilities(clips["walking"][1][None])
    np.testing.assert_allclose(p.sum(-1), 1, rtol=1e-5)


def test_changes_are_found_where_they_are(classifier, clips):
    walk, box = clips["walking"][1], clips["boxing"][1]
    there = np.concatenate([walk[:90], box[:90]])
    motions = np.stack([walk[:180], there, there[::-1], np.concatenate([walk[:90], box[:20], walk[90:160]])])
    found = actions.transitions(classifier, motions, FPS)
    assert found.actions == ("walking", "boxing") and found.motions == 4
    np.testing.assert_array_equal(found.counts, [[0, 1], [1, 0]])  # 20 frames of boxing are none
    assert (found.kinds, found.changed) == (2, 2)


def test_what_is_no_number_is_no_action(classifier, clips):
    broken = np.full((1, 90, clips["walking"][0].shape[1]), np.nan, np.float32)
    found = actions.transitions(classifier, broken, FPS)
    assert found.counts.sum() == 0 and found.share.sum() == 0


def test_the_same_seed_gives_the_same_classifier_and_the_global_one_is_left_alone(clips):
    before = torch.random.get_rng_state()
    one, two = (actions.train_classifier(clips, steps=3, seed=4) for _ in range(2))
    assert torch.equal(torch.random.get_rng_state(), before)
    for a, b in zip(one.parameters(), two.parameters(), strict=True):
        assert torch.equal(a, b)


def test_classifiers_that_cannot_be(clips):
    with pytest.raises(TutorialError, match="1 actions"):
        actions.train_classifier({"walking": clips["walking"]})
    with pytest.raises(TutorialError, match="no clip of 'boxing'"):
        actions.train_classifier({**clips, "boxing": [clips["boxing"][0][:10]]})


def stub() -> SimpleNamespace:
    """A classifier that is told the probabilities of its windows."""
    return SimpleNamespace(actions=("walking", "boxing"), window=1, probabilities=lambda p: np.asarray(p))


def acts(*parts: tuple[int, float]) -> np.ndarray:
    """(N, 2) probabilities: for each part so many windows with this one of walking."""
    return np.array([[p, 1 - p] for count, p in parts for _ in range(count)])


def test_changes_have_a_direction_and_count_once_in_a_motion():
    """A second is six windows; 0.8 is not sure."""
    walk, box, unsure = (10, 0.95), (10, 0.05), (10, 0.8)
    motions = np.stack([
        acts(walk, box, walk, box), acts(walk, walk, box, box), acts(walk, unsure, unsure, walk),
        acts(unsure, box, unsure, box), acts(walk, (5, 0.05), (15, 0.95), walk),
    ])  # fmt: skip
    found = actions.transitions(stub(), motions, FPS)
    np.testing.assert_array_equal(found.counts, [[0, 2], [1, 0]])
    assert (found.kinds, found.changed, found.motions) == (2, 2, 5)
    np.testing.assert_allclose(found.share, [95 / 200, 65 / 200])
    again = actions.transitions(stub(), motions[1:2].repeat(3, 0), FPS)
    np.testing.assert_array_equal(again.counts, [[0, 3], [0, 0]])
    assert (again.kinds, again.changed) == (1, 3)


def test_every_action_counts_the_same_in_the_accuracy():
    told = {"walking": [acts((10, 0.9), (10, 0.1)), acts((20, 0.9))], "boxing": [acts((1, 0.1), (3, 0.9))]}
    assert actions.accuracy(stub(), told) == pytest.approx((30 / 40 + 1 / 4) / 2)
