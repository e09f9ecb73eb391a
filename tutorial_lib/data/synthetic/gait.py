"""Walking and running, from published gait curves.

Sources
    Leg angles over a stride: walking after Winter, *Biomechanics and Motor Control of Human Movement*
    (4th ed. 2009) for knee and ankle and Perry and Burnfield, *Gait Analysis* (2nd ed. 2010) for the
    thigh; running after Novacheck 1998, "The biomechanics of running". The values below are a few key
    points of those curves, rounded to degrees: an approximation, not a table of measurements.
    Walking cadence: a constant ratio of step length to cadence (Sekiya and Nagasaki 1998, who find about
    0.0065 m per step/min); 0.0062 here, which suits this body.
    Running cadence: nearly constant, rising slowly with speed
    (Cavagna et al. 1988). Stance share: Grieve and Gear 1966; Novacheck 1998.
    Rise and sway of the body in walking: Orendurff et al. 2004. Its bounce in running: contact force
    a half sine wave, gravity in flight (Morin et al. 2005). Arm swing: Murray et al. 1967.

The curves shape the swing of the foot and how it rolls. Footprints are planned on the ground first, and
the legs are solved from them (``body.Body``), so that a foot that stands stays where it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from ...chance import whole_seed
from ...errors import MotionError
from ...motion.clip import Motion
from ...motion.ground import SIDEWAYS_LIMIT, TURNING_LIMIT, GroundPath, braked, check_path
from . import body
from .body import LEG, Body, Foot, Pose, hanging_arm, rot_x, rot_y, rot_z, within
from .path import random_path
from .signals import bump, ease, noise, smooth

SPEEDS = (0.6, 4.0)
GRAVITY = 9.81


def _curve(*pairs: tuple[float, float]) -> CubicSpline:
    """A periodic curve over the stride (0 to 1) through (per cent, degrees), in radians."""
    p, degrees = np.array([*pairs, (100, pairs[0][1])], float).T
    return CubicSpline(p / 100, np.deg2rad(degrees), bc_type="periodic")


# thigh from the vertical, forward positive; knee flexion; ankle, toes up positive. 0 % is foot strike.
WALK = (
    _curve((0, 23), (10, 19), (20, 10), (30, -1), (40, -12), (50, -19), (56, -18), (62, -10), (70, 6), (78, 18),
           (86, 25), (94, 25)),
    _curve((0, 4), (7, 14), (15, 20), (25, 15), (38, 8), (46, 10), (54, 23), (62, 43), (72, 65), (80, 53),
           (88, 24), (95, 4)),
    _curve((0, 0), (6, -5), (12, 0), (20, 4), (32, 7), (44, 10), (52, 4), (58, -10), (64, -19), (72, -11),
           (80, -1), (90, 1)),
)  # fmt: skip
WALK_TOE_OFF = 0.61
RUN = (
    _curve((0, 26), (8, 22), (16, 11), (26, -5), (38, -22), (44, -24), (52, -10), (62, 14), (72, 32), (82, 41),
           (92, 34)),
    _curve((0, 15), (8, 33), (15, 42), (26, 33), (38, 19), (46, 42), (56, 78), (65, 92), (75, 76), (85, 42),
           (94, 15)),
    _curve((0, 4), (8, 9), (18, 22), (28, 8), (38, -20), (46, -17), (56, -5), (70, 2), (85, 5)),
)  # fmt: skip
RUN_TOE_OFF = 0.38


@dataclass(frozen=True)
class Stride:
    """One stride at a given speed, as curves over its phase: what both feet and the pelvis repeat."""

    speed: float
    running: bool
    rate: float  # strides a second
    duty: float  # share of the stride that a foot stands
    under: float  # the phase at which the flat foot's ankle passes under the hip
    height: float  # of the hip joints, on average
    phase: np.ndarray  # (P,) from 0 to 1
    pitch: np.ndarray  # (P,) the foot's roll
    progress: np.ndarray  # (P,) share of the way from one footprint to the next
    lift: np.ndarray  # (P,) metres
    bounce: np.ndarray  # (P,) rise of the body, against the left foot's phase

    def at(self, curve: np.ndarray, phase: np.ndarray) -> np.ndarray:
        return np.interp(phase % 1.0, self.phase, curve)


def stride_rate(speed: np.ndarray, running: bool) -> np.ndarray:
    """Strides (two steps) a second at ``speed`` in m/s.

    Walking beyond 2 m/s, where people would run, lengthens the steps little: the legs are only so long.
    """
    if running:
        return 0.5 * (2.45 + 0.12 * np.asarray(speed))
    speed = np.asarray(speed)
    step = np.sqrt(0.0062 * 60.0 * np.minimum(speed, 2.0)) + 0.05 * np.maximum(speed - 2.0, 0.0)
    return 0.5 * speed / step


def duty_factor(speed: float, running: bool) -> float:
    """The share of a stride that each foot is on the ground: above a half walking, below running."""
    if running:
        return float(np.interp(speed, [0.6, 2.0, 3.0, 4.0], [0.41, 0.385, 0.35, 0.31]))
    return float(np.interp(speed, [0.6, 1.3, 2.0, 4.0], [0.65, 0.605, 0.575, 0.52]))


def make_stride(speed: float, running: bool) -> Stride:
    """The stride at one speed: the published curves, made to meet the ground exactly."""
    phase = np.linspace(0.0, 1.0, 241)
    rate, duty = float(stride_rate(speed, running)), duty_factor(speed, running)
    length = speed / rate
    curves, toe_off = (RUN, RUN_TOE_OFF) if running else (WALK, WALK_TOE_OFF)
    # bend the published phase so that its toe-off falls on this speed's
    published = phase + (toe_off - duty) * (np.sin(np.pi * phase) / np.sin(np.pi * duty)) ** 2
    thigh, knee, ankle = (c(published) for c in curves)
    usual = (3.0 / float(stride_rate(3.0, True))) if running else (1.3 / float(stride_rate(1.3, False)))
    reach = length / usual
    thigh = thigh.mean() + (thigh - thigh.mean()) * np.clip(reach, 0.2, 1.35) ** (0.7 if running else 0.9)
    knee = knee * (np.clip(reach, 0.2, 1.4) ** 0.5 if running else np.clip(reach, 0.6, 1.15) ** 0.3)
    shank = thigh - knee
    pitch = _foot_roll(phase, shank + ankle, duty, running, reach)
    bounce = _bounce(phase, speed, rate, duty, running)

    # the ankle seen from the hip joint, then from the ground
    hip = length * phase
    ahead = hip + body.THIGH * np.sin(thigh) + body.SHANK * np.sin(shank)
    above = -body.THIGH * np.cos(thigh) - body.SHANK * np.cos(shank) + bounce
    roll_ahead, roll_above = _roll(pitch)
    swing = phase >= duty
    tau = (phase - duty) / (1.0 - duty)
    forward, up = ahead - roll_ahead, above - roll_above
    start = np.interp(duty, phase, forward)
    progress = np.where(swing, _grounded((forward - start) / (forward[-1] - start), tau, swing, 1.0), 0.0)
    progress = progress * ease(tau / 0.08)  # up before forward: the ball leaves the ground without scraping
    lift = np.where(swing, _grounded(up - np.interp(duty, phase, up), tau, swing, 0.0), 0.0)
    least = 0.04 if running else 0.024  # metres above the ground in mid-swing
    clear = np.where(swing, least * bump(np.clip(tau, 0, 1) ** 0.75) ** 0.75, 0.0)
    soft = 0.3 * clear
    lift = 0.5 * (lift + clear + np.sqrt((lift - clear) ** 2 + soft**2))

    under, height = _stance(phase, pitch, bounce, length, duty, running)
    return Stride(speed, running, rate, duty, under, height, phase, pitch, progress, lift, bounce)


def _foot_roll(phase, pitch, duty, running, reach):
    """The published foot angle, flat while the whole sole carries the body."""
    p = phase / duty
    flat_from, flat_to = (0.24, 0.34) if running else (0.15, 0.5)
    rise = 0.8 if running else 0.74
    flat = ease(p / flat_from) * (1.0 - ease((p - flat_to) / (rise - flat_to)))
    flat = np.where(p <= 1.0, flat, 0.0)
    # after the strike the sole comes down on to the ground once, and rests
    landing = 0.5 * (pitch + np.hypot(pitch, np.deg2rad(2.0)))
    leaving = np.where(p < 1.0, landing - np.hypot(pitch, np.deg2rad(2.0)), pitch)
    pitch = np.where(p < 0.5 * (flat_from + flat_to), landing, leaving) * (1.0 - flat)
    strike = np.deg2rad(18 if running else 20) * np.clip(reach, 0.5, 1.15)
    return np.where(pitch > 0, strike * np.tanh(pitch / strike), pitch)


def _roll(pitch):
    """How far ahead of and above its flat place the ankle is when the foot has rolled by ``pitch``."""
    n = len(pitch)
    foot = Foot(np.zeros((n, 3)), np.zeros(n), pitch, np.ones(n))
    ankle = foot.solve()[0]
    return ankle[:, 2] + body.BALL[2], ankle[:, 1] - body.ANKLE_HEIGHT


def _grounded(curve, tau, swing, end):
    """A curve over the swing, bent near its ends so that it starts at 0 and arrives at ``end``, at rest."""
    first = int(np.argmax(swing))
    h = tau[1] - tau[0]
    v0, v1 = (curve[first + 1] - curve[first]) / h, (curve[-1] - curve[-2]) / h
    t = np.clip(tau, 0.0, 1.0)
    reach = 0.35  # of the swing, from either end, in which the ground's pull fades
    off = v0 * t * np.clip(1 - t / reach, 0, 1) ** 3 - v1 * (1 - t) * np.clip(1 - (1 - t) / reach, 0, 1) ** 3
    return curve - off - (curve[-1] - end) * ease(t)


def _bounce(phase, speed, rate, duty, running):
    """The rise of the body around its mean (P,), twice a stride; phase 0 is the left foot's strike."""
    if not running:
        swing = np.interp(speed, [0.6, 0.7, 1.2, 1.6, 2.5, 4.0], [0.024, 0.027, 0.040, 0.048, 0.055, 0.05])
        return -0.5 * swing * np.cos(4 * np.pi * (phase - 0.045))
    step = 0.5 / rate
    contact = duty / rate
    u = (phase % 0.5) / rate  # seconds since the last foot strike
    push = np.pi / 2 * step / contact * np.sin(np.pi * np.clip(u / contact, 0.0, 1.0))
    acceleration = GRAVITY * (np.where(u < contact, push, 0.0) - 1.0)
    # integrate twice over one periodic step, in the Fourier domain
    a = np.fft.rfft(acceleration[:-1])
    omega = 2 * np.pi * rate * np.arange(len(a))
    a[1:] /= -(omega[1:] ** 2)
    a[0] = 0.0
    rise = np.fft.irfft(a, len(phase) - 1)
    return np.append(rise, rise[0])


