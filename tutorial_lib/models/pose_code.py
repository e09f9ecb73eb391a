"""Stage 1 of the Dynamic Future Net: a pose and how it moves as a short code, decoded with bones that cannot stretch.

Chen, Wang, Yuan, Shao and Zhou, "Dynamic Future Net: diversified human motion generation" (MM 2020), section 5.1,
figure 3. Shapes: any leading axes; D numbers of a frame, J nodes, C of a code.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor, nn

from ..motion.rotations import quat_normalize
from ..representations import BodyFrame
from .layers import Standardizer, mlp


class Pose(NamedTuple):
    """What a code says: everything in metres, seconds and radians."""

    rotations: Tensor  # (..., J, 4) local unit quaternions, the root's in the body's frame
    height: Tensor  # (..., 1) of the hip above the ground
    velocity: Tensor  # (..., 4) turning, forward, sideways, rising: the representation's "velocity" channels


class PoseCode(nn.Module):
    """The pose-velocity auto-encoder: ``z_t = PoseEnc(X_t)`` and ``X_t = PoseDec(z_t)``.

    The encoder is one perceptron, the first part of its code for the pose, the rest for the velocity. The quaternion
    decoder reads the one and gives a local rotation for every joint that carries a bone, from which forward kinematics
    gives the joints; the velocity decoder reads the other. The paper does not give the perceptrons' sizes, nor how the
    code of 16 is shared. Its joints are relative to the root; here the quaternion decoder also tells the root's
    height, as the one part of the pose that rotations cannot.

    Features go in and come out as they are, in metres; ``scale`` and ``unit`` are fitted to the data before training
    (:meth:`fit_features`), ``code_scale`` after it (:meth:`fit_codes`), so that later stages read codes with a mean of
    0 and a deviation of 1.
    """

    def __init__(self, representation: BodyFrame, *, code: int = 16, velocity_code: int = 4, hidden: int = 256):
        super().__init__()
        self.representation, self.velocity_code = representation, velocity_code
        skeleton, dim = representation.skeleton, representation.dim
        # a joint without children may turn as it likes without moving a node: it gets no rotation
        turning = [j for j in range(skeleton.n_joints) if skeleton.children[j]]
        place = {j: k for k, j in enumerate(turning)}
        self._scatter = [place.get(j, len(turning)) for j in range(skeleton.n_joints)]
        self.encoder = mlp(dim, hidden, code, 3)
        self.quaternion_decoder = mlp(code - velocity_code, hidden, 4 * len(turning) + 1, 3)
        self.velocity_decoder = mlp(velocity_code, max(1, hidden // 4), 4, 3)
        self.scale, self.code_scale = Standardizer(dim), Standardizer(code)
        self.register_buffer("unit", torch.ones(dim))

    def fit_features(self, features: Iterable[Tensor]) -> None:
        """Measure the data ``(..., D)``: once, before training.

        ``unit`` is what the loss calls 1: for velocities their standard deviation, for joints a common length, the root
        mean square of theirs, so that a centimetre counts the same everywhere on the body.
        """
        self.scale.fit(features)
        joints = self.representation.slices["joints"]
        self.unit.copy_(self.scale.std)
        self.unit[joints] = self.scale.std[joints].square().mean().sqrt()

    def fit_codes(self, features: Iterable[Tensor]) -> None:
        """Measure the codes of data ``(..., D)``: once, after training."""
        with torch.no_grad():
            self.code_scale.fit([self.encoder(self.scale(x)) for x in features])

    def encode(self, features: Tensor) -> Tensor:
        """``z_t = PoseEnc(X_t)``: ``(..., D)`` to ``(..., C)``."""
        return self.code_scale(self.encoder(self.scale(features)))

    def decode(self, code: Tensor) -> Pose:
        """``PoseDec(z_t)`` before forward kinematics: ``(..., C)`` to rotations, height and velocity."""
        code = self.code_scale.invert(code)
        mean, std = self.scale.mean, self.scale.std
        raw = self.quaternion_decoder(code[..., : -self.velocity_code])  # (..., 4 n + 1)
        q = raw[..., :-1].unflatten(-1, (-1, 4))  # (..., n, 4)
        still = q.new_tensor([1.0, 0.0, 0.0, 0.0])
        q = torch.cat((quat_normalize(q + still), still.expand(*q.shape[:-2], 1, 4)), -2)
        at = (
            self.representation.slices["joints"].start + 3 * self.representation.hip + 1
        )  # the hip's y among the features
        height = raw[..., -1:] * std[at] + mean[at]
        moving = self.representation.slices["velocity"]
        velocity = self.velocity_decoder(code[..., -self.velocity_code :]) * std[moving] + mean[moving]
        return Pose(q[..., self._scatter, :], height, velocity)

    def features(self, pose: Pose) -> Tensor:
        """Forward kinematics: a :class:`Pose` to features ``(..., D)``. Bones are as long as the skeleton's."""
        root = torch.zeros_like(pose.rotations[..., 0, :3])
        joints = self.representation.skeleton.fk(pose.rotations, root)  # (..., J, 3)
        hip = joints[..., self.representation.hip, :]
        above_ground = torch.cat((torch.zeros_like(pose.height), pose.height, torch.zeros_like(pose.height)), -1)
        joints = joints + (above_ground - hip)[..., None, :]  # the hip is the frame's origin, at its height
        return torch.cat((joints.flatten(-2), pose.velocity), -1)

    def forward(self, features: Tensor) -> Tensor:
        """Reconstruction: ``(..., D)`` to ``(..., D)``."""
        return self.features(self.decode(self.encode(features)))


def pose_error(features: Tensor, reconstruction: Tensor, unit: Tensor) -> Tensor:
    r"""Equation 2: the squared distance of frames ``(..., T, D)``, in units ``(D,)``, averaged over them: a scalar.

    .. math:: L_{sl} = \frac1T \sum_t \| X_t - \hat X_t \|_2^2
    """
    return ((features - reconstruction) / unit).square().sum(-1).mean()  # (2)
