"""Mirrored motion: left and right exchanged, the figure still one that can be."""

from __future__ import annotations

import numpy as np
import pytest

from tutorial_lib import data
from tutorial_lib.cli import main
from tutorial_lib.control import control_of
from tutorial_lib.errors import MotionError
from tutorial_lib.motion import Motion, Skeleton
from tutorial_lib.motion.mirror import mirrored, other_side
from tutorial_lib.motion.retarget import to_common
from tutorial_lib.recipes import Recipe, trainer_for
from tutorial_lib.training.checkpoints import read_header


@pytest.fixture(scope="module")
def clip() -> Motion:
    return data.load("samples/walking")[1]  # a circle to the left


def test_who_turned_left_turns_right(clip):
    image = mirrored(clip)
    turning, forward, sideways = control_of(clip).T
    np.testing.assert_allclose(control_of(image), np.stack([-turning, forward, -sideways], -1), atol=1e-4)
    at = {name: j for j, name in enumerate(clip.skeleton.names)}
    seen = clip.positions[:, at["LeftFoot"]] * [-1, 1, 1]
    np.testing.assert_allclose(image.positions[:, at["RightFoot"]], seen)
    assert image.name == clip.name and image.fps == clip.fps


@pytest.mark.parametrize("common", [False, True])
def test_rotations_are_mirrored_too(clip, common):
    """Forward kinematics of the mirrored rotations give the mirrored positions."""
    motion = to_common(clip) if common else clip
    image = mirrored(motion)
    straight = image.skeleton.fk(image.rotations, image.positions[:, 0])
    there = motion.skeleton.fk(motion.rotations, motion.positions[:, 0])[:, other_side(motion.skeleton)]
    np.testing.assert_allclose(straight, there * [-1, 1, 1], atol=1e-9)
    twice = mirrored(image)
    np.testing.assert_allclose(twice.positions, motion.positions)
    np.testing.assert_allclose(twice.rotations, motion.rotations)
    np.testing.assert_allclose(twice.skeleton.offsets, motion.skeleton.offsets)


def test_without_sides_there_is_no_image(small_motion):
    with pytest.raises(MotionError, match="none of 7 nodes .* expected names such as LeftFoot and RightFoot"):
        mirrored(small_motion)
    uneven = Skeleton(("Hips", "LeftArm", "RightArm", "LeftHand", "RightHand"), (-1, 0, 0, 1, 1), np.zeros((5, 3)))
    with pytest.raises(MotionError, match="'LeftHand' hangs from 'LeftArm', but 'RightHand' from 'LeftArm'"):
        other_side(uneven)


@pytest.mark.parametrize("left, right", [("UpperLeg_L", "UpperLeg_R"), ("lfemur", "rfemur"), ("LeftToe", "RightToe")])
def test_sides_are_told_by_the_names_of_each_studio(left, right):
    skeleton = Skeleton(("root", "lowerback", left, right), (-1, 0, 0, 0), np.zeros((4, 3)))
    assert other_side(skeleton) == [0, 1, 3, 2]


@pytest.mark.parametrize("left, right", [("Hand_L", "Hand_R"), ("lHand", "rHand"), ("LeftHand", "RightHand")])
@pytest.mark.parametrize("end", ["_end", "_end_"])
def test_end_sites_are_on_their_joints_side(left, right, end):
    names = ("root", "head", left, right, f"head{end}", f"{left}{end}", f"{right}{end}")
    skeleton = Skeleton(names, (-1, 0, 0, 0, 1, 2, 3), np.eye(7)[:, :3], end_sites={4, 5, 6})
    assert other_side(skeleton) == [0, 1, 3, 2, 4, 6, 5]
    motion = Motion(skeleton, 30, np.random.default_rng(0).normal(size=(4, 7, 3)))
    np.testing.assert_array_equal(mirrored(motion).positions[:, 5], motion.positions[:, 6] * [-1, 1, 1])


@pytest.mark.parametrize("names", [("root", "Hand_L", "Hand_R", "Hand_L_end"), ("root", "lArm", "rArm", "thumb")])
def test_a_node_without_a_partner_is_told_by_its_name(names):
    told = f"no mirror image: '{names[3]}', which hangs from '{names[1]}', has no partner on the other side"
    with pytest.raises(MotionError, match=told):
        other_side(Skeleton(names, (-1, 0, 0, 1), np.zeros((4, 3))))


@pytest.mark.parametrize("lonely", ["LeftArm", "RightHand_end", "Arm_L", "Toe_R_end_"])
@pytest.mark.parametrize("others", [("lfemur", "rfemur"), ("Head", "Neck")])
def test_one_arm_alone_has_no_mirror_image(lonely, others):
    """It hangs from a node in the middle, which hides it from what else is looked at."""
    skeleton = Skeleton(("root", *others, lonely), (-1, 0, 0, 0), np.zeros((4, 3)))
    told = f"no mirror image: '{lonely}', which hangs from 'root', has no partner on the other side"
    with pytest.raises(MotionError, match=told):
        other_side(skeleton)
    alone = Skeleton((lonely, *others), (-1, 0, 0), np.zeros((3, 3)))
    with pytest.raises(MotionError, match=f"no mirror image: '{lonely}' has no partner"):
        other_side(alone)


def test_names_that_begin_with_a_letter_of_a_side_may_be_in_the_middle():
    skeleton = Skeleton(("root", "lowerback", "lfemur", "rfemur"), (-1, 0, 0, 0), np.zeros((4, 3)))
    assert other_side(skeleton) == [0, 1, 3, 2]


def test_training_sees_every_clip_twice():
    """--mirror: the windows are of both, and the provenance counts the clips once."""
    recipe = Recipe("vae-lstm", "samples/walking", hidden=8, batch=256, length=40, steps=1, mirror=True)
    trainer = trainer_for(recipe)
    seen = trainer.batches.normalizer.invert(trainer.batches.sample())[..., 63:].reshape(-1, 3).numpy()
    plain = trainer_for(Recipe("vae-lstm", "samples/walking", hidden=8, batch=256, length=40, steps=1))
    one_sided = plain.batches.normalizer.invert(plain.batches.sample())[..., 63:].reshape(-1, 3).numpy()
    assert abs(seen[:, 0].mean()) < abs(one_sided[:, 0].mean()) / 2, "turning is even"
    assert Recipe.from_dict(recipe.to_dict()) == recipe


def test_the_command_trains_on_mirror_images_and_says_so(tmp_path):
    out = tmp_path / "walk.safetensors"
    command = ["train", "vae-lstm", "--data", "samples/walking", "--hidden", "8", "--filters", "4", "--kernel", "5",
               "--batch", "4", "--length", "40", "--out", str(out)]  # fmt: skip
    assert main([*command, "--mirror", "--steps", "1"]) == 0
    header = read_header(out)
    assert header["training"]["mirror"] is True and len(header["provenance"]["clips"]) == 4
    assert header["sway"]["limits"]["speed"] > 1.3, "a vae-lstm brings the gait of its clips"


def test_a_joint_turns_in_the_order_of_the_one_that_it_stands_for():
    skeleton = Skeleton(("Hips", "LeftArm", "RightArm"), (-1, 0, 0), np.eye(3), ("ZYX", "XYZ", "ZXY"))
    image = mirrored(Motion(skeleton, 30, np.zeros((2, 3, 3)))).skeleton
    assert image.orders == ("ZYX", "ZXY", "XYZ") and image.names == skeleton.names
    np.testing.assert_array_equal(image.offsets, skeleton.offsets[[0, 2, 1]] * [-1, 1, 1])