def _stance(phase, pitch, bounce, length, duty, running):
    """Where the foot stands under the body, and how high the hip may be, for legs almost straight."""
    stand = phase <= duty
    roll_ahead, roll_above = _roll(pitch[stand])
    under = np.linspace(0.25, 0.6, 71)[:, None] * duty
    ahead = length * (under - phase[stand]) + roll_ahead
    straight = LEG * (0.988 if running else 0.997)
    room = np.sqrt(np.maximum(straight**2 - ahead**2, 0.01))
    highest = (body.ANKLE_HEIGHT + roll_above + room - bounce[stand]).min(1)
    best = int(np.argmax(highest))
    return float(under[best, 0]), float(highest[best])


# ---------------------------------------------------------------------------------------------------


def walking(seconds: float, *, speed: float = 1.3, path=None, fps: float = 30.0, seed: int = 0) -> Motion:
    """A person walking, in mid-gait from the first frame to the last.

    seconds: length of the motion; speed: 0.6 to 4 m/s (people change to running near 2); path: ground
    points (N, 2), x and z in metres, or None for a gentle random path (a closed path is followed
    round and round, an open one straight on past its end); seed: the same seed gives the same motion.
    Sharp corners are rounded and, where the body could not turn as fast, walked more slowly.
    Raises MotionError for a speed, path, length or rate that makes no sense, TutorialError for a seed that is none.
    """
    return _locomotion(seconds, speed, path, fps, seed, running=False)


