"""Vector environments, made again: of Gymnasium's registry, or by a function that the user names."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import gymnasium

from gpusimbench.recorder.vector.maniskill import stated
from gpusimbench.recorder.vector.open_loop import Started
from gpusimbench.recorder.vector.origin import STATED, SUITED
from gpusimbench.recorder.vector.robosuite import suited
from gpusimbench.schemas.errors import UsageError

_OF_PACKAGES = {STATED: stated, SUITED: suited}
"""Makers of environments that are observed as their states."""


def registered(spec_id: str, keywords: Mapping[str, Any], n_env: int, *, vectorization: str = "sync") -> Any:
    """Environments of Gymnasium's registry, in this process, whose user resets them where they can be made so.

    spec_id        "module:id" if the user names a module that registers the id, in the present folder or installed; ids
                   of files name no module (gpusimbench.replay.origin)
    vectorization  "vector_entry_point" for tasks that have a vector environment of their own, which resets itself;
                   STATED or SUITED for those of ManiSkill and robosuite, see recorder.vector.maniskill and robosuite

    UsageError where Gymnasium cannot make them.
    """
    own = vectorization == "vector_entry_point"
    disabled = {
        "vector_kwargs": {"autoreset_mode": gymnasium.vector.AutoresetMode.DISABLED},
        "wrappers": [Started],
    }
    if ":" in spec_id:
        _search_the_present_folder()
    try:
        if vectorization in _OF_PACKAGES:
            return _OF_PACKAGES[vectorization](spec_id, keywords, n_env)
        return gymnasium.make_vec(
            spec_id,
            num_envs=n_env,
            vectorization_mode="vector_entry_point" if own else "sync",
            **({} if own else disabled),
            **keywords,
        )
    except UsageError:
        raise
    except Exception as error:  # of a task's own kind, such as a keyword that it does not know
        own = isinstance(error, gymnasium.error.UnregisteredEnv)  # perhaps by the recording's program itself
        advice = "; for a task that your program registers, give --make MODULE:FUNCTION" if own else ""
        said = f"{type(error).__name__}: {error}".rstrip(".")
        raise UsageError(f"{spec_id} cannot be made: {said}{advice}") from None


def of_factory(name: str, n_env: int) -> Any:
    """What a function of the user's makes.

    name  "module:function", in the present folder or installed; the function takes the number of environments

    UsageError where there is no such function, it fails, or makes something else.
    """
    module, _, function = name.partition(":")
    if not module or not function:
        raise UsageError(f"--make takes MODULE:FUNCTION, not '{name}'")
    _search_the_present_folder()
    try:
        made = getattr(import_module(module), function)(n_env)
    except (Exception, SystemExit) as error:  # SystemExit: a script without a guard of its main part
        raise UsageError(f"--make {name} failed: {type(error).__name__}: {error}") from error
    if not hasattr(made, "num_envs"):
        raise UsageError(f"--make {name} made {type(made).__name__}, and no VectorEnv")
    return made


def _search_the_present_folder() -> None:
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)  # last, so that no file there hides a package
