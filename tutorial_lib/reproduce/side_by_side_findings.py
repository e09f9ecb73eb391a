"""What the papers say of their systems and of each other's, held against one result in which all are measured alike."""

from __future__ import annotations

from .results import Finding, Result, large, number, numbers
from .side_by_side_plan import DFN, SYSTEMS, VAE
from .side_by_side_tables import error, failed, off_path, runs_of, value


def findings(result: Result) -> list[Finding]:
    """Each with its numbers; None where runs that it needs are missing."""
    return [*_acrnn(result), *_vae_lstm(result), *_future(result), *_representation(result), *_nobody(result)]


def _missing(result: Result, claim: str, *labels: str) -> Finding | None:
    return None if all(runs_of(result, label) for label in labels) else Finding(claim, None, "not measured")


def _acrnn(result: Result) -> list[Finding]:
    late = [ms for ms in result["protocol"]["times_ms"] if ms >= 400]
    claim = "acRNN, table 1, its dances and fights: from 400 ms on acLSTM errs less than LSTM-3LR"  # not its walks
    found = [_missing(result, claim, "aclstm", "lstm")]
    if found[0] is None:
        mine, other = ([error(result, label, ms) for ms in late] for label in ("aclstm", "lstm"))
        said = ", ".join(f"{a:.1f} and {b:.1f}" for a, b in zip(mine, other, strict=True))
        found = [Finding(claim, bool((large(mine) < large(other)).all()), f"{said} cm")]
    claim = "acRNN, figure 7: no system of these fails more seldom than acLSTM, and some fail more often"
    others = ("erd", "seq2seq", "scheduled-sampling")
    missing = _missing(result, claim, "aclstm", *others)
    if missing is None:
        shares = {label: failed(result, label) for label in ("aclstm", *others)}
        holds = all(shares["aclstm"] <= shares[label] for label in others) and shares["aclstm"] < max(shares.values())
        missing = Finding(claim, holds, _listed({label: f"{100 * x:.0f} %" for label, x in shares.items()}))
    return [*found, missing]


def _vae_lstm(result: Result) -> list[Finding]:
    predictors = [label for label in SYSTEMS if label != VAE and runs_of(result, label)]
    claims = (
        "VAE-LSTM, after its table 1: the systems that are shown the seed err less than it at first, after 80 ms",
        "VAE-LSTM, after its table 1: told where to go, it errs least in the end, after 640 ms",
        "VAE-LSTM: it goes where it is told (within 0.1 m of the path on average), in steps of half a metre and more",
    )
    if not runs_of(result, VAE) or not predictors:
        return [Finding(claim, None, "not measured") for claim in claims]
    found = []
    for claim, ms, choose in ((claims[0], 80, max), (claims[1], 640, min)):
        errors = {label: error(result, label, ms) for label in (*predictors, VAE)}
        first = choose(errors, key=lambda label: large(errors[label]))
        found.append(Finding(claim, first == VAE, _listed(_cm(errors))))
    walks = [path for run in runs_of(result, VAE) for path in run["paths"].values()]
    off, steps = number(off_path(result, VAE)), numbers([path["before"]["step_length"] for path in walks])
    said = f"{100 * off:.1f} cm off on average, steps of {', '.join(f'{100 * step:.0f}' for step in steps)} cm"
    found.append(Finding(claims[2], bool(off < 0.1 and (steps > 0.5).all()), said))
    return found


def _future(result: Result) -> list[Finding]:
    claims = (
        "Dynamic Future Net: one beginning, many futures (poses 1 cm apart and more after 2 s)",
        "Dynamic Future Net: none of its motions of half a minute fails",
        "Dynamic Future Net: its bones keep their length, to a hundredth of a per cent",
    )
    if not runs_of(result, DFN):
        return [Finding(claim, None, "not measured") for claim in claims]
    apart, fails = float(value(result, DFN, "futures", "pose")[-1]), failed(result, DFN)
    bones = float(value(result, DFN, "flaws", "bones"))
    return [
        Finding(claims[0], apart >= 1, f"{apart:.1f} cm"),
        Finding(claims[1], fails == 0, f"{100 * fails:.0f} % fail"),
        Finding(claims[2], bones < 0.01, f"{bones:.4f} %"),
    ]


def _representation(result: Result) -> list[Finding]:
    claim = "Neither paper: after 640 ms LSTM-3LR and acLSTM err half as much in the hip frame, or less"
    pairs = [(label, f"{label}-hip") for label in ("lstm", "aclstm")]
    missing = _missing(result, claim, *(label for pair in pairs for label in pair))
    if missing is not None:
        return [missing]
    errors = {label: error(result, label, 640) for pair in pairs for label in pair}
    holds = all(large(errors[hip]) < 0.5 * large(errors[own]) for own, hip in pairs)
    return [Finding(claim, holds, _listed(_cm(errors)))]


def _nobody(result: Result) -> list[Finding]:
    """What one table can tell and none of the papers could: whether one system has everything."""
    claim = "No system is among the three with the least error after 80 ms, fails never and draws its future"
    labels = [label for label in SYSTEMS if runs_of(result, label)]
    if len(labels) < len(SYSTEMS):
        return [Finding(claim, None, "not measured")]
    first = sorted(labels, key=lambda label: large(error(result, label, 80)))[:3]
    whole = [label for label in first if failed(result, label) == 0 and SYSTEMS[label].chance]
    return [Finding(claim, not whole, "least error: " + _listed({label: f"{error(result, label, 80):.1f} cm, "
            f"{100 * failed(result, label):.0f} % fail" for label in first}))]  # fmt: skip


def _cm(errors: dict[str, float]) -> dict[str, str]:
    return {label: f"{e:.1f} cm" for label, e in errors.items()}


def _listed(values: dict[str, str]) -> str:
    return ", ".join(f"{SYSTEMS[label].title} {text}" for label, text in values.items())
