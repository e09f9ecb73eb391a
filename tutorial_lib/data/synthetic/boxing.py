"""Shadow boxing: an orthodox boxer moves, punches and ducks in random combinations.

A plan of actions is drawn first, with random kinds, sizes and pauses; each writes key frames for feet,
weight, trunk and hands; then all frames are solved at once. The choreography is this project's own;
it follows the textbook: lead foot first, hips before hands, hands back to the guard.
"""

from __future__ import annotations

import numpy as np

from ...chance import whole_seed
from ...motion.clip import Motion
from .body import FOREARM, UPPER_ARM, Body, Pose, apply, rot_x, rot_y, rot_z, within
from .gait import check_time
from .signals import Track, noise, smooth
from .steps import PlannedFoot, Weight, forward_of, left_of

DEG = np.pi / 180
ARM = UPPER_ARM + FOREARM
_SIGN = {"Left": 1.0, "Right": -1.0}
_LEAD, _REAR = "Left", "Right"
# feet in the stance: ball (to the left, forward) of the middle, and where the toes point, from the facing
_STAND = {_LEAD: ((0.09, 0.25), -18 * DEG), _REAR: ((-0.12, -0.22), -52 * DEG)}
_HIPS, _CHEST = -34 * DEG, 6 * DEG  # the hips are turned away from the opponent; the chest a little back
_HEIGHT = 0.855  # of the pelvis
_HEEL = 0.30  # the rear heel is up

# the wrist's guard from its shoulder, in the chest's frame: to the left, up, forward
_GUARD = {_LEAD: (-0.055, 0.035, 0.285), _REAR: (0.070, 0.045, 0.215)}
_ELBOW = {_LEAD: (0.35, -1.0, 0.05), _REAR: (-0.40, -1.0, 0.0)}

COMBINATIONS = (
    ("jab",), ("jab",), ("jab", "jab"), ("jab", "cross"), ("jab", "cross"), ("cross",), ("jab", "jab", "cross"),
    ("jab", "cross", "hook"), ("cross", "hook"), ("cross", "hook", "cross"), ("hook",), ("hook", "cross"),
    ("jab", "body", "hook"), ("uppercut", "hook"), ("jab", "uppercut"), ("body", "hook"), ("hook", "hook"),
    ("jab", "overhand"), ("jab", "hook"), ("uppercut", "cross"),
)  # fmt: skip


class _Hand:
    """A hand's plan: how much it is away from the guard (0 to 1), and where to, around its shoulder."""

    def __init__(self, side: str):
        self.side = side
        self.away = Track(0.0)
        self.to = Track((0.0, 0.9 * ARM, 0.0))  # direction from the facing (left positive), distance, height
        self.elbow = Track(_ELBOW[side])
        self.turn = Track(0.3)  # the palm's
        self.guard = Track(_GUARD[side])