def running(seconds: float, *, speed: float = 3.0, path=None, fps: float = 30.0, seed: int = 0) -> Motion:
    """A person running, with a flight phase between steps; see ``walking`` for the arguments."""
    return _locomotion(seconds, speed, path, fps, seed, running=True)


def check_time(seconds: float, fps: float) -> int:
    """The number of frames, or a one-line error."""
    if not (np.isfinite(fps) and 1 <= fps <= 1000):
        raise MotionError(f"fps {fps}: expected 1 to 1000 frames a second")
    if not (np.isfinite(seconds) and 1 <= seconds * fps <= 10_000_000):
        raise MotionError(f"seconds {seconds}: expected at least one frame, at most ten million")
    return int(round(seconds * fps))


def _locomotion(seconds, speed, path, fps, seed, running):
    n = check_time(seconds, fps)
    if not (np.isfinite(speed) and SPEEDS[0] <= speed <= SPEEDS[1]):
        raise MotionError(f"speed {speed}: expected {SPEEDS[0]} to {SPEEDS[1]} m/s")
    rng = np.random.default_rng([whole_seed(seed), int(running)])
    points = random_path(rng, seconds * speed + 4, speed) if path is None else check_path(path)
    way = GroundPath(points, rounding=0.12 + 0.10 * speed)
    stride = make_stride(float(speed), running)
    t = np.arange(n) / fps
    # a margin before and after, so that the first and last footprints are strides like any other
    margin = int(np.ceil(2.5 / stride.rate * fps))
    wide = (np.arange(n + 2 * margin) - margin) / fps
    s, phase, pace = _progress(rng, way, stride, wide, margin, fps)
    feet = [_feet(rng, way, stride, wide, s, phase + shift, sign, t) for shift, sign in ((0.0, 1.0), (0.5, -1.0))]
    keep = slice(margin, margin + n)
    s, phase, pace = s[keep], phase[keep], pace[keep]
    figure = _figure(rng, way, stride, t, s, phase, pace, feet, fps)
    return figure.motion("running" if running else "walking")


