"""Which changes of a number of runs count, and which way they go."""

from __future__ import annotations

import pytest

from gpusimbench.evaluator.compare.finding import Settings
from gpusimbench.evaluator.compare.numbers import matters
from gpusimbench.evaluator.results.metrics import METRICS

MB = 10**6


@pytest.mark.parametrize(
    ("name", "one", "other", "counts"),
    [
        ("fps", 1.0, 1.06, True),
        ("fps", 1.0, 1.04, False),
        ("fps", 0.0, 1e-9, True),
        ("fps", 0.0, 0.0, False),
        ("host_memory_peak_increment", MB, 1.99 * MB, False),
        ("host_memory_peak_increment", MB, 2 * MB, True),
        ("host_memory_peak_increment", 1000 * MB, 1040 * MB, False),
        ("host_memory_peak_increment", 1000 * MB, 1060 * MB, True),
        ("w1_run_to_run", 0.001, 0.0109, False),
        ("w1_run_to_run", 0.001, 0.0111, True),
        ("w1_run_to_run", 1.0, 1.04, False),
    ],
)
def test_what_matters(name: str, one: float, other: float, counts: bool) -> None:
    """Count a change above the threshold, of bytes by 1 MB and of lengths by 0.01 cm at least, up and down alike."""
    assert matters(METRICS[name], one, other, Settings()) is counts
    assert matters(METRICS[name], other, one, Settings()) is counts


@pytest.mark.parametrize(("threshold", "least"), [(0.05, 1.05), (0.5, 1.5), (0.0, 1.0)])
def test_a_threshold_is_a_factor(threshold: float, least: float) -> None:
    """Count no change by the very threshold, and every larger one."""
    settings = Settings(threshold=threshold)
    assert not settings.matters(1000.0, 1000.0 * least)
    assert settings.matters(1000.0, 1000.0 * least * (1 + 1e-9))
    assert settings.matters(1000.0 * least * (1 + 1e-9), 1000.0)