class _Plan:
    """The boxer's key frames, written action by action from time ``now`` on."""

    def __init__(self, rng: np.random.Generator, until: float):
        self.rng = rng
        self.now = -1.5
        self.middle = np.zeros(2)
        self.facing = rng.uniform(-np.pi, np.pi)
        self.face = Track(self.facing)
        self.feet = {side: PlannedFoot(*self._stand(side), heel=_HEEL if side == _REAR else 0.03) for side in _STAND}
        self.weight = Weight(0.52)
        self.hips, self.chest = Track(0.0), Track(0.0)  # turns added to the stance's, left positive
        self.drop, self.lean, self.side = Track(0.0), Track(0.0), Track(0.0)
        self.shove = Track((0.0, 0.0))  # of the pelvis: to the left, forward
        self.hands = {side: _Hand(side) for side in _STAND}
        self.spring = Track(0.012)  # the bounce
        while self.now < until + 1.0:
            self._next()

    def _stand(self, side):
        (x, z), yaw = _STAND[side]
        return self.middle + x * left_of(self.facing) + z * forward_of(self.facing), self.facing + yaw

    def _next(self):
        rng = self.rng
        kind = rng.choice(
            ["combination", "move", "duck", "circle", "rest", "feint"], p=[0.46, 0.19, 0.14, 0.09, 0.05, 0.07]
        )
        getattr(self, f"_{kind}")()
        self.now += min(rng.exponential(0.16), 0.7)

    # -- actions -----------------------------------------------------------------------------------------

    def _combination(self):
        names = COMBINATIONS[self.rng.integers(len(COMBINATIONS))]
        if self.rng.random() < 0.35:
            self._advance(forward_of(self.facing) * self.rng.uniform(0.10, 0.26), quick=True)
        for name in names:
            {
                "jab": self._jab,
                "cross": self._cross,
                "hook": self._hook,
                "body": self._body_cross,
                "uppercut": self._uppercut,
                "overhand": self._overhand,
            }[name]()
        if self.rng.random() < 0.30:
            self._duck()
        elif self.rng.random() < 0.35:
            self._advance(-forward_of(self.facing) * self.rng.uniform(0.12, 0.28))
        self.now += 0.10

    def _rest(self):
        self.spring.move(self.now, self.now + 0.3, self.rng.uniform(0.008, 0.022))
        self._sway(self.now, 0.3, self.rng.uniform(0.40, 0.62))
        self.now += self.rng.uniform(0.25, 0.6)

    def _feint(self):
        """A twitch of shoulder and hand, and a dip."""
        side = _LEAD if self.rng.random() < 0.7 else _REAR
        t = self.now
        self._throw(side, t, 0.11, 0.05, 0.16, (0.0, 0.75 * ARM, 0.02), size=0.45)
        self._dip(t, 0.12, self.rng.uniform(0.02, 0.06), 0.2)
        self._turn(t, 0.12, -5 * DEG, -9 * DEG, 0.2)
        self.now = t + 0.25

    def _jab(self):
        t, rng = self.now, self.rng
        size = rng.uniform(0.85, 1.0)
        out = rng.uniform(0.14, 0.19)
        self._turn(t, out, -7 * DEG, -17 * DEG * size, 0.24)
        self._throw(
            _LEAD,
            t + 0.02,
            out,
            rng.uniform(0.0, 0.03),
            rng.uniform(0.18, 0.25),
            (rng.normal(0.02, 0.04), 0.98 * ARM * size, rng.normal(0.03, 0.035)),
        )
        self._dip(t, out, rng.uniform(0.0, 0.03), 0.22)
        self._sway(t, out, 0.60)
        self.now = t + out + rng.uniform(0.10, 0.22)

    def _cross(self):
        t, rng = self.now, self.rng
        size = rng.uniform(0.85, 1.0)
        out = rng.uniform(0.17, 0.22)
        self._turn(t, out, 40 * DEG * size, 24 * DEG * size, 0.30)
        self._pivot(_REAR, t, out + 0.02, 38 * DEG * size, out + 0.16)
        self._throw(
            _REAR,
            t + 0.045,
            out,
            rng.uniform(0.0, 0.03),
            rng.uniform(0.22, 0.30),
            (rng.normal(0.06, 0.04), 0.98 * ARM * size, rng.normal(0.03, 0.035)),
        )
        self._dip(t, out, rng.uniform(0.02, 0.045), 0.28)
        self._sway(t, out, 0.70)
        self.lean.move(t, t + out, 9 * DEG)
        self.lean.move(t + out + 0.04, t + out + 0.34, 0.0)
        self.now = t + out + rng.uniform(0.16, 0.26)

    def _body_cross(self):
        """A cross to the body: the knees bend, the shoulder goes down with the hand."""
        t, rng = self.now, self.rng
        out = rng.uniform(0.20, 0.25)
        self._dip(t, out, rng.uniform(0.13, 0.19), 0.32)
        self._turn(t, out, 36 * DEG, 22 * DEG, 0.32)
        self._pivot(_REAR, t, out, 34 * DEG, out + 0.16)
        self._throw(_REAR, t + 0.05, out, 0.02, 0.30, (0.03, 0.94 * ARM, -0.16 + rng.normal(0, 0.03)))
        self.lean.move(t, t + out, 22 * DEG)
        self.lean.move(t + out + 0.04, t + out + 0.36, 0.0)
        self._sway(t, out, 0.66)
        self.now = t + out + rng.uniform(0.20, 0.28)

    def _hook(self):
        """The lead hook: the trunk loads to the left, then turns right with the bent arm."""
        t, rng = self.now, self.rng
        load, out = rng.uniform(0.09, 0.13), rng.uniform(0.16, 0.21)
        self.hips.move(t, t + load, 14 * DEG)
        self.chest.move(t, t + load, 10 * DEG)
        self._sway(t, load, 0.64)
        self._turn(t + load, out, -20 * DEG, -26 * DEG, 0.30)
        self._pivot(_LEAD, t + load, out, -30 * DEG, load + out + 0.16)
        height = rng.normal(0.02, 0.03) - (0.2 if rng.random() < 0.25 else 0.0)
        self._throw(
            _LEAD,
            t + 0.4 * load,
            load + out,
            0.02,
            0.28,
            (-28 * DEG, 0.66 * ARM, height),
            come_from=(62 * DEG, 0.60 * ARM, height - 0.05),
            elbow=(1.0, 0.10, -0.45),
            turn=0.6,
        )
        self._sway(t + load, out, 0.36)
        self._dip(t, load + out, 0.03 + max(0.0, -height) * 0.6, 0.28)
        self.now = t + load + out + rng.uniform(0.18, 0.26)

    def _overhand(self):
        t, rng = self.now, self.rng
        out = rng.uniform(0.22, 0.27)
        self._turn(t, out, 40 * DEG, 28 * DEG, 0.34)
        self._pivot(_REAR, t, out, 38 * DEG, out + 0.2)
        self._throw(
            _REAR,
            t + 0.03,
            out,
            0.02,
            0.30,
            (22 * DEG, 0.84 * ARM, 0.04),
            come_from=(-55 * DEG, 0.62 * ARM, 0.16),
            elbow=(-1.0, 0.35, -0.3),
            turn=0.9,
        )
        self.lean.move(t, t + out, 14 * DEG)
        self.side.move(t, t + out, 10 * DEG)
        self.lean.move(t + out + 0.03, t + out + 0.36, 0.0)
        self.side.move(t + out + 0.03, t + out + 0.36, 0.0)
        self._sway(t, out, 0.70)
        self.now = t + out + 0.26

    def _uppercut(self):
        t, rng = self.now, self.rng
        load, out = rng.uniform(0.12, 0.16), rng.uniform(0.15, 0.20)
        self.drop.move(t, t + load, rng.uniform(0.07, 0.11))
        self.drop.move(t + load, t + load + out, -0.015)
        self.drop.move(t + load + out + 0.02, t + load + out + 0.3, 0.0)
        self.side.move(t, t + load, -8 * DEG)
        self.side.move(t + load, t + load + out, 0.0)
        self._turn(t + 0.5 * load, out + 0.5 * load, 34 * DEG, 22 * DEG, 0.30)
        self._pivot(_REAR, t + load, out, 32 * DEG, load + out + 0.15)
        self._throw(
            _REAR,
            t + 0.2 * load,
            0.8 * load + out,
            0.02,
            0.27,
            (12 * DEG, 0.62 * ARM, 0.10),
            come_from=(-8 * DEG, 0.52 * ARM, -0.27),
            elbow=(-0.45, -1.0, -0.35),
            turn=-0.9,
        )
        self._sway(t + load, out, 0.66)
        self.now = t + load + out + rng.uniform(0.20, 0.26)

    def _duck(self):
        """Down under a hook, aside from a straight punch, or rolling from one side to the other."""
        t, rng = self.now, self.rng
        kind = rng.choice(["duck", "slip", "roll"])
        side = rng.choice([-1.0, 1.0])
        if kind == "slip":
            go, back = rng.uniform(0.16, 0.22), rng.uniform(0.2, 0.28)
            self.side.move(t, t + go, -side * rng.uniform(14, 21) * DEG)
            self.side.move(t + go + 0.04, t + go + 0.04 + back, 0.0)
            self.shove.move(t, t + go, (side * 0.055, 0.01))
            self.shove.move(t + go + 0.04, t + go + 0.04 + back, (0.0, 0.0))
            self._turn(t, go, -side * 8 * DEG, side * 14 * DEG, back)
            self._dip(t, go, rng.uniform(0.05, 0.09), back)
            self.lean.move(t, t + go, 11 * DEG)
            self.lean.move(t + go + 0.04, t + go + 0.04 + back, 0.0)
            self.now = t + go + back
            return
        deep = rng.uniform(0.17, 0.27)
        down, hold, up = rng.uniform(0.22, 0.28), rng.uniform(0.02, 0.1), rng.uniform(0.26, 0.34)
        self.drop.move(t, t + down, deep)
        self.drop.move(t + down + hold, t + down + hold + up, 0.0)
        self.lean.move(t, t + down, (14 + 55 * deep) * DEG)
        self.lean.move(t + down + hold, t + down + hold + up, 0.0)
        if kind == "roll":
            self._sway(t, down, 0.5 + 0.16 * side)
            self.side.move(t, t + down, -side * 12 * DEG)
            self.side.move(t + down, t + down + hold + up, side * 8 * DEG)
            self.side.move(t + down + hold + up, t + down + hold + up + 0.25, 0.0)
            self.shove.move(t, t + down, (0.05 * side, 0.0))
            self.shove.move(t + down, t + down + hold + up, (-0.05 * side, 0.0))
            self.shove.move(t + down + hold + up, t + down + hold + up + 0.25, (0.0, 0.0))
            self._sway(t + down, hold + up, 0.5 - 0.14 * side)
        self.now = t + down + hold + up

    def _move(self):
        """One to three steps about the ring, drawn back to its middle when far out."""
        rng = self.rng
        for _ in range(rng.integers(1, 4)):
            angle = self.facing + rng.choice([0.0, np.pi, np.pi / 2, -np.pi / 2]) + rng.normal(0, 0.3)
            way = forward_of(angle) - 0.7 * self.middle / 1.2
            way = way / max(np.linalg.norm(way), 0.3)
            self._advance(way * rng.uniform(0.12, 0.32))
            self.now += rng.uniform(0.0, 0.15)

    def _circle(self):
        """Turn about the lead foot: it pivots and the rear foot steps round."""
        rng, t = self.rng, self.now
        turn = rng.choice([-1, 1]) * rng.uniform(18, 42) * DEG
        self.facing += turn
        lead = self.feet[_LEAD]
        start = max(t, self.feet[_REAR].free_from(), lead.free_from()) + 0.02
        (x, z), _ = _STAND[_LEAD]
        self.middle = lead.place.last - x * left_of(self.facing) - z * forward_of(self.facing)
        self._sway(start - 0.05, 0.12, 0.68)
        lead.pivot(start, start + 0.30, self._stand(_LEAD)[1])
        self.feet[_REAR].step(start + 0.06, start + 0.32, *self._stand(_REAR), lift=0.035, roll=0.05)
        self.face.move(start, start + 0.36, self.facing)
        self._sway(start + 0.26, 0.2, 0.52)
        self.now = start + 0.40

    # -- parts of actions ------------------------------------------------------------------------------

    def _advance(self, by, quick=False):
        """A shuffle step: the foot that is nearer to where we go moves first, the other follows."""
        rng = self.rng
        along = by @ forward_of(self.facing), by @ left_of(self.facing)
        lead_first = along[0] > 0 if abs(along[0]) > abs(along[1]) else along[1] > 0
        first, second = (_LEAD, _REAR) if lead_first else (_REAR, _LEAD)
        self.middle = self.middle + by
        if rng.random() < 0.5:
            self.facing += rng.normal(0, 0.10)
        start = max(self.now, *(foot.free_from() for foot in self.feet.values())) + 0.02
        time = rng.uniform(0.17, 0.22)
        lift = 0.02 + 0.08 * float(np.linalg.norm(by))
        self._sway(start - 0.06, 0.12, 0.34 if first == _LEAD else 0.68)
        self.feet[first].step(start, start + time, *self._jittered(first), lift=lift, roll=0.10)
        self._sway(start + 0.7 * time, 0.16, 0.66 if first == _LEAD else 0.36)
        later = start + time + rng.uniform(-0.02, 0.05)
        self.feet[second].step(later, later + time, *self._jittered(second), lift=lift, roll=0.10)
        self._sway(later + 0.6 * time, 0.22, rng.uniform(0.46, 0.56))
        self.face.move(start, later + time, self.facing)
        self.now = start + time if quick else later + 0.6 * time

    def _jittered(self, side):
        place, yaw = self._stand(side)
        return place + self.rng.normal(0, 0.012, 2), yaw + self.rng.normal(0, 2.5 * DEG)

    def _sway(self, start, time, share):
        self.weight.shift(start, start + time, share)

    def _turn(self, start, time, hips, chest, back):
        """Hips first, the chest a moment later; both come back."""
        for track, angle, lag in ((self.hips, hips, 0.0), (self.chest, chest, 0.03)):
            track.move(start + lag, start + lag + time, angle)
            track.move(start + lag + time + 0.02, start + lag + time + 0.02 + back, 0.0)

    def _dip(self, start, time, depth, back):
        self.drop.move(start, start + time, depth)
        self.drop.move(start + time + 0.02, start + time + 0.02 + back, 0.0)

    def _pivot(self, side, start, time, angle, back_after):
        foot = self.feet[side]
        if foot.free_from() > start:
            return
        yaw = float(foot.yaw.last)
        foot.pivot(start, start + time, yaw + angle, heel=0.12)
        foot.pivot(start + back_after, start + back_after + 0.26, yaw, heel=0.06)

    def _throw(self, side, start, time, hold, back, to, *, come_from=None, size=1.0, elbow=None, turn=1.25):
        """Out of the guard to ``to`` (direction from the facing, distance, height) and back."""
        hand = self.hands[side]
        sign = _SIGN[side]
        if come_from is not None:
            hand.to.move(start - 0.05, start, np.array(come_from))
        hand.to.move(start, start + time, np.array(to))
        hand.away.move(start, start + (0.62 if come_from is not None else 1.0) * time, size)
        hand.away.move(start + time + hold, start + time + hold + back, 0.0)
        hand.elbow.move(start, start + 0.7 * time, elbow or (0.75 * sign, -0.8, -0.15))
        hand.elbow.move(start + time + hold, start + time + hold + back, _ELBOW[side])
        hand.turn.move(start + 0.3 * time, start + time, turn)
        hand.turn.move(start + time + hold, start + time + hold + back, 0.3)
        guard = np.array(_GUARD[side]) + self.rng.normal(0, 0.018, 3)
        hand.guard.move(start + time, start + time + back, guard)
        # the other hand comes closer to the chin
        other = self.hands["Right" if side == "Left" else "Left"]
        near = np.array(_GUARD[other.side]) + np.array([0.0, 0.02, -0.03]) + self.rng.normal(0, 0.012, 3)
        other.guard.move(start, start + time, near)
        other.guard.move(start + time + 0.1, start + time + 0.5, _GUARD[other.side])


