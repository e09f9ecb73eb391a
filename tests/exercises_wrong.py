"""Known wrong answers to the problem sets, each a change of the solution, and the tests that must notice.

At the end right answers that are not the solution's, and must lose nothing.
"""

from __future__ import annotations

from exercises import Wrong

PS1 = [
    Wrong("the knee bends forwards", "knee", "60.0", "-60.0", ("test-knee",)),
    Wrong("radians instead of degrees", "knee", "60.0", "np.pi / 3", ("test-knee",)),
    Wrong("a transposed rotation", "bone", "W_p @ t_j", "W_p.T @ t_j", ("test-bone",)),
    Wrong("the parent's place is turned, too", "bone", "x_p + W_p @ t_j", "W_p @ (x_p + t_j)", ("test-bone",)),
    Wrong("turned by the joint's own rotation", "chain", "x[p] + W[p] @", "x[p] + W[j] @", ("test-chain",)),
    Wrong("parent and child in the wrong order", "chain", "W[p] @ R[j]", "R[j] @ W[p]", ("test-chain",)),
    Wrong("a step is the way back", "root", "r[1:] - r[:-1]", "r[:-1] - r[1:]", ("test-displacements",)),
    Wrong("the walk does not begin at its start", "root", "start + np.con", "np.con", ("test-places",)),
    Wrong(
        "who is farthest from its place is guilty",
        "order",
        "return min(errors, key=errors.get)",
        "return skeleton.names[np.abs(skeleton.fk(rotations, root) - measured).max((0, 2)).argmax()], 'YXZ'",
        ("test-order",),
    ),
    Wrong(
        "the visible culprit, whoever it is",
        "order",
        "return min(errors, key=errors.get)",
        "return 'LeftArm', 'YXZ'",
        ("test-order",),
    ),
    Wrong(
        "the root is above suspicion",
        "order",
        "if skeleton.children[j]:",
        "if j and skeleton.children[j]:",
        ("test-order",),
    ),
    Wrong("turned the other way", "turn", "x, y, z =", "angle = -angle; x, y, z =", ("test-turn",)),
    Wrong(
        "the coordinates of a joint mixed up",
        "turn",
        "(len(features), -1, 3), -1",
        "(len(features), 3, -1), 1",
        ("test-turn",),
    ),
]

PS2 = [
    Wrong("all layers counted as if they read the frame", "size", "136", "128", ("test-size",)),
    Wrong("one step too large", "size", "136", "144", ("test-size",)),
    Wrong(
        "the sum of squares, without the root",
        "change",
        "np.linalg.norm(x[:, 1:] - x[:, :-1], axis=-1)",
        "((x[:, 1:] - x[:, :-1]) ** 2).sum(-1)",
        ("test-change",),
    ),
    Wrong(
        "the mean over the steps instead of the sequences", "change", "mean(axis=0)", "mean(axis=1)", ("test-change",)
    ),
    Wrong("a single step instead of a window", "rule", "np.mean(change[t : t + window])", "change[t]", ("test-rule",)),
    Wrong("the last window forgotten", "rule", "- window + 1", "- window", ("test-rule",)),
    Wrong("compared with the frame that was read", "forcing", "x[:, t + 1]", "x[:, t]", ("test-forcing",)),
    Wrong(
        "fed its own output",
        "forcing",
        "model(x[:, t : t + 1], state)",
        "model(x[:, :1] if t == 0 else y, state)",
        ("test-forcing",),
    ),
    Wrong(
        "the memory is forgotten at every step",
        "generate",
        "frame, state = model(frame, state)",
        "frame, _ = model(frame)",
        ("test-generate",),
    ),
    Wrong("the last seed frame as the first new one", "generate", "y[:, -1:]", "seed[:, -1:]", ("test-generate",)),
    Wrong("the first frames of the seed", "idea", "-seed_frames:]", ":seed_frames]", ("test-idea",)),
    Wrong("four seeds, however many are asked for", "idea", "[:count,", "[:4,", ("test-idea",)),
    Wrong("a conclusion without a look", "idea", "bool(gain >= 0.5)", "True", ("test-verdict",)),
]

