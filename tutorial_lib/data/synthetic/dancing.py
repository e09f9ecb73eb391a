"""Dancing: phrases of eight beats from a small grammar of steps, turns and arm figures.

A phrase draws its energy, its groove and its figures at random; a figure is a list of steps of the free
foot, told from the foot that stands; the arms go through key poses at times of their own. The
vocabulary is common to many social dances; the choreography is this project's own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...chance import whole_seed
from ...errors import MotionError
from ...motion.clip import Motion
from .body import FOREARM, SIDES, UPPER_ARM, Body, Pose, apply, rot_x, rot_y, rot_z, within
from .gait import check_time
from .signals import Track, bump, noise, smooth
from .steps import PlannedFoot, Weight, forward_of, left_of

DEG = np.pi / 180
ARM = UPPER_ARM + FOREARM
_SIGN = {"Left": 1.0, "Right": -1.0}
_HEIGHT = 0.912  # of the pelvis
_TOE_OUT = 12 * DEG
_ROOM = 2.2  # metres that the dancer stays within, more or less


@dataclass(frozen=True)
class Step:
    """One step of the free foot.

    beats: from the step before; out, ahead: metres from the standing foot, away from it and forward;
    turn: of the body, degrees, towards the free foot's side; touch: the weight stays where it is;
    lift: metres; dip: metres that the body sinks on arrival.
    """

    beats: float
    out: float
    ahead: float
    turn: float = 0.0
    touch: bool = False
    lift: float = 0.05
    dip: float = 0.0


_SIDE, _CLOSE = Step(1, 0.42, 0.0), Step(1, 0.17, 0.0)
_TAP = Step(1, 0.19, 0.03, touch=True, lift=0.035)
_STEP, _BACK = Step(1, 0.16, 0.44), Step(1, 0.17, -0.38)

# figures: steps that alternate feet (a touch leaves the same foot free), and how often they are drawn
FIGURES: dict[str, tuple[float, tuple[Step, ...]]] = {
    "side together side touch": (2.0, (_SIDE, _CLOSE, _SIDE, _TAP)),
    "side touch": (2.5, (Step(1, 0.46, 0.0, dip=0.03), _TAP)),
    "grapevine": (1.6, (_SIDE, Step(1, -0.16, -0.20), Step(1, 0.44, 0.0), Step(1, -0.14, 0.22))),
    "walk": (1.6, (_STEP, _STEP)),
    "walk back": (1.2, (_BACK, _BACK)),
    "box": (1.4, (Step(1, -0.12, 0.26), Step(1, 0.18, -0.34), _SIDE, Step(1, 0.16, 0.22))),
    "rock and triple": (1.6, (Step(1, 0.15, 0.34, dip=0.03), Step(1, 0.20, -0.02), Step(0.5, 0.34, 0.0),
                              Step(0.5, 0.17, 0.0), Step(1, 0.36, 0.0))),
    "rock back": (1.2, (Step(1, 0.14, -0.33, dip=0.02), Step(1, 0.18, 0.02))),
    "three-step turn": (1.1, (Step(1, 0.36, 0.10, 100), Step(1, 0.30, 0.0, -130), Step(1, 0.34, 0.0, 130), _TAP)),
    "half turn": (1.0, (Step(1, 0.15, 0.34), Step(1, 0.22, -0.06, 90), Step(1, 0.17, 0.05, -90))),
    "quarter turn": (1.6, (Step(1, 0.30, 0.10, 80), _CLOSE)),
    "lunge": (1.0, (Step(1, 0.62, 0.08, dip=0.12), Step(1, 0.30, 0.0))),
    "kick step": (1.2, (Step(1, 0.14, 0.50, touch=True, lift=0.26), Step(1, 0.18, 0.0))),
    "point and close": (1.4, (Step(1, 0.46, 0.10, touch=True), Step(1, 0.18, 0.02))),
    "double time": (1.3, (Step(0.5, 0.22, 0.10), Step(0.5, 0.20, -0.06), Step(0.5, 0.24, 0.08),
                          Step(0.5, 0.20, -0.05))),
    "hip sway": (1.5, (Step(1, 0.34, 0.0, lift=0.03), Step(1, 0.34, 0.0, lift=0.03))),
    "long step and drag": (0.9, (Step(2, 0.60, 0.06, dip=0.08), Step(1, 0.20, 0.02, touch=True, lift=0.02))),
}  # fmt: skip

# the wrist from its shoulder in the chest's frame, as shares of the arm, and where the elbow points:
# outwards, up, forward
ARM_POSES: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "low": ((0.26, -0.88, 0.16), (0.8, -0.1, -0.6)),
    "low front": ((0.02, -0.66, 0.48), (0.8, -0.5, -0.4)),
    "side": ((0.93, 0.02, 0.20), (0.0, -0.7, -0.7)),
    "side low": ((0.72, -0.52, 0.16), (0.3, -0.2, -0.9)),
    "high": ((0.34, 0.90, 0.16), (0.9, -0.1, -0.2)),
    "crown": ((-0.02, 0.74, 0.22), (1.0, 0.1, 0.1)),
    "front": ((-0.02, 0.02, 0.90), (0.6, -0.8, 0.0)),
    "front high": ((0.08, 0.52, 0.76), (0.8, -0.5, 0.0)),
    "hip": ((0.10, -0.62, 0.08), (0.95, 0.0, -0.5)),
    "chest": ((-0.26, -0.06, 0.40), (0.9, -0.25, -0.2)),
    "across": ((-0.50, 0.04, 0.58), (0.8, -0.5, 0.1)),
    "bent up": ((0.48, 0.42, 0.22), (0.6, -0.8, -0.2)),
    "diagonal": ((0.66, 0.62, 0.26), (0.3, -0.7, -0.5)),
    "behind": ((0.34, -0.74, -0.36), (0.6, 0.3, -0.7)),
    "brow": ((-0.02, 0.34, 0.46), (0.9, -0.35, 0.1)),
}  # fmt: skip


class _Plan:
    """The dancer's key frames from before 0 until after ``until`` seconds."""

    def __init__(self, rng: np.random.Generator, until: float, tempo: float):
        self.rng = rng
        self.beat = 60.0 / tempo
        self.now = -2.0 * self.beat * rng.uniform(1.0, 2.0)
        self.start = self.now
        self.facing = rng.uniform(-np.pi, np.pi)
        self.face = Track(self.facing)
        self.free = rng.choice(SIDES)
        self.feet = {}
        for side in SIDES:
            place = 0.09 * _SIGN[side] * left_of(self.facing)
            self.feet[side] = PlannedFoot(place, self.facing + _SIGN[side] * _TOE_OUT)
        self.weight = Weight(0.5)
        self.sink, self.tilt, self.twist = Track(0.0), Track(0.0), Track(0.0)
        self.bow, self.side, self.hips, self.gaze = Track(0.0), Track(0.0), Track(0.0), Track(0.0)
        self.energy, self.groove, self.off_beat = Track(0.8), Track(0.02), 0.0
        self.arms = {
            side: (Track(_pose(side, "low")), Track(np.array(ARM_POSES["low"][1]) * _mirror(side))) for side in SIDES
        }
        self.palm = {side: Track(0.3) for side in SIDES}
        while self.now < until + 2.0:
            self._phrase()

    # -- the phrase: eight beats ---------------------------------------------------------------------------

    def _phrase(self):
        rng, end = self.rng, self.now + 8 * self.beat
        energy = rng.uniform(0.6, 1.15)
        self.level = energy
        self.energy.move(self.now, self.now + self.beat, energy)
        self.groove.move(self.now, self.now + self.beat, rng.uniform(0.008, 0.035) * energy)
        arms_from, beat_from = self.now, self.now
        names = list(FIGURES)
        chance = np.array([FIGURES[name][0] for name in names])
        again = None
        while self.now < end - 0.25 * self.beat:
            left = (end - self.now) / self.beat
            if again is not None and rng.random() < 0.35:
                steps = FIGURES[again][1]  # repeated to the other side
            else:
                again = rng.choice(names, p=chance / chance.sum())
                steps = FIGURES[again][1]
            pace = 1.0
            if again not in ("double time", "rock and triple") and rng.random() < 0.15:
                pace = 0.5 if rng.random() < 0.4 else 2.0
            steps = [s for k, s in enumerate(steps) if sum(x.beats for x in steps[: k + 1]) * pace <= left + 0.3]
            if not steps:
                self._pause(left)
                continue
            mirrored_turn = rng.choice([1.0, 1.0, -1.0])
            for step in steps:
                self._step(step, pace, mirrored_turn)
            if rng.random() < 0.12:
                self._pause(rng.choice([0.5, 1.0]))
        self.now = end
        self._arms(arms_from, end)
        self._trunk(beat_from, end)

    def _pause(self, beats):
        """The feet rest; hips and arms go on."""
        rng = self.rng
        beats = float(min(beats, 1.5))
        share = 0.5 + rng.choice([-1, 1]) * rng.uniform(0.15, 0.3)
        self.weight.shift(self.now, self.now + 0.8 * beats * self.beat, share)
        self.now += beats * self.beat

    def _step(self, step: Step, pace: float, turn_sign: float):
        rng, free = self.rng, self.free
        stand = "Right" if free == "Left" else "Left"
        sign = _SIGN[free]
        size = np.clip(self.level * rng.normal(1.0, 0.10), 0.55, 1.25)
        length = step.beats * self.beat * pace
        arrive = self.now + length + rng.normal(0, 0.015)
        time = np.clip(rng.uniform(0.62, 0.85) * length, 0.20, 0.85)
        leave = arrive - time
        turn = step.turn * DEG * sign * turn_sign * rng.normal(1.0, 0.08)
        turn += rng.normal(0, 6 * DEG) + self._homeward(rng)
        facing = self.facing + turn
        out = step.out if abs(step.out) < 0.25 else step.out * size
        place = (
            self.feet[stand].place.last
            + sign * out * left_of(facing)
            + step.ahead * size * forward_of(facing)
            + rng.normal(0, 0.012, 2)
        )
        here = self.feet[free].place.last
        far, most = float(np.linalg.norm(place - here)), 2.3 * time  # metres: feet are only so quick
        place = here + (place - here) * min(1.0, most / max(far, 1e-6))
        yaw = facing + sign * (_TOE_OUT + rng.normal(0, 3 * DEG))
        # the weight leaves the free foot before it moves
        gone = 0.12 if stand == "Right" else 0.88
        self.weight.shift(leave - 0.20 * min(1.0, time / 0.4), leave + 0.25 * time, gone)
        lift = step.lift * (0.8 + 0.4 * size)
        self.feet[free].step(leave, arrive, place, yaw, lift=lift, roll=0.35 + 0.6 * min(step.lift, 0.1))
        if abs(turn) > 12 * DEG:
            stand_yaw = facing - sign * (_TOE_OUT + 4 * DEG)
            self.feet[stand].pivot(leave + 0.05 * time, arrive - 0.05 * time, stand_yaw, heel=0.22)
        self.face.move(leave - 0.03, arrive + 0.04, facing)
        self.facing = facing
        if step.dip or rng.random() < 0.15:
            dip = (step.dip + rng.uniform(0.0, 0.03)) * size
            self.sink.move(leave + 0.3 * time, arrive + 0.05, dip)
            self.sink.move(arrive + 0.1, arrive + 0.1 + 0.6 * self.beat, 0.0)
        if not step.touch:
            arrived = 0.78 if free == "Left" else 0.22
            self.weight.shift(arrive - 0.18 * min(1.0, time / 0.4), arrive + 0.45 * min(length, 0.5), arrived)
            self.free = stand
        self.now += length

    def _homeward(self, rng):
        """A turn towards the middle of the room when far from it."""
        place = self.feet["Left"].place.last
        far = np.linalg.norm(place)
        if far < _ROOM:
            return 0.0
        away = np.arctan2(-place[0], -place[1]) - self.facing
        away = (away + np.pi) % (2 * np.pi) - np.pi
        return np.clip(away, -0.5, 0.5) * rng.uniform(0.3, 0.8)

    # -- arms and trunk: times of their own ----------------------------------------------------------------

    def _arms(self, start, end):
        """A run of key poses, the two arms alike, mirrored one after the other, or each for itself."""
        rng, t = self.rng, start
        mode = rng.choice(["both", "both", "follow", "own", "one"])
        names = list(ARM_POSES)
        last = None
        while t < end - 0.2 * self.beat:
            length = self.beat * rng.choice([0.5, 1.0, 1.0, 1.5, 2.0])
            name = rng.choice([n for n in names if n != last])
            last = name
            lag = rng.uniform(0.0, 0.10)
            for k, side in enumerate(rng.permutation(SIDES)):
                pose = name if mode in ("both", "follow") else rng.choice(names)
                if mode == "one" and side == "Left":
                    pose = rng.choice(["low", "hip", "side low"])
                if mode == "follow":
                    lag = 0.5 * self.beat * k
                self._arm(side, pose, t + lag * (mode != "both" or k), length)
            t += length

    def _arm(self, side, pose, start, length):
        rng = self.rng
        time = np.clip(length * rng.uniform(0.65, 0.98), 0.30, 1.3)
        wrist = _pose(side, pose) + rng.normal(0, 0.05, 3)
        elbow = np.array(ARM_POSES[pose][1]) * _mirror(side) + rng.normal(0, 0.1, 3)
        hand, pole = self.arms[side]
        moved = float(np.linalg.norm(wrist - hand.last))
        time = max(time, 0.32 * moved / 0.6)  # no faster than an arm goes at ease
        hand.move(start, start + time, wrist)
        pole.move(start, start + time, elbow)
        self.palm[side].move(start, start + time, rng.uniform(-0.7, 1.0))

    def _trunk(self, start, end):
        """On every beat or so: hips, ribs, twist and gaze move to new places."""
        rng, t = self.rng, start
        level = self.level
        while t < end - 0.2 * self.beat:
            length = self.beat * rng.choice([0.5, 1.0, 1.0, 1.0, 2.0])
            go = np.clip(0.85 * length, 0.22, 0.9)
            self.twist.move(t, t + go, rng.normal(0, 11 * DEG) * level)
            self.side.move(t, t + go, rng.normal(0, 6 * DEG) * level)
            self.hips.move(t, t + go, rng.normal(0, 5 * DEG) * level)
            self.tilt.move(t, t + go, rng.normal(0, 7 * DEG) * level)
            if rng.random() < 0.4:
                self.bow.move(t, t + go, np.clip(rng.normal(2, 7) * level, -10, 22) * DEG)
            if rng.random() < 0.45:
                self.gaze.move(t, t + 0.8 * go, rng.normal(0, 20 * DEG))
            t += length