def boxing(seconds: float, *, fps: float = 30.0, seed: int = 0) -> Motion:
    """Shadow boxing: stance, footwork, jabs, crosses, hooks, uppercuts and ducks in random combinations.

    seconds: length; fps: frames a second; seed: the same seed gives the same motion.
    Raises MotionError for a length or rate that makes no sense, TutorialError for a seed that is none.
    """
    n = check_time(seconds, fps)
    rng = np.random.default_rng([whole_seed(seed), 2])
    plan = _Plan(rng, n / fps)
    t = np.arange(n) / fps

    left, right = (plan.feet[side].foot(t) for side in ("Left", "Right"))
    facing = smooth(plan.face(t), 0.05, fps)
    # a springy stance: up and down about twice a second, never quite the same
    beat = np.cumsum(2.0 + noise(rng, t, 0.18, 0.05, 0.5)) / fps * 2 * np.pi
    size = smooth(plan.spring(t), 0.1, fps)
    spring = size * (np.cos(beat) + 0.2 * np.cos(2 * beat + 0.6))
    drop = smooth(plan.drop(t), 0.03, fps)
    under = plan.weight.under(t, left, right, fps, lag=0.06)
    shove = smooth(plan.shove(t), 0.03, fps)
    under = under + shove[:, :1] * left_of(facing) + shove[:, 1:] * forward_of(facing)
    under = under + np.stack([noise(rng, t, 0.006, 0.1, 0.9) for _ in range(2)], -1)
    under = under + 0.25 * size[:, None] * np.cos(0.5 * beat + 0.4)[:, None] * forward_of(facing)
    root = np.stack([under[:, 0], _HEIGHT + spring - drop + noise(rng, t, 0.006, 0.1, 0.6), under[:, 1]], -1)

    hips = smooth(plan.hips(t), 0.025, fps) + noise(rng, t, 2.0 * DEG, 0.1, 0.8)
    chest = smooth(plan.chest(t), 0.025, fps) + noise(rng, t, 1.5 * DEG, 0.1, 0.8)
    share = smooth(plan.weight.share(t), 0.05, fps) - 0.5
    lean = smooth(plan.lean(t), 0.03, fps) + noise(rng, t, 1.2 * DEG, 0.1, 0.6)
    side = smooth(plan.side(t), 0.03, fps) + noise(rng, t, 1.2 * DEG, 0.1, 0.6)
    pelvis = rot_y(facing + _HIPS + hips) @ rot_x(6 * DEG + 0.35 * lean) @ rot_z(6 * DEG * share + 0.15 * side)
    bend = np.stack([11 * DEG + 0.65 * lean + 0.35 * drop, 0.85 * side, _CHEST + chest], -1)
    # eyes on the opponent, chin down; the head goes a little with the trunk
    trunk = _HIPS + _CHEST + hips + chest
    look = facing + trunk - within(0.88 * trunk + noise(rng, t, 3 * DEG, 0.1, 0.7), 75 * DEG)
    nod = 9 * DEG + 0.25 * lean + noise(rng, t, 2 * DEG, 0.1, 0.7)
    head = rot_y(look) @ rot_x(nod) @ rot_z(0.45 * side + noise(rng, t, 1.5 * DEG, 0.1, 0.6))

    pose = Pose(root, pelvis, (left, right), bend, head)
    away = {name: smooth(hand.away(t), 0.012, fps) for name, hand in plan.hands.items()}
    for name in away:
        pose.shoulders[name] = np.stack([(8 + 7 * away[name]) * DEG, (8 + 16 * away[name]) * DEG], -1)
    figure = Body(pose, fps)
    for name, hand in plan.hands.items():
        _reach(rng, figure, hand, away[name], t, facing, fps)
    return figure.motion("boxing")


def _reach(rng, figure: Body, hand: _Hand, away, t, facing, fps):
    """One arm between its guard, which goes with the chest, and its punch, which goes where we face."""
    wander = np.stack([noise(rng, t, 0.010, 0.15, 1.2) for _ in range(3)], -1)
    guard = apply(figure["Chest"], smooth(hand.guard(t), 0.04, fps) + wander)
    direction, distance, height = smooth(hand.to(t), 0.02, fps).T
    flat = np.sqrt(np.maximum(distance**2 - height**2, 0.01))
    punch = np.stack([flat * np.sin(facing + direction), height, flat * np.cos(facing + direction)], -1)
    share = away[:, None]
    target = figure.position(f"{hand.side}Arm") + (1 - share) * guard + share * punch
    elbow = apply(figure["Chest"], smooth(hand.elbow(t), 0.03, fps))
    turn = smooth(hand.turn(t), 0.02, fps)
    wrist = np.stack([0.10 * (1 - away) + noise(rng, t, 0.04, 0.2, 1.0), 0.05 + 0 * t], -1)
    figure.reach(hand.side, target, elbow, turn, wrist)