def _progress(rng, way, stride, t, margin, fps):
    """Distance along the path, phase of the left foot and speed (T,), slower where the path turns sharply."""
    speed = stride.speed
    # along the path: as fast as asked for, or as turning allows (sideways force, turning speed)
    far = 1.15 * speed
    grid = np.arange(far * t[0] - 1.0, far * t[-1] + 1.0, 0.02)
    turn = np.maximum(np.abs(way.curvature(grid)), 1e-6)
    limit = np.maximum(np.minimum(np.sqrt(SIDEWAYS_LIMIT / turn), TURNING_LIMIT / turn), 0.12)
    allowed = np.minimum(speed, smooth(braked(np.minimum(limit, 2 * SPEEDS[1]), grid), 0.1, 1 / 0.02))
    clock = np.concatenate([[0.0], np.cumsum(0.02 / allowed[:-1])])
    clock -= np.interp(0.0, grid, clock)
    # the person's own clock runs a little unevenly
    dt = 1.0 / fps
    own = np.cumsum(1.0 + noise(rng, t, 0.018, 0.04, 0.35)) * dt
    s = np.interp(own - own[margin], clock, grid)
    v = np.gradient(s, dt) if len(s) > 1 else np.array([speed])
    slower = stride_rate(np.maximum(smooth(v, 0.1, fps), 0.3), stride.running)
    rate = stride.rate * slower / stride_rate(speed, stride.running)
    rate = rate * (1.0 + noise(rng, t, 0.015, 0.1, 0.8))
    phase = np.cumsum(rate) * dt
    return s, phase - phase[margin] + rng.random(), v


