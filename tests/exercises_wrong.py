"""Known wrong answers to the problem sets, each a change of the solution, and the tests that must notice."""

from __future__ import annotations

from exercises import Wrong

WRONG: dict[str, list[Wrong]] = {
    "ps1": [
        Wrong("the knee bends forwards", "knee", "60.0", "-60.0", ("test-knee",)),
        Wrong("radians instead of degrees", "knee", "60.0", "np.pi / 3", ("test-knee",)),
        Wrong("a transposed rotation", "bone", "W_p @ t_j", "W_p.T @ t_j", ("test-bone",)),
        Wrong("the parent's place is turned, too", "bone", "x_p + W_p @ t_j", "W_p @ (x_p + t_j)", ("test-bone",)),
        Wrong("turned by the joint's own rotation", "chain", "x[p] + W[p] @", "x[p] + W[j] @", ("test-chain",)),
        Wrong("parent and child in the wrong order", "chain", "W[p] @ R[j]", "R[j] @ W[p]", ("test-chain",)),
        Wrong("a step is the way back", "root", "r[1:] - r[:-1]", "r[:-1] - r[1:]", ("test-displacements",)),
        Wrong("the walk begins one step later", "root", "start + np.concatenate([np.zeros((1, 3)), np.cumsum(d, axis=0)])",
              "start + np.cumsum(d, axis=0)", ("test-places",)),
        Wrong("who is farthest from its place is guilty", "order", "return min(errors, key=errors.get)",
              "worst = np.abs(skeleton.fk(rotations, root) - measured).max((0, 2)).argmax()\n"
              "    return skeleton.names[worst], 'YXZ'", ("test-order",)),
        Wrong("the visible culprit, whoever it is", "order", "return min(errors, key=errors.get)",
              "return 'LeftArm', 'YXZ'", ("test-order",)),
        Wrong("turned the other way", "turn", "turned = np.stack(", "angle = -angle; turned = np.stack(", ("test-turn",)),
    ],
}  # fmt: skip

# One submission that does what must not stop the grading of the rest: answer cells, and the tests they cost.
BAD: dict[str, tuple[str, str]] = {
    "bone": (
        "loops forever, and cannot be interrupted",
        "def child_position(x_p, W_p, t_j):\n    while True:\n        try:\n            while True:\n                pass\n"
        "        except BaseException:\n            pass",
    ),
    "chain": ("raises", "raise RuntimeError('no idea')"),
    "root": (
        "prints megabytes, and is right",
        "def displacements(r):\n    for _ in range(30):\n        print('x' * 1_000_000)\n    return r[1:] - r[:-1]\n\n\n"
        "def places(start, d):\n    return np.concatenate([start[None], start + np.cumsum(d, axis=0)])",
    ),
    "order": (
        "deletes the names that the test needs",
        "find_wrong_order = print\ndel suspicious_clip, np, data, quat_to_euler",
    ),
    "turn": ("ends the kernel", "import os\nos._exit(1)"),
}
COSTS = {"test-bone", "test-chain", "test-order", "test-turn"}
