"""What every simulator adapter must do, as checks that anyone can run against theirs.

    python -m gpusimbench.recorder.conformance --sim NAME

or from pytest, with one build shared by all checks:

    @pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
    def test_conformance(subject, check):
        check(subject)

with `subject` a session fixture that returns Subject.named(NAME), or Subject(Adapter) for one that is not registered.
A check that the adapter gives no occasion for is skipped, with the reason.
"""

from __future__ import annotations

from gpusimbench.recorder.conformance.checks import CHECKS, Check
from gpusimbench.recorder.conformance.scene import conformance_scene
from gpusimbench.recorder.conformance.subject import Subject
from gpusimbench.recorder.conformance.verdict import NotApplicable

__all__ = ["CHECKS", "Check", "NotApplicable", "Subject", "conformance_scene"]