def _feet(rng, way, stride, wide, s, phase, sign, t):
    """One foot's footprints on the ground, and the foot over the frames at ``t``."""
    first, last = int(np.ceil(phase[0])), int(np.floor(phase[-1]))
    k = np.arange(first, last + 1)
    # footprint k: under the hip at phase k + under
    at = np.interp(k + stride.under, phase, s)
    heading = way.heading(at)
    width = (0.018 if stride.running else 0.046) + rng.normal(0, 0.006 if stride.running else 0.009, len(k))
    at = at + rng.normal(0, 0.012, len(k))
    side = np.stack([np.cos(heading), -np.sin(heading)], -1)
    place = way.position(at) + sign * width[:, None] * side
    toe_out = np.deg2rad(7.0) + rng.normal(0, np.deg2rad(1.2), len(k))
    print_yaw = heading + sign * toe_out
    # the print is the ball's place: ahead of the ankle
    place = place + body.BALL[2] * np.stack([np.sin(print_yaw), np.cos(print_yaw)], -1)
    high = 1.0 + rng.normal(0, 0.05, len(k))

    p = np.interp(t, wide, phase)
    j = np.clip(np.floor(p).astype(int) - first, 0, len(k) - 2)
    q = p % 1.0
    u = stride.at(stride.progress, q)[:, None]
    base = np.zeros((len(t), 3))
    base[:, ::2] = place[j] + (place[j + 1] - place[j]) * u
    # the swinging foot passes the standing one: a little outwards
    tau = np.clip((q - stride.duty) / (1 - stride.duty), 0, 1)
    out = 0.012 * bump(tau) * sign
    base[:, 0] += out * np.cos(heading[j])
    base[:, 2] -= out * np.sin(heading[j])
    base[:, 1] = stride.at(stride.lift, q) * high[j]
    yaw = print_yaw[j] + (print_yaw[j + 1] - print_yaw[j]) * ease(tau)
    pitch = stride.at(stride.pitch, q)
    toes = np.where(q < stride.duty, 1.0, 1.0 - ease(tau / 0.35))
    return Foot(base, yaw, pitch, toes)


