"""A skeleton: named joints in a tree, each at a fixed offset from its parent; and forward kinematics."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch

from ..errors import MotionError
from .rotations import Array, check_order, mul_parts, numpy_or_torch, quat_inv, quat_mul, rotate_parts


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A tree of ``J`` nodes, parents before children; immutable, equal by value, hashable.

    names: unique names, ``J`` of them.
    parents: index of each node's parent; -1 for node 0, the root, and for it alone.
    offsets: ``(J, 3)`` metres, each node's place in its parent's frame when nothing is turned.
    orders: each node's Euler order, as its file had it (``"ZXY"`` where there was none).
    end_sites: the nodes that only mark where a bone ends (BVH ``End Site``); they never turn.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: np.ndarray
    orders: tuple[str, ...] = ()
    end_sites: frozenset[int] = frozenset()

    def __post_init__(self):
        names, parents = tuple(self.names), tuple(int(p) for p in self.parents)
        offsets = np.array(self.offsets, dtype=np.float64)
        offsets.setflags(write=False)
        orders = tuple(self.orders) or ("ZXY",) * len(names)
        put = functools.partial(object.__setattr__, self)
        put("names", names)
        put("parents", parents)
        put("offsets", offsets)
        put("orders", orders)
        put("end_sites", frozenset(int(e) for e in self.end_sites))
        self._check()

    def _check(self):
        n = len(self.names)
        if n == 0 or len(self.parents) != n or self.offsets.shape != (n, 3) or len(self.orders) != n:
            raise MotionError(
                f"skeleton: {n} names, {len(self.parents)} parents, {len(self.orders)} Euler orders and offsets of "
                f"shape {self.offsets.shape}: expected J, J, J and (J, 3) with J of at least 1"
            )
        if len(set(self.names)) != n:
            twice = next(x for x in self.names if self.names.count(x) > 1)
            raise MotionError(f"skeleton: joint name {twice!r} stands twice, expected unique names")
        if self.parents[0] != -1 or any(not 0 <= p < j for j, p in enumerate(self.parents) if j):
            raise MotionError("skeleton: expected parent -1 for node 0 and an earlier node for every other one")
        if not np.isfinite(self.offsets).all():
            bad = self.names[int(np.argmax(~np.isfinite(self.offsets).all(1)))]
            raise MotionError(f"skeleton: offset of {bad!r} is not finite")
        for order in self.orders:
            check_order(order)
        inner = self.end_sites & {p for p in self.parents if p >= 0}
        if inner or not self.end_sites <= set(range(1, n)):
            raise MotionError(f"skeleton: end sites {sorted(self.end_sites)}: expected leaves among {n} nodes")

    # -- structure ---------------------------------------------------------------------------------------

    @property
    def n_joints(self) -> int:
        """J, the number of nodes, end sites included."""
        return len(self.names)

    @functools.cached_property
    def joints(self) -> tuple[int, ...]:
        """The nodes that can turn: all but the end sites."""
        return tuple(j for j in range(self.n_joints) if j not in self.end_sites)

    @functools.cached_property
    def bones(self) -> np.ndarray:
        """``(J - 1, 2)`` integers: parent and child of each bone; read-only."""
        bones = np.array([(p, j) for j, p in enumerate(self.parents) if p >= 0], dtype=np.int64).reshape(-1, 2)
        bones.setflags(write=False)
        return bones

    @functools.cached_property
    def children(self) -> tuple[tuple[int, ...], ...]:
        """The children of each node."""
        children: list[list[int]] = [[] for _ in self.parents]
        for j, p in enumerate(self.parents):
            if p >= 0:
                children[p].append(j)
        return tuple(map(tuple, children))

    @functools.cached_property
    def bone_lengths(self) -> np.ndarray:
        """``(J - 1,)`` metres, in the order of ``bones``; read-only."""
        lengths = np.linalg.norm(self.offsets[1:], axis=-1)
        lengths.setflags(write=False)
        return lengths

    def index(self, name: str) -> int:
        """The node called ``name``; a ``MotionError`` names the nodes there are."""
        try:
            return self.names.index(name)
        except ValueError:
            raise MotionError(f"no joint {name!r} in the skeleton, which has {', '.join(self.names)}") from None

    @functools.cached_property
    def _levels(self) -> tuple[tuple[torch.Tensor, torch.Tensor], ...]:
        """For each depth of the tree: its nodes, and where their parents stand among the depth above."""
        levels, nodes, above = [], [0], {}
        while nodes:
            levels.append((torch.tensor(nodes), torch.tensor([above.get(self.parents[j], 0) for j in nodes])))
            above = {j: k for k, j in enumerate(nodes)}
            nodes = sorted(k for j in nodes for k in self.children[j])
        return tuple(levels)

    # -- kinematics --------------------------------------------------------------------------------------

    def fk(self, rotations: Array, root_positions: Array, translations: Array | None = None) -> Array:
        """Forward kinematics: where every node is in the world.

        rotations: ``(..., J, 4)`` local unit quaternions; root_positions: ``(..., 3)`` metres;
        translations: ``(..., J, 3)`` metres in place of the offsets where bones change (the root's is ignored).
        Returns ``(..., J, 3)`` metres. numpy or torch, differentiable, any leading axes: those of the rotations,
        to which the others broadcast. Raises ``MotionError`` where the last axes do not fit the skeleton.

        For a node j with parent p, world rotation ``W`` and position ``x``:
        ``W_j = W_p R_j`` and ``x_j = x_p + W_p t_j``, one depth of the tree at a time.
        """
        self._check_last_axes(rotations, (self.n_joints, 4), "rotations")
        self._check_last_axes(root_positions, (3,), "root positions")
        if translations is not None:
            self._check_last_axes(translations, (self.n_joints, 3), "translations")
        return self._fk(rotations, root_positions, translations)[0]

    @numpy_or_torch
    def _fk(self, rotations, root_positions, translations):
        if translations is None:
            translations = torch.as_tensor(self.offsets.copy(), dtype=rotations.dtype, device=rotations.device)
        # joints first, each component apart, so that a depth of the tree is a few products of whole arrays
        batch = rotations.shape[:-2]
        if translations.ndim > 2:
            translations = translations.expand(*batch, self.n_joints, 3)
        q = rotations.reshape(-1, self.n_joints, 4).permute(2, 1, 0)
        t = translations.reshape(-1, self.n_joints, 3).permute(2, 1, 0)
        x = root_positions.expand(*batch, 3).reshape(-1, 3).t()
        levels = [tuple(i.to(rotations.device) for i in level) for level in self._levels]
        worlds = [tuple(c.index_select(0, levels[0][0]) for c in q)]
        positions = [tuple(c[None] for c in x)]
        for nodes, parents in levels[1:]:
            world = tuple(c.index_select(0, parents) for c in worlds[-1])
            local = rotate_parts(world, tuple(c.index_select(0, nodes) for c in t))
            positions.append(tuple(c.index_select(0, parents) + d for c, d in zip(positions[-1], local, strict=True)))
            worlds.append(mul_parts(world, tuple(c.index_select(0, nodes) for c in q)))
        back = torch.argsort(torch.cat([nodes for nodes, _ in levels]))

        def assemble(parts):
            columns = [torch.cat(c).index_select(0, back) for c in zip(*parts, strict=True)]
            return torch.stack(columns).permute(2, 1, 0).reshape(*batch, self.n_joints, len(columns))

        return assemble(positions), assemble(worlds)

    def world_rotations(self, rotations: Array) -> Array:
        """Each node's rotation in the world, ``(..., J, 4)``, from local ones of the same shape."""
        self._check_last_axes(rotations, (self.n_joints, 4), "rotations")
        return self._fk(rotations, rotations[..., 0, :3] * 0, None)[1]

    def local_rotations(self, world: Array) -> Array:
        """The inverse of ``world_rotations``: ``R_j = W_p^-1 W_j``; shapes ``(..., J, 4)``."""
        self._check_last_axes(world, (self.n_joints, 4), "world rotations")
        parents = [max(p, 0) for p in self.parents]
        local = quat_mul(quat_inv(world[..., parents, :]), world)
        local[..., 0, :] = world[..., 0, :]
        return local

    def rest_pose(self) -> np.ndarray:
        """``(J, 3)`` metres: every node with nothing turned and the root at its own offset."""
        rest = self.offsets.copy()
        for j, p in enumerate(self.parents):
            if p >= 0:
                rest[j] += rest[p]
        return rest

    def _check_last_axes(self, array, shape: tuple[int, ...], what: str):
        if tuple(array.shape[-len(shape) :]) != shape:
            raise MotionError(
                f"{what} of shape {tuple(array.shape)} for a skeleton of {self.n_joints} nodes: "
                f"expected (..., {', '.join(map(str, shape))})"
            )

    # -- variants ----------------------------------------------------------------------------------------

    def scaled(self, factor: float) -> Skeleton:
        """The same skeleton with every bone ``factor`` times as long."""
        return Skeleton(self.names, self.parents, self.offsets * factor, self.orders, self.end_sites)

    def subset(self, keep: Iterable[int]) -> Skeleton:
        """Only the nodes ``keep`` (node 0 among them); each hangs from its nearest kept ancestor.

        Offsets add up along the bones that are left out, as in the rest pose.
        """
        keep = sorted(set(keep))
        if not keep or keep[0] != 0:
            raise MotionError(f"skeleton subset {keep[:5]}: expected nodes that include the root, 0")
        rest, place = self.rest_pose(), {j: k for k, j in enumerate(keep)}
        parents, offsets = [], []
        for j in keep:
            p = self.parents[j]
            while p >= 0 and p not in place:
                p = self.parents[p]
            parents.append(place.get(p, -1))
            offsets.append(rest[j] - rest[p] if p >= 0 else self.offsets[j])
        return Skeleton(
            tuple(self.names[j] for j in keep),
            tuple(parents),
            np.array(offsets),
            tuple(self.orders[j] for j in keep),
            frozenset(place[j] for j in keep if j in self.end_sites),
        )

    # -- value -------------------------------------------------------------------------------------------

    def __eq__(self, other) -> bool:
        return isinstance(other, Skeleton) and self._key == other._key and np.array_equal(self.offsets, other.offsets)

    def __hash__(self) -> int:
        return hash((self._key, self.offsets.tobytes()))

    def same_tree(self, other: Skeleton) -> bool:
        """Whether both have the same names, parents and end sites; bones may differ in length."""
        return (self.names, self.parents, self.end_sites) == (other.names, other.parents, other.end_sites)

    @property
    def _key(self):
        return self.names, self.parents, self.orders, self.end_sites

    def to_dict(self) -> dict:
        """JSON-able; ``Skeleton.from_dict`` is its inverse."""
        return {
            "names": list(self.names),
            "parents": list(self.parents),
            "offsets": [[float(x) for x in row] for row in self.offsets],
            "orders": list(self.orders),
            "end_sites": sorted(self.end_sites),
        }

    @classmethod
    def from_dict(cls, d: dict) -> Skeleton:
        """From what ``to_dict`` gave; a ``MotionError`` says what is missing."""
        try:
            return cls(
                tuple(d["names"]), tuple(d["parents"]), np.array(d["offsets"]), tuple(d["orders"]),
                frozenset(d["end_sites"]),
            )  # fmt: skip
        except MotionError:
            raise
        except (KeyError, TypeError, ValueError) as error:
            what = f"skeleton description: {error!r}, expected names, parents, offsets, orders, end_sites"
            raise MotionError(what) from None

    def __repr__(self) -> str:
        return f"Skeleton({self.n_joints} nodes, {len(self.end_sites)} of them end sites, root {self.names[0]!r})"
