"""A data set that is given to gsb-replay, as a recording in the present folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gpusimbench.recorder.demonstrations.data_set import DataSet
from gpusimbench.replay.origin import Origin, same_task, told_or_named
from gpusimbench.schemas.commands.progress import stage
from gpusimbench.schemas.errors import UsageError


def converted(source: DataSet, env: str | None, changed: Mapping[str, Any], episodes: int | None = None) -> Path:
    """Write the recording of a data set; returns its path.

    env       id of Gymnasium's registry; None: that of the data set
    changed   keywords of the environment, instead of those of the data set
    episodes  how many of the first ones; None: all

    UsageError where the recording is there already, or the task is not known.
    """
    require_gymnasium()
    from gpusimbench.recorder.demonstrations.writing import write
    from gpusimbench.recorder.vector.making import registered
    from gpusimbench.recorder.vector.wrap import step_of

    path = Path(f"{source.name}.mcap")
    if path.exists():
        raise UsageError(f"{path} exists: give it instead of the data set, or remove it")
    told = source.made
    if told.wrappers and not env:
        raise UsageError(
            f"{source.path} was made with the wrappers {', '.join(told.wrappers)}: give --env to go without them"
        )
    of_file = Origin(told.spec_id, told.keywords, told.vectorization)
    origin = told_or_named(str(source.path), of_file, env, changed, "--env")
    envs = registered(origin.spec_id, origin.keywords, 1, vectorization=origin.vectorization)
    try:
        space, dt = envs.single_observation_space, source.dt or step_of(envs)
    finally:
        envs.close()
    with stage("reading the data set"):
        keywords = told.keywords if same_task(origin.spec_id, told.spec_id) else None  # those of the original
        write(source.read(episodes, space), path, source, spec_id=origin.spec_id, keywords=keywords, dt=dt)
    return path


def require_gymnasium() -> None:
    """UsageError where Gymnasium is not installed."""
    try:
        import gymnasium  # noqa: F401
    except ImportError:
        raise UsageError("replaying needs Gymnasium: pip install 'gymnasium[mujoco]'") from None
