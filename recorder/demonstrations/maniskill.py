"""Trajectories of ManiSkill 3: a file in HDF5, and one in JSON of the same name beside it.

The layout is that of RecordEpisode (mani_skill.utils.wrappers.record, version 3.0.1): a group traj_N for each episode,
with actions [T, ...], env_states (a tree of arrays [T + 1, ...]), success, fail and rewards [T] where there are any.
The JSON has env_info (env_id, env_kwargs, max_episode_steps) and episodes (episode_id, episode_seed, control_mode,
reset_kwargs).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gpusimbench.recorder.demonstrations.arrays import SUFFIXES, is_group, member, opened_file, read_array, read_tree
from gpusimbench.recorder.demonstrations.data_set import DataSet, Demonstration, Made, checked, name_of, read_json
from gpusimbench.recorder.vector.origin import STATED
from gpusimbench.schemas.errors import DamagedRecording, UsageError

FILE = "trajectory.h5"

_MOST_METADATA = 64 << 20
_INFOS = ("success", "fail")
_STATES = "env_states"


def opened(path: Path) -> DataSet | None:
    """The trajectories in a file with metadata of ManiSkill beside it, or in a folder; None for anything else."""
    file = path / FILE if path.is_dir() else path
    if file.suffix not in SUFFIXES or not file.is_file() or (told := _metadata(file)) is None:
        return None
    metadata = told
    return DataSet(
        path=file,
        name=file.stem,
        version="ManiSkill",
        files=(file, file.with_suffix(".json")),
        read=lambda most, space: read(file, metadata, most),
        made=made(file, metadata),
        at_once=1,  # as they were recorded: what was simulated before may change what comes after
    )


def _metadata(file: Path) -> Mapping[str, Any] | None:
    beside = file.with_suffix(".json")
    if not beside.is_file():
        return None
    told = read_json(beside, _MOST_METADATA)
    return told if isinstance(told, dict) and {"env_info", "episodes"} <= told.keys() else None


def made(file: Path, metadata: Mapping[str, Any]) -> Made:
    """How the environment was made; no code that the metadata name is imported.

    DamagedRecording where the metadata are something else than those of ManiSkill; UsageError where episodes were
    controlled in different modes.
    """
    of_env, of_episodes = metadata["env_info"] or {}, metadata["episodes"]
    beside = file.with_suffix(".json")
    if not isinstance(of_env, dict) or not isinstance(of_env.get("env_kwargs", {}), dict):
        raise DamagedRecording(f"{beside}: env_info has no keywords of an environment")
    if not isinstance(of_episodes, list) or not all(isinstance(one, dict) for one in of_episodes):
        raise DamagedRecording(f"{beside}: episodes are no list of episodes")
    keywords = dict(of_env.get("env_kwargs", {}))
    modes = list(dict.fromkeys(str(one["control_mode"]) for one in of_episodes if one.get("control_mode")))
    if len(modes) > 1:
        raise UsageError(f"{file} has episodes of several control modes, which are not replayed at once: {modes}")
    if modes:  # the default of the task may be another in another version
        keywords.setdefault("control_mode", modes[0])
    if type(of_env.get("max_episode_steps")) is int:
        keywords.setdefault("max_episode_steps", of_env["max_episode_steps"])
    return Made(name_of(of_env.get("env_id")), keywords, vectorization=STATED)


def read(file: Path, metadata: Mapping[str, Any], most: int | None = None) -> list[Demonstration]:
    """The episodes, in the order of the metadata.

    most  that many at most; None: all

    Observations are the states. Neither terminated nor truncated ended an episode: demonstrations may go on after both.
    UsageError where h5py is not installed, there are no states, or a reset had options; NotARecording and
    DamagedRecording as of arrays.opened_file, and where arrays are missing or contradict each other.
    """
    with opened_file(file) as groups:
        found = [_episode(file, groups, told) for told in metadata["episodes"][:most]]
    if not found:
        raise DamagedRecording(f"{file} has no episodes")
    return found


def _episode(file: Path, groups: Any, told: Mapping[str, Any]) -> Demonstration:
    number = told.get("episode_id")
    if type(number) is not int:
        raise DamagedRecording(f"{file}: the metadata have an episode_id that is no integer")
    name = f"traj_{number}"
    if not is_group(groups, name):
        raise DamagedRecording(f"{file} has no {name}")
    group = member(file, groups, name)
    if _STATES not in group:
        raise UsageError(f"{name} of {file} has no {_STATES}: RecordEpisode writes them with record_env_state=True")
    states = read_tree(file, group, _STATES, "observation")
    if "observation" in states:
        raise UsageError(f"{file} is of ManiSkill 2, whose states are an array without names: ManiSkill 3 is read")
    actions = read_tree(file, group, "actions", "action")
    n = len(next(iter(actions.values()), ()))
    rewarded = "rewards" in group
    return checked(
        file,
        Demonstration(
            observations=states,
            actions=actions,
            rewards=read_array(file, group, "rewards") if rewarded else np.zeros(n),
            rewarded=rewarded,
            terminated=False,
            truncated=False,
            seed=_seed(file, name, told),
            physics={},
            infos={info: read_array(file, group, info) for info in _INFOS if info in group},
        ),
    )


def _seed(file: Path, name: str, told: Mapping[str, Any]) -> int | None:
    """The seed that was given to the reset, or else the seed that ManiSkill drew for the episode."""
    reset = told.get("reset_kwargs") or {}
    if not isinstance(reset, dict):
        raise DamagedRecording(f"{file}: {name} has no keywords of its reset")
    if options := reset.get("options"):
        raise UsageError(f"{name} of {file} was reset with options, which are not given again: {options!r:.60}")
    given = reset.get("seed", told.get("episode_seed"))
    seed = given[0] if isinstance(given, list) and len(given) == 1 else given
    if seed is not None and (type(seed) is not int or seed < 0):
        raise DamagedRecording(f"{file}: the seed of {name} is no integer of at least 0")
    return seed
