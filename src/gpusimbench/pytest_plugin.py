"""The pytest plugin: the fixture gsb, and --gsb-keep DIR. Nothing but pytest is imported until a test asks for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add --gsb-keep."""
    parser.getgroup("gpusimbench").addoption(
        "--gsb-keep",
        metavar="DIR",
        help="keep both sides of a failed assertion of the fixture gsb as recordings (MCAP) in this folder",
    )


@pytest.fixture
def gsb(request: pytest.FixtureRequest) -> Assertions:
    """Assertions of gpusimbench.testing; with --gsb-keep, both sides of a failure are kept as recordings."""
    given = request.config.getoption("--gsb-keep")
    folder = Path(request.config.invocation_params.dir, given) if given else None
    return Assertions(folder, request.node.nodeid)


class Assertions:
    """The assertions of gpusimbench.testing, for one test.

    keep  folder for recordings of failures; None: nothing is kept
    test  node id of the test
    """

    def __init__(self, keep: Path | None, test: str) -> None:
        self._folder = keep
        self._test = test

    def assert_identical(self, a: Any, b: Any) -> None:
        """See gpusimbench.testing.assert_identical."""
        __tracebackhide__ = True
        self._keeping("assert_identical", a, b)

    def assert_deterministic(
        self, make_env: Callable[[], Any], steps: int, actions: Sequence[Any] | None = None, **others: int
    ) -> None:
        """See gpusimbench.testing.assert_deterministic."""
        __tracebackhide__ = True
        self._keeping("assert_deterministic", make_env, steps, actions, **others)

    def assert_batch_invariant(self, make_env: Callable[[int], Any], **others: Any) -> None:
        """See gpusimbench.testing.assert_batch_invariant."""
        __tracebackhide__ = True
        self._keeping("assert_batch_invariant", make_env, **others)

    def _keeping(self, name: str, *arguments: Any, **others: Any) -> None:
        __tracebackhide__ = True
        from gpusimbench import testing
        from gpusimbench.testing.assertions import Differs

        try:
            getattr(testing, name)(*arguments, **others)
        except Differs as failure:
            if self._folder is None:
                raise
            from gpusimbench.testing.keeping import keep

            raise AssertionError(f"{failure}\n  {keep(failure, self._folder, self._test)}") from None
