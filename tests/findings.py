"""What the tests of three papers' findings share."""

from __future__ import annotations

from collections.abc import Sequence

from tutorial_lib.reproduce.results import Finding


def assert_only_wrong(findings: Sequence[Finding], claims: Sequence[str]) -> None:
    """Findings that are not true here are these, in their order, and no others; ``claims`` are parts of their texts."""
    wrong = [str(finding) for finding in findings if not finding.ours]
    assert len(wrong) == len(claims) and all(a in b for a, b in zip(claims, wrong, strict=True)), wrong