PS3 = [
    Wrong("u and v exchanged", "u", "= 4", "= 16", ("test-u",)),
    Wrong("half of the frames", "u", "= 4", "= 8", ("test-u",)),
    Wrong("its own output first", "masks", "% (u + v) < u", "% (u + v) >= v", ("test-masks",)),
    Wrong(
        "one coin for a whole sequence",
        "masks",
        "torch.rand(batch, T, generator=rng) < probability",
        "(torch.rand(batch, 1, generator=rng) < probability).repeat(1, T)",
        ("test-masks",),
    ),
    Wrong("coins that do not come from the generator", "masks", ", generator=rng", "", ("test-masks",)),
    Wrong(
        "the same coins whatever the generator",
        "masks",
        "generator=rng",
        "generator=torch.Generator().manual_seed(0)",
        ("test-masks",),
    ),
    Wrong("teacher forcing in disguise", "loop", "if mask[t] else y", "", ("test-loop", "test-gradient")),
    Wrong("the gradient is cut", "loop", "else y", "else y.detach()", ("test-gradient",)),
    Wrong("the mask upside down", "loop", "if mask[t]", "if t == 0 or not mask[t]", ("test-loop", "test-gradient")),
    Wrong("grows without an end", "growing", "min(step // every, longest)", "step // every", ("test-growing",)),
    Wrong("begins at one", "growing", "min(step // every,", "min(step // every + 1,", ("test-growing",)),
    Wrong("noise and own output at once", "plan", '("auto 5 5", 0)]', '("auto 5 5", 3)]', ("test-plan",)),
    Wrong("one seed", "plan", "range(3)", "range(1)", ("test-plan",)),
    Wrong(
        "measured on what it was trained on", "plan", '"measured_on": "test"', '"measured_on": "train"', ("test-plan",)
    ),
    Wrong(
        "not paired",
        "read",
        "d.std(ddof=1) / len(d) ** 0.5",
        "((np.var(a, ddof=1) + np.var(b, ddof=1)) / len(d)) ** 0.5",
        ("test-read", "test-worse"),
    ),
    Wrong("every larger mean counts", "read", "if mean > 2 * error", "if mean > 0", ("test-worse",)),
    Wrong("smaller errors are worse", "read", "if mean > 2 * error", "if mean < -2 * error", ("test-worse",)),
]

PS4 = [
    Wrong("the logarithm of the deviation", "doubt", "2 * math", "math", ("test-doubt",)),
    Wrong("the variance itself", "doubt", "2 * math.log(0.5)", "0.25", ("test-doubt",)),
    Wrong(
        "the sign of the logarithms",
        "divergence",
        "log_variance_p - log_variance_q",
        "log_variance_q - log_variance_p",
        ("test-divergence",),
    ),
    Wrong(
        "q and p exchanged",
        "divergence",
        "    spread =",
        "    log_variance_q, log_variance_p = log_variance_p, log_variance_q\n    spread =",
        ("test-divergence",),
    ),
    Wrong("without the half", "divergence", "0.5 *", "1.0 *", ("test-divergence",)),
    Wrong("the variance as the deviation", "draw", "(0.5 * log_variance)", "log_variance", ("test-draw",)),
    Wrong("no gradient", "draw", "+ mean", "+ mean.detach()", ("test-draw",)),
    Wrong(
        "the gates exchanged",
        "cell",
        'elu(f * (c @ w["W_c"].T) + i *',
        'elu(i * (c @ w["W_c"].T) + f *',
        ("test-cell",),
    ),
    Wrong("the ordinary cell's activation", "cell", "return elu(", "return torch.tanh(", ("test-cell",)),
    Wrong("a row times W instead of W times it", "cell", 'h @ w["W_h"].T', 'h @ w["W_h"]', ("test-cell",)),
    Wrong(
        "returns to the first code at every step", "cell", "step(state, h[:, t])", "step(z_1, h[:, t])", ("test-modes",)
    ),
    Wrong("turning to the right is positive", "control", "np.diff(heading)", "-np.diff(heading)", ("test-control",)),
    Wrong(
        "a full turn where the angle is written anew",
        "control",
        "(turn + np.pi) % (2 * np.pi) - np.pi",
        "turn",
        ("test-control",),
    ),
    Wrong("per frame", "control", "(place[1:] - place[:-1]) * fps", "place[1:] - place[:-1]", ("test-control",)),
    Wrong(
        "averaged before the divergence",
        "active",
        "each = 0.5 * (mean**2",
        "each = 0.5 * (0 * mean + mean.mean((0, 1)) ** 2",
        ("test-active",),
    ),
    Wrong("the one with the most active units", "active", "min(", "max(", ("test-collapsed",)),
]

PS5 = [
    Wrong("the frame itself has no future", "known", "T - H", "T - H + 1", ("test-known",)),
    Wrong("futures that do not overlap", "known", "T - H", "T // H", ("test-known",)),
    Wrong("without the frame itself", "futures", "z[t : t + H + 1]", "z[t + 1:t + H + 1]", ("test-futures",)),
    Wrong("one too few", "futures", "range(len(z) - H)", "range(len(z) - H - 1)", ("test-futures",)),
    Wrong(
        "futures without chance",
        "step",
        "f = p.mean + (0.5 * p.log_variance).exp() * noise_f",
        "f = p.mean",
        ("test-imagine",),
    ),
    Wrong(
        "the summary of the mean, whatever is drawn",
        "step",
        "summary_of(f, h)",
        "summary_of(p.mean, h)",
        ("test-imagine",),
    ),
    Wrong(
        "the prior in the posterior's place",
        "step",
        "q_f, q_s = network.posterior_future(h, m)",
        "q_f, q_s = network.prior_future(h)",
        ("test-explain",),
    ),
    Wrong("the variance times the temperature", "temperature", "2 * math.log", "math.log", ("test-temperature",)),
    Wrong(
        "the logarithm times the temperature",
        "temperature",
        "log_variance + (2 * math.log(temperature) if temperature > 0 else -math.inf)",
        "log_variance * temperature",
        ("test-temperature",),
    ),
    Wrong("pairs of one future with itself", "fan", "in range(i)]", "in range(len(x))]", ("test-fan",)),
    Wrong(
        "squared distances",
        "fan",
        "np.linalg.norm(x[i] - x[j], axis=-1)",
        "((x[i] - x[j]) ** 2).sum(-1)",
        ("test-fan",),
    ),
    Wrong(
        "coverage is fidelity",
        "quality",
        "true[:, None] - made[None]",
        "made[:, None] - true[None]",
        ("test-quality", "test-which"),
    ),
    Wrong(
        "the most faithful one dances",
        "quality",
        "min(quality, key=lambda name: sum(quality[name]))",
        "min(quality, key=lambda name: quality[name][0])",
        ("test-which",),
    ),
]