def _mirror(side):
    return np.array([_SIGN[side], 1.0, 1.0])


def _pose(side, name):
    return np.array(ARM_POSES[name][0]) * _mirror(side)


def dancing(seconds: float, *, fps: float = 30.0, seed: int = 0, tempo: float = 112.0) -> Motion:
    """A person dancing alone: phrases of eight beats, no two alike.

    seconds: length; fps: frames a second; tempo: beats a minute, 60 to 180; seed: the same seed gives the
    same motion. Raises MotionError for a length, rate or tempo that makes no sense, TutorialError for a seed that
    is none.
    """
    n = check_time(seconds, fps)
    if not (np.isfinite(tempo) and 60 <= tempo <= 180):
        raise MotionError(f"tempo {tempo}: expected 60 to 180 beats a minute")
    rng = np.random.default_rng([whole_seed(seed), 3])
    plan = _Plan(rng, n / fps, tempo)
    t = np.arange(n) / fps

    left, right = (plan.feet[side].foot(t) for side in SIDES)
    facing = smooth(plan.face(t), 0.06, fps)
    share = smooth(plan.weight.share(t), 0.07, fps)
    under = plan.weight.under(t, left, right, fps, lag=0.08)
    # the hips swing out over the standing leg; the body sinks with each beat and rises between
    sway = 0.030 * (2 * share - 1) * smooth(plan.energy(t), 0.2, fps)
    under = under + sway[:, None] * left_of(facing)
    under = under + np.stack([noise(rng, t, 0.006, 0.1, 0.8) for _ in range(2)], -1)
    beats = (t - plan.start) / plan.beat
    groove = smooth(plan.groove(t), 0.3, fps)
    nod = np.cos(2 * np.pi * beats) + 0.25 * np.cos(np.pi * beats + 1.0)
    stride = left.base[:, 1] + right.base[:, 1]
    wide = np.linalg.norm(left.base[:, ::2] - right.base[:, ::2], axis=1)
    settle = smooth(0.10 * np.maximum(wide - 0.25, 0.0), 0.08, fps)
    height = _HEIGHT - groove * (1 + nod) - smooth(plan.sink(t), 0.05, fps) - settle + 0.05 * smooth(stride, 0.1, fps)
    root = np.stack([under[:, 0], height, under[:, 1]], -1)

    twist = smooth(plan.twist(t), 0.05, fps) + noise(rng, t, 2 * DEG, 0.1, 0.7)
    side = smooth(plan.side(t), 0.05, fps) + noise(rng, t, 1.2 * DEG, 0.1, 0.7)
    bow = smooth(plan.bow(t), 0.06, fps) + noise(rng, t, 1.2 * DEG, 0.1, 0.6)
    oblique = 7 * DEG * (2 * share - 1) + 0.6 * smooth(plan.hips(t), 0.05, fps)
    yaw = smooth(plan.tilt(t), 0.05, fps)
    pelvis = rot_y(facing + yaw) @ rot_x(4 * DEG + 0.3 * bow) @ rot_z(oblique)
    bend = np.stack(
        [0.8 * bow + 8 * DEG * groove / 0.03 * 0.25 * (1 + nod), side - 0.75 * oblique, twist - 0.7 * yaw], -1
    )
    # spotting: in a turn the head comes round a little earlier than the body
    early = smooth(plan.face(t + 0.10), 0.07, fps)
    chest = facing + 0.3 * yaw + twist
    gaze = early + smooth(plan.gaze(t), 0.06, fps) + 0.3 * twist + noise(rng, t, 3 * DEG, 0.1, 0.5)
    gaze = chest + within(gaze - chest, 65 * DEG)
    head = rot_y(gaze) @ rot_x(2 * DEG + 0.35 * bow + noise(rng, t, 3 * DEG, 0.1, 0.5)) @ rot_z(0.5 * side)

    pose = Pose(root, pelvis, (left, right), bend, head)
    hands = {}
    for name in SIDES:
        hand, pole = plan.arms[name]
        wrist = _arced(hand, t, name) + np.stack([noise(rng, t, 0.02, 0.1, 0.9) for _ in range(3)], -1)
        hands[name] = smooth(wrist, 0.05, fps), smooth(pole(t), 0.06, fps)
        up = np.clip(hands[name][0][:, 1] + 0.25, 0.0, 1.2)
        pose.shoulders[name] = np.stack([3 * DEG + 20 * DEG * up**2, 14 * DEG * hands[name][0][:, 2]], -1)
    figure = Body(pose, fps)
    for name in SIDES:
        wrist, pole = (apply(figure["Chest"], v) for v in hands[name])
        palm = smooth(plan.palm[name](t), 0.08, fps)
        figure.reach(
            name, figure.position(f"{name}Arm") + ARM * wrist, pole, palm, _trailing(figure, name, hands[name][0], fps)
        )
    return figure.motion("dancing")


def _arced(hand: Track, t, side):
    """The wrist's way between key poses: round the body, not through it."""
    start, end, done = hand.moves(t)
    far = np.linalg.norm(end - start, axis=-1)
    out = np.array([0.8 * _SIGN[side], 0.0, 0.6])
    return start + (end - start) * done[:, None] + (0.22 * far * bump(done))[:, None] * out


def _trailing(figure, side, wrist, fps):
    """The hand hangs back behind the wrist's movement (T, 2): follow-through."""
    velocity = np.gradient(wrist, 1 / fps, axis=0) * ARM if len(wrist) > 1 else np.zeros_like(wrist)
    velocity = smooth(velocity, 0.06, fps)
    up = np.tanh(0.5 * velocity[:, 1])
    across = np.tanh(0.5 * velocity[:, 0]) * _SIGN[side]
    return np.stack([0.12 + 0.45 * up, 0.30 * across], -1)
