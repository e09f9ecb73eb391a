"""Synthesis from a control signal: a trained VAE-LSTM walks where turning speed and velocities tell it to.

>>> control = representation.encode(motion)[:, representation.slices["control"]]     # measured from a clip, (T, 3)
>>> ten = generate_from_control(checkpoint, control, count=10, seed=1)               # ten people on one path
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from .chance import check_whole, is_real, seeded
from .data.windows import Normalizer
from .errors import CheckpointError, MotionError, TutorialError
from .generate import prepare_for, representation_of
from .models.vae_lstm import VAELSTM
from .models.variational import gaussian_sample
from .motion.clip import Motion, same_rate
from .training.checkpoints import Checkpoint

CHUNK = 1024  # frames made at once; a longer motion is made in such pieces, which nothing in it shows
INTEGRATE = ("given", "predicted")
CODES = ("one", "per-step", "held")


# --- with the network alone: normalised features ---------------------------------------------------


def prior_code(
    model: VAELSTM, count: int, generator: torch.Generator | None = None, *, steps: int | None = None
) -> Tensor:
    """Codes from the prior, ``z ~ N(0, I)``: one a motion ``(count, H)``, or one a step ``(count, steps, H)``."""
    shape = (count, model.config.hidden) if steps is None else (count, steps, model.config.hidden)
    return torch.randn(shape, generator=generator).to(next(model.parameters()).device)


@torch.no_grad()
def posterior_code(model: VAELSTM, pose: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """A draw of z_1 from the posterior of a few first frames: normalised poses ``(B, T0, J3)`` to ``(B, H)``.

    T0 is ``config.stride``, four, in section 4.3: "As we use two max pooling layers in the encoder, this corresponds to
    4 initial frames". Of more frames (a multiple) the first step's code is drawn.
    """
    _evaluating(model)
    mean, log_variance = model.infer(pose)  # (B, S0, H)
    return gaussian_sample(mean[:, 0], log_variance[:, 0], generator)


def _evaluating(model: VAELSTM) -> None:
    """Into evaluation mode, if it is not in it: going there anew would forget what the decoder keeps of its weights."""
    if model.training:
        model.eval()


class ControlStream:
    """Algorithm 1 for control that comes in pieces: frames go out as soon as nothing later can change them.

    A frame depends on the control ``delay`` frames ahead (the convolutions of encoder and decoder see to both
    sides), so the first pieces may give nothing yet and :meth:`finish` gives the rest. What was seen
    is kept as far as it is needed, so that all pieces together are the very frames of the whole control at once: there
    is no seam.

    code: (B, H), or (B, S, H) with a code for every step that will come.
    """

    def __init__(self, model: VAELSTM, code: Tensor):
        _evaluating(model)
        self.model, self.code = model, code
        self._halo, self._stride = model.config.halo, model.config.stride
        self._control: Tensor | None = None  # frames fed, from frame stride * _control_from on
        self._canvas: Tensor | None = None  # steps run, from step _canvas_from on
        self._control_from = self._canvas_from = 0
        self._state = None
        self._fed = 0  # frames
        self._run = self._out = 0  # steps run, steps given out
        self._finished = False

    @property
    def delay(self) -> int:
        """Frames of control that must be known ahead of a frame: 75 with the paper's kernels."""
        return (2 * self._halo + 1) * self._stride - 1

    @torch.no_grad()
    def feed(self, control: Tensor) -> Tensor:
        """The next control (B, n, C), normalised; returns the frames (B, m, D) that are certain now, m may be 0."""
        if self._finished:
            raise TutorialError("the stream is finished: it takes no more control")
        if control.ndim != 3 or control.shape[-1] != self.model.config.n_control or len(control) != len(self.code):
            raise TutorialError(
                f"control of shape {tuple(control.shape)}, expected ({len(self.code)}, frames, "
                f"{self.model.config.n_control})"
            )
        self._fed += control.shape[1]
        self._control = control if self._control is None else torch.cat((self._control, control), 1)
        return self._advance(self._fed // self._stride - self._halo)

    @torch.no_grad()
    def finish(self) -> Tensor:
        """The frames still missing, (B, m, D): as many as were fed in all have come then."""
        if self._control is None or self._fed == 0:
            raise TutorialError("a stream without any control")
        self._finished = True
        lacking = -self._fed % self._stride
        if lacking:
            last = self._control[:, -1:].expand(-1, lacking, -1)
            self._control = torch.cat((self._control, last), 1)
        made = self._advance((self._fed + lacking) // self._stride)
        return made[:, : made.shape[1] - lacking]

    def _advance(self, steps: int) -> Tensor:
        """Run up to step ``steps``, not included, and give out what cannot change."""
        if steps > self._run:
            first = self._control_from
            whole = self._control.shape[1] // self._stride * self._stride
            h = self.model.encode_control(self._control[:, :whole])[:, self._run - first : steps - first]
            code = self.code[:, self._run : steps] if self.code.ndim == 3 else self.code
            if code.ndim == 3 and code.shape[1] != h.shape[1]:
                raise TutorialError(f"{self.code.shape[1]} codes, one a step, for {steps} steps of the canvas")
            canvas, self._state = self.model.run(h, code, self._state)
            self._canvas = canvas if self._canvas is None else torch.cat((self._canvas, canvas), 1)
            self._run = steps
            self._control_from = max(0, steps - self._halo)
            self._control = self._control[:, (self._control_from - first) * self._stride :]
        until = self._run if self._finished else self._run - self._halo
        if until <= self._out:
            return self._control.new_zeros(len(self.code), 0, self.model.config.dim)
        first = self._canvas_from
        certain = slice((self._out - first) * self._stride, (until - first) * self._stride)
        frames = self.model.decoder(self._canvas)[:, certain]
        self._out = until
        self._canvas_from = max(0, until - self._halo)
        self._canvas = self._canvas[:, self._canvas_from - first :]
        return frames


def synthesize_control(model: VAELSTM, control: Tensor, code: Tensor, *, chunk: int = CHUNK) -> Tensor:
    """Algorithm 1: normalised control (B, T, C) of any length T >= 1 and a code to normalised frames (B, T, D).

    code : (B, H) from :func:`prior_code` or :func:`posterior_code`; or (B, S, H), one a step, S = T / 4 rounded up.
    chunk : frames computed at once; the memory needed grows with it, the frames do not depend on it.
    """
    check_whole("the frames computed at once, chunk,", chunk)
    stream = ControlStream(model, code)
    parts = [stream.feed(control[:, k : k + chunk]) for k in range(0, control.shape[1], chunk)]
    return torch.cat((*parts, stream.finish()), 1)


# --- with a checkpoint: from control to motions ----------------------------------------------------


def generate_from_control(
    checkpoint: Checkpoint,
    control: np.ndarray | Tensor,
    *,
    fps: float | None = None,
    count: int | None = None,
    seed: int = 0,
    start: Motion | Sequence[Motion] | None = None,
    codes: str = "one",
    integrate: str = "given",
    place: Sequence[float] | np.ndarray = (0.0, 0.0),
    heading: float | np.ndarray = 0.0,
    chunk: int = CHUNK,
) -> list[Motion]:
    """Motions that follow a control signal.

    Parameters
    ----------
    control : (T, 3) turning speed in rad/s, forward and sideways velocity in m/s, positive to the left, as the
        representation's ``slices["control"]`` has them; or (K, T, 3), one for each motion.
    fps : of the control, if it is known: another rate than the network's is refused.
    count : how many motions follow a (T, 3) control, by default 1.
    seed : decides the codes. Two runs with the same arguments give the same motions.
    start : clips whose first four frames the code is drawn from (the posterior), one or K; ``None``: from the prior.
    codes : ``"one"``: a draw z_1 is the first cell state, and the network goes on from there (algorithm 1).
        ``"per-step"``: every step reads a draw of its own, the paper's other way (section 3.3). ``"held"``, which the
        paper has not: every step reads the same draw, so that people who differ keep on doing so. A single
        z_1 is forgotten within a second.
    integrate : the network puts out control as well as poses. ``"given"``: the figure moves as it was told, exactly
        along the path. ``"predicted"``: as the network says it moved, which fits the feet but leaves the path little by
        little; the motion errors of the paper's table 1 grow in this way.
    place, heading : of the first frame, as :meth:`Representation.decode` has them; or (K, 2) and (K,), one for each.
    chunk : as in :func:`synthesize_control`.

    Raises :class:`CheckpointError` for a network of another kind, ``MotionError`` for control or clips that do not fit
    it, each naming both sides; :class:`TutorialError` if the output becomes infinite or NaN.
    """
    representation = representation_of(checkpoint)
    if integrate not in INTEGRATE:
        raise TutorialError(f"unknown integrate {integrate!r}: expected one of {', '.join(INTEGRATE)}")
    control = check_control(checkpoint, control, fps=fps)
    if count is not None:
        check_whole("the number of motions to generate", count)
    if control.ndim == 3 and count not in (None, len(control)):
        raise MotionError(f"{len(control)} controls for {count} motions: expected one for each, or one for all")
    if control.ndim == 2:
        control = np.broadcast_to(control, (1 if count is None else count, *control.shape))
    if len(control) < 1:
        raise TutorialError("control for no motion at all: expected that of 1 or more")
    _check_beginning(len(control), place, heading)
    features = generate_control_features(
        checkpoint, control, seed=seed, start=start, codes=codes, chunk=chunk
    )  # (K, T, D)
    if integrate == "given":
        features[..., representation.slices["control"]] = control
    bad = ~np.isfinite(features).all(axis=(1, 2))
    if bad.any():
        raise TutorialError(f"motion {int(bad.argmax()) + 1} of {len(features)} left the finite numbers")
    positions = representation.decode_positions(features.astype(np.float64), place, heading)  # (K, T, J, 3)
    return [
        Motion(representation.skeleton, representation.fps, x, name=f"{checkpoint.system}-{k}")
        for k, x in enumerate(positions, start=1)
    ]


def _check_beginning(count: int, place: Sequence[float] | np.ndarray, heading: float | np.ndarray) -> None:
    """Raise ``MotionError`` unless a place and a heading are one for all of ``count`` motions, or one for each."""
    for name, value, last, told in (
        ("place", place, ((2,), (3,)), f"(x, z) or (x, y, z) in metres for all, or {count} of them"),
        ("heading", heading, ((),), f"a number in radians for all, or {count} of them"),
    ):
        try:
            shape = np.asarray(value, dtype=np.float64).shape
        except (TypeError, ValueError):
            raise MotionError(f"{name} {value!r}: expected {told}") from None
        if shape not in {(*lead, *end) for lead in ((), (1,), (count,)) for end in last}:
            raise MotionError(f"{name} of shape {shape} for {count} motions: expected {told}")


def generate_control_features(
    checkpoint: Checkpoint,
    control: np.ndarray,
    *,
    seed: int = 0,
    start: Motion | Sequence[Motion] | None = None,
    codes: str = "one",
    chunk: int = CHUNK,
) -> np.ndarray:
    """What :func:`generate_from_control` makes motions of: (K, T, 3) control to (K, T, D) features of the
    representation, not normalised, with the *predicted* control in its channels."""
    model, generator = control_network(checkpoint), seeded(seed)
    device = next(model.parameters()).device
    count, length = control.shape[:2]
    if codes not in CODES:
        raise TutorialError(f"unknown codes {codes!r}: expected one of {', '.join(CODES)}")
    if start is not None and codes == "per-step":
        raise TutorialError("a start tells one code: expected codes 'one' or 'held' with it, not 'per-step'")
    steps = -(-length // model.config.stride)
    if start is None:
        code = prior_code(model, count, generator, steps=steps if codes == "per-step" else None)
    else:
        code = posterior_code(model, first_poses(checkpoint, start, count).to(device), generator)
    if codes == "held":
        code = code[:, None].expand(-1, steps, -1)
    return features_from_code(checkpoint, control, code, chunk=chunk)


def features_from_code(checkpoint: Checkpoint, control: np.ndarray, code: Tensor, *, chunk: int = CHUNK) -> np.ndarray:
    """What the network makes of codes that are at hand: control (K, T, 3) and a code, (K, H) or one a step (K, S, H),
    to features (K, T, D) of the representation, not normalised, with the *predicted* control in its channels."""
    model, normalizer = control_network(checkpoint), _normalizer(checkpoint)
    device, channels = next(model.parameters()).device, slice(*model.config.control)
    control = torch.as_tensor(np.array(control), dtype=torch.float32)
    wanted = (control - normalizer.mean[channels]) / normalizer.std[channels]
    made = synthesize_control(model, wanted.to(device), code.to(device), chunk=chunk).cpu()  # (K, T, D)
    return normalizer.invert(made).numpy()


def first_poses(checkpoint: Checkpoint, start: Motion | Sequence[Motion], count: int = 1) -> Tensor:
    """The first frames of clips as :func:`posterior_code` reads them: normalised poses (count, 4, J3).

    One clip serves for all. Clips are brought to the network's joints, frame rate and size; ``MotionError`` naming both
    sides where that cannot be, or where one is shorter than the pooling.
    """
    model, representation = control_network(checkpoint), representation_of(checkpoint)
    motions = [start] if isinstance(start, Motion) else list(start)
    if len(motions) not in (1, count):
        raise MotionError(f"{len(motions)} clips to start {count} motions from: expected one for each, or one for all")
    need = model.config.stride
    motions = prepare_for(checkpoint, motions)
    for motion in motions:
        if len(motion) < need:
            raise MotionError(
                f"motion {motion.name!r} has {len(motion)} frames at {motion.fps:g} per second, the network's "
                f"pooling makes one step of {need}: expected {need} or more to start from"
            )
    features = torch.from_numpy(np.stack([representation.encode(motion[:need]) for motion in motions]))
    pose, _ = model.split(_normalizer(checkpoint).apply(features.float()))
    return pose.expand(count, -1, -1)


def check_control(checkpoint: Checkpoint, control: np.ndarray | Tensor, *, fps: float | None = None) -> np.ndarray:
    """``control`` as float32 ``(T, C)`` or ``(K, T, C)`` if the network can follow it, else ``MotionError``."""
    model, representation = control_network(checkpoint), representation_of(checkpoint)
    try:
        values = np.asarray(control, dtype=np.float32)
    except (TypeError, ValueError):  # ragged, or text
        raise MotionError(
            f"control: expected numbers, an array (frames, channels), found {type(control).__name__}"
        ) from None
    names = representation.labels[slice(*model.config.control)]
    if values.ndim not in (2, 3) or values.shape[-1] != len(names) or values.shape[-2] < 1:
        raise MotionError(
            f"control of shape {values.shape}: the network follows (frames, {len(names)}), {', '.join(names)}"
        )
    if fps is not None and not (is_real(fps) and same_rate(fps, representation.fps)):
        told = f"{fps:g}" if is_real(fps) else repr(fps)
        raise MotionError(
            f"control at {told} frames per second, the network was trained at {representation.fps:g}: expected that"
        )
    if not np.isfinite(values).all():
        frame, channel = np.argwhere(~np.isfinite(values))[0][-2:]
        raise MotionError(f"control: {names[channel]} of frame {frame} is {values[..., frame, channel].flat[0]}")
    return values


def control_network(checkpoint: Checkpoint) -> VAELSTM:
    """The network of a checkpoint, if it follows control; else ``CheckpointError``."""
    if not isinstance(checkpoint.model, VAELSTM):
        raise CheckpointError(
            f"the checkpoint is of system {checkpoint.system!r}, which follows no control signal: expected 'vae-lstm'"
        )
    return checkpoint.model


def _normalizer(checkpoint: Checkpoint) -> Normalizer:
    return checkpoint.normalizer or Normalizer.identity(checkpoint.model.config.dim)