PS6 = [
    Wrong("the other way round", "rate", "0.16", "0.01", ("test-rate",)),
    Wrong("the same number a frame", "rate", "0.16", "0.04", ("test-rate",)),
    Wrong("longer and shorter cancel", "bones", "np.abs(found - lengths)", "(found - lengths)", ("test-bones",)),
    Wrong("in metres", "bones", "np.abs(found - lengths) / lengths", "np.abs(found - lengths)", ("test-bones",)),
    Wrong("the worst bone instead of the mean", "bones", ".mean(axis=-1)", ".max(axis=-1)", ("test-bones",)),
    Wrong("the height counts as slide", "feet", "[0, 2]]", "[0, 1, 2]]", ("test-feet",)),
    Wrong("low in one of the two frames", "feet", "low[1:] & low[:-1]", "low[:-1]", ("test-feet",)),
    Wrong("small is good everywhere", "beaten", "signs * np", "np", ("test-beaten",)),
    Wrong("equals beat each other", "beaten", " and (cost[a] < cost[b]).any())", " and a != b)", ("test-beaten",)),
    Wrong(
        "beaten only where worse in every column",
        "beaten",
        "(cost[a] <= cost[b]).all() and (cost[a] < cost[b]).any()",
        "(cost[a] < cost[b]).all()",
        ("test-beaten",),
    ),
    Wrong("the error falls with N", "beginnings", " ** 2))", "))", ("test-beginnings",)),
    Wrong("rounded to the nearest", "beginnings", "math.ceil", "round", ("test-beginnings",)),
    Wrong("rounded down", "beginnings", "math.ceil", "int", ("test-beginnings",)),
    Wrong(
        "sorted once",
        "order",
        "np.argsort(np.argsort(a)) - np.argsort(np.argsort(b))",
        "np.argsort(a) - np.argsort(b)",
        ("test-order", "test-agreement"),
    ),
    Wrong("the worst agreement", "order", "= max(", "= min(", ("test-agreement",)),
]

WRONG: dict[str, list[Wrong]] = {"ps1": PS1, "ps2": PS2, "ps3": PS3, "ps4": PS4, "ps5": PS5, "ps6": PS6}

# Right answers of another make: they lose nothing. One a cell, as they are handed in together.
RIGHT: dict[str, list[Wrong]] = {
    "ps2": [Wrong("numpy's truth", "idea", "bool(gain >= 0.5)", "gain >= 0.5", ())],
    "ps3": [
        Wrong(
            "a fourth network beside the three, and larger",
            "plan",
            "range(3))\n]",
            "range(3))\n] + [example_run | dict(noise_cm=3, hidden=128, seed=k, measured_on='test') for k in range(3)]",
            (),
        )
    ],
    "ps5": [
        Wrong(
            "as good as no spread at temperature 0",
            "temperature",
            "(2 * math.log(temperature) if temperature > 0 else -math.inf)",
            "2 * math.log(max(temperature, 1e-8))",
            (),
        )
    ],
    "ps6": [
        Wrong(
            "a tuple of names",
            "beaten",
            "[name for name in table if not any(beats(other, name) for other in table)]",
            "tuple(name for name in table if not any(beats(other, name) for other in table))",
            (),
        )
    ],
}

# One submission that does what must not stop the grading of the rest: answer cells, and the tests they cost.
BAD: dict[str, tuple[str, str]] = {
    "bone": (
        "loops forever, and cannot be interrupted",
        """
def child_position(x_p, W_p, t_j):
    while True:
        try:
            while True:
                pass
        except BaseException:
            pass
""",
    ),
    "chain": ("raises", "raise RuntimeError('no idea')"),
    "root": (
        "prints megabytes and a warning, and is right",
        """
def displacements(r):
    for _ in range(30):
        print("x" * 1_000_000)
    __import__("warnings").warn("this is only a warning")
    return r[1:] - r[:-1]


def places(start, d):
    return np.concatenate([start[None], start + np.cumsum(d, axis=0)])
""",
    ),
    "order": (
        "deletes the names that the test needs",
        "find_wrong_order = print\ndel suspicious_clip, np, data, quat_to_euler",
    ),
    "turn": ("ends the kernel", "import os\nos._exit(1)"),
}
COSTS = {"test-bone", "test-chain", "test-order", "test-turn"}
COPIED = {"given-knee", "bone", "test-bone"}  # read-only, an answer, a test