def _figure(rng, way, stride, t, s, phase, pace, feet, fps):
    """Pelvis, trunk, head and arms over the feet."""
    run, v = stride.running, stride.speed
    w = 2 * np.pi * phase  # 0 at the left foot's strike
    heading = smooth(way.heading(s), 0.12, fps)
    degrees = np.deg2rad
    walk_swing = float(np.interp(v, [0.6, 1.3, 2.0, 4.0], [0.55, 1.0, 1.35, 1.6]))
    run_swing = float(np.interp(v, [0.6, 2.0, 4.0], [0.5, 0.8, 1.15]))
    swing = run_swing if run else walk_swing

    # pelvis: yaw with the leading leg, hip of the standing leg up, a sway towards it
    turn = degrees(6.0 if run else 4.5) * swing * (1 + noise(rng, t, 0.06))
    yaw = -turn * np.cos(w - (0.5 if run else 0.2))
    oblique = degrees(4.5 if run else 4.0) * min(swing, 1.3) * np.cos(w - 2 * np.pi * (0.13 if run else 0.15))
    tilt = degrees(7.0 if run else 3.5) + degrees(1.2) * np.cos(2 * w - 0.8) + noise(rng, t, degrees(0.5))
    sway = 0.010 if run else float(np.interp(v, [0.6, 0.7, 1.6, 4.0], [0.033, 0.032, 0.018, 0.012]))
    sway = sway * np.cos(w - 2 * np.pi * (0.19 if run else 0.31)) + noise(rng, t, 0.004, 0.05, 0.4)
    sideways = smooth(pace**2 * way.curvature(s), 0.25, fps)
    bank = within(np.arctan(sideways / GRAVITY), 0.5)  # in a left turn the body leans left
    surge = -0.006 * np.cos(2 * w - 0.5)
    place = way.position(s + surge)
    pelvis = rot_y(heading + yaw) @ rot_x(tilt) @ rot_z(oblique - 0.5 * bank)
    side = np.stack([np.cos(heading), -np.sin(heading)], -1)
    inward = 0.9 * stride.height * np.tan(0.85 * bank)
    place = place + side * (sway + inward)[:, None]
    hip_height = stride.height + stride.at(stride.bounce, phase) + noise(rng, t, 0.003, 0.05, 0.5)
    hip_height = hip_height - 0.5 * stride.height * bank**2
    root = np.stack([place[:, 0], hip_height + body.HIP_DROP * np.cos(tilt), place[:, 1]], -1)

    # trunk: turns against the pelvis, stays upright over it; the head looks where the path goes
    lean = degrees(2.0 + 1.6 * v if run else 1.0 + 1.2 * v) + noise(rng, t, degrees(0.8), 0.05, 0.3)
    counter = degrees(7.5 if run else 3.5) * swing
    chest_yaw = counter * np.cos(w - (0.4 if run else 0.35)) + noise(rng, t, degrees(1.0), 0.05, 0.4)
    bend = np.stack(
        [
            lean - tilt + degrees(1.0) * np.cos(2 * w - 1.6),
            -0.85 * oblique + noise(rng, t, degrees(0.6), 0.05, 0.4) - 0.15 * bank,
            chest_yaw - yaw,
        ],
        -1,
    )
    ahead = smooth(way.heading(s + 0.7 * v + 0.3), 0.2, fps)
    look = heading + 0.75 * (ahead - heading) + noise(rng, t, degrees(3.0), 0.05, 0.35)
    nod = degrees(3.0) + noise(rng, t, degrees(2.0), 0.05, 0.3) - degrees(1.2) * np.cos(2 * w - 1.0)
    head = rot_y(look) @ rot_x(nod) @ rot_z(-0.3 * bank + 0.15 * chest_yaw)

    pose = Pose(root, pelvis, tuple(feet), bend, head, straight=0.992 if run else 0.9985, ankle=0.56)
    for name, sign in (("Left", 1.0), ("Right", -1.0)):
        along = -sign * np.cos(w - 0.35)  # forward with the other leg
        pose.shoulders[name] = np.stack(
            [degrees(2.0) + degrees(1.0) * np.cos(2 * w - 1), degrees(3.0) * swing * along], -1
        )
    figure = Body(pose, fps)
    even = rng.normal(0, 0.08)  # the arms never swing quite alike
    for name, sign in (("Left", 1.0), ("Right", -1.0)):
        size = swing * (1 + sign * even) * (1 + noise(rng, t, 0.09, 0.05, 0.4))
        lag = 0.25 if not run else 0.35
        along = -sign * np.cos(w - lag)
        later = -sign * np.cos(w - lag - 0.5)  # elbow and wrist follow the shoulder
        drift = noise(rng, t, degrees(1.5), 0.05, 0.3)
        if run:
            flexion = degrees(-14.0) + degrees(25.0) * size * along + drift
            out = degrees(13.0) - degrees(4.0) * along + noise(rng, t, degrees(1.5))
            inward = degrees(28.0) + degrees(14.0) * size * along
            elbow = degrees(92.0) + degrees(11.0) * size * later + noise(rng, t, degrees(3.0), 0.05, 0.3)
            turn = degrees(-10.0)
        else:
            flexion = degrees(-7.0) + degrees(15.5) * size * along + drift
            out = degrees(7.5) + noise(rng, t, degrees(1.0))
            inward = degrees(22.0) + degrees(6.0) * size * later
            elbow = degrees(20.0 + 5.0 * v) + degrees(10.0) * size * later
            elbow = elbow + noise(rng, t, degrees(2.0), 0.05, 0.3)
            turn = degrees(15.0)
        upper = figure["Chest"] @ rot_x(-0.6 * lean) @ hanging_arm(name, flexion, out, inward)
        wrist = np.stack([degrees(8.0) - degrees(5.0) * later, degrees(3.0) + 0 * later], -1)
        figure.set_arm(name, upper, elbow, turn, wrist)
    return figure
