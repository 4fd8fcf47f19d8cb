"""Demonstrations of robosuite in HDF5, as robosuite writes them and robomimic keeps them.

The layout is that of robosuite.scripts.collect_human_demonstrations (version 1.5.2) and robomimic: a group data, with
the attribute env_args (JSON: env_name, env_version, env_kwargs), or env and env_info, and a group demo_N for each
episode with states [T, 1 + nq + nv] (time [s], qpos, qvel, before each action), actions [T, ...], rewards [T] where
there are any, and the attributes model_file (MJCF) and num_samples. robosuite's script, which alone writes env_info,
keeps an episode only if it succeeded.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gpusimbench.recorder.demonstrations.arrays import SUFFIXES, check_texts, is_group, member, opened_file, read_array
from gpusimbench.recorder.demonstrations.data_set import Arrays, DataSet, Demonstration, Made, checked, name_of
from gpusimbench.recorder.vector.origin import SUITED
from gpusimbench.schemas.errors import DamagedRecording

_DATA = "data"
_DEMO = re.compile(r"demo_(\d{1,9})")
_PARTS = ("time", "qpos", "qvel")


def opened(path: Path) -> DataSet | None:
    """The demonstrations in a file that names an environment of robosuite; None for anything else."""
    if path.suffix not in SUFFIXES or not path.is_file():
        return None
    with opened_file(path) as file:
        if not is_group(file, _DATA) or not {"env_args", "env_info"} & set(file[_DATA].attrs):
            return None
        check_texts(path)
        told = _environment(path, file[_DATA].attrs)
    return DataSet(
        path=path,
        name=path.stem,
        version=f"robosuite {name_of(told.get('env_version'))}".rstrip(),
        files=(path,),
        read=lambda most, space: read(path, space, most),
        made=Made(name_of(told.get("env_name")), told["env_kwargs"], vectorization=SUITED),
        at_once=1,  # each episode has a model of its own, which its environment loads
    )


def _environment(path: Path, attributes: Mapping[str, Any]) -> dict[str, Any]:
    """What the file says of its environment, in robomimic's words."""
    given = "env_args" in attributes
    try:
        told = json.loads(attributes["env_args" if given else "env_info"])
    except (ValueError, TypeError, RecursionError):
        told = None
    keywords = told.get("env_kwargs", {}) if given and isinstance(told, dict) else told
    if not isinstance(told, dict) or not isinstance(keywords, dict):
        raise DamagedRecording(f"{path}: what it says of its environment is no JSON")
    if given:
        return {**told, "env_kwargs": keywords}
    name = keywords.pop("env_name", attributes.get("env"))
    return {"env_name": name, "env_version": attributes.get("repository_version"), "env_kwargs": keywords}


def read(path: Path, space: Any, most: int | None = None) -> list[Demonstration]:
    """The episodes, in the order of their numbers.

    space  of observations of Suited, by which states are divided into time, qpos and qvel
    most   that many at most; None: all

    Observations are the states. UsageError where h5py is not installed; NotARecording and DamagedRecording as of
    arrays.opened_file, and where episodes are not whole, states are not finite, or not of the model of the task.
    """
    sizes = [space[name].shape[0] for name in _PARTS]
    with opened_file(path) as file:
        demos = member(path, file, _DATA)
        numbers = sorted(int(named.group(1)) for name in demos if (named := _DEMO.fullmatch(name)))
        succeeded = "env_info" in demos.attrs
        found = [_episode(path, demos, f"demo_{number}", sizes, succeeded) for number in numbers[:most]]
    if not found:
        raise DamagedRecording(f"{path} has no episodes")
    return found


def _episode(path: Path, demos: Any, name: str, sizes: list[int], succeeded: bool) -> Demonstration:
    group = member(path, demos, name)
    states, actions = read_array(path, group, "states"), read_array(path, group, "actions")
    n, samples = len(actions), group.attrs.get("num_samples")
    if len(states) != n or (samples is not None and samples != n):
        raise DamagedRecording(f"{path}: {name} is not whole: it has {len(states)} states and {n} actions")
    if states.ndim != 2 or states.shape[1] != sum(sizes):
        raise DamagedRecording(
            f"{path}: states of {name} have {states[:1].size} numbers, and the model of the task {sum(sizes)} "
            "(time, qpos, qvel)"
        )
    if not np.isfinite(states).all():
        raise DamagedRecording(f"{path}: a state of {name} is not finite")
    model = group.attrs.get("model_file")
    if not isinstance(model, str):
        raise DamagedRecording(f"{path}: {name} has no model_file, in which its states were made")
    parts = np.split(states, np.cumsum(sizes)[:-1], axis=1)
    observations: Arrays = {f"observation/{part}": array for part, array in zip(_PARTS, parts, strict=True)}
    rewarded = "rewards" in group
    return checked(
        path,
        Demonstration(
            observations=observations,
            actions={"action": actions},
            rewards=read_array(path, group, "rewards") if rewarded else np.zeros(n),
            rewarded=rewarded,
            terminated=False,
            truncated=False,
            seed=None,
            physics={},
            infos={"success": np.where(np.arange(n) < n - 1, np.nan, 1.0)} if succeeded else {},
            model=model,
        ),
    )
