"""Environment variables that an engine needs before it is imported."""

from __future__ import annotations

import os
from collections.abc import Mapping

from gpusimbench.schemas.errors import UsageError

_FLAGS = "XLA_FLAGS"  # a list of flags, to which more can be added


def apply_environment(wanted: Mapping[str, str]) -> None:
    """Set variables of this process: what the user has set stays, flags are added to the user's.

    UsageError where a flag is set already to something else.
    """
    for name, value in wanted.items():
        given = os.environ.get(name)
        if given is None:
            os.environ[name] = value
        elif name == _FLAGS:
            known = {flag.partition("=")[0]: flag for flag in given.split()}
            for flag in value.split():
                if known.get(flag.partition("=")[0], flag) != flag:
                    raise UsageError(f"{_FLAGS} has {known[flag.partition('=')[0]]}, and this run needs {flag}")
            more = [flag for flag in value.split() if flag.partition("=")[0] not in known]
            os.environ[name] = " ".join([given, *more])
