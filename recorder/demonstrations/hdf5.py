"""Data sets in HDF5: flat ones, as D4RL has them, and Minari's, with a group for each episode."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from gpusimbench.recorder.demonstrations.arrays import (
    SUFFIXES,
    has,
    is_group,
    member,
    opened_file,
    read_array,
    read_tree,
)
from gpusimbench.recorder.demonstrations.data_set import Arrays, DataSet, Demonstration, Made, checked
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.text import few

MINARI_FILE, METADATA = "main_data.hdf5", "metadata.json"

_EPISODE = re.compile(r"episode_(\d{1,9})")
_TRAJECTORY = re.compile(r"traj_\d{1,9}")
_MOST_METADATA = 1 << 20
_NAMED = 3


def opened(path: Path) -> DataSet | None:
    """The data set in a file, by its suffix, or in the folder of a Minari data set; None for anything else."""
    file = path if not path.is_dir() and path.suffix in SUFFIXES and path.exists() else None
    if path.is_dir():
        file = next((one for one in (path / MINARI_FILE, path / "data" / MINARI_FILE) if one.is_file()), None)
    if file is None:
        return None
    found = file
    return DataSet(
        path=file,
        name=_name(file),
        version=file.suffix.removeprefix("."),
        files=(file,),
        read=lambda most, space: read(found, most),
        made=made(file),
    )


def _name(file: Path) -> str:
    """The name of a file, or of the folder in which a Minari file lies."""
    if file.name != MINARI_FILE:
        return file.stem
    folders = [one for one in file.resolve().parents if one.name != "data"]
    return folders[0].name or "data"


def made(path: Path) -> Made:
    """What the metadata beside a Minari file say; no code that they name is imported."""
    beside = path.with_name(METADATA)
    if not beside.is_file() or beside.stat().st_size > _MOST_METADATA:
        return Made()
    try:
        spec = json.loads(json.loads(beside.read_text(encoding="utf-8"))["env_spec"])
        longest = spec.get("max_episode_steps")
        keywords = {**spec.get("kwargs", {}), **({} if longest is None else {"max_episode_steps": int(longest)})}
        return Made(str(spec["id"]), keywords, tuple(str(one["name"]) for one in spec.get("additional_wrappers", ())))
    except (ValueError, TypeError, LookupError, AttributeError, OverflowError, RecursionError, OSError):
        return Made()


def read(path: Path, most: int | None = None) -> list[Demonstration]:
    """The episodes of a data set, in its order.

    most  that many at most; None: all

    UsageError where h5py is not installed; NotARecording where the file is not HDF5, DamagedRecording where arrays are
    missing or contradict each other.
    """
    with opened_file(path) as file:
        numbers = sorted(int(named.group(1)) for name in file if (named := _EPISODE.fullmatch(name)))
        if numbers:
            found = [_of_group(path, member(path, file, f"episode_{number}")) for number in numbers[:most]]
        else:
            found = list(islice(_of_flat(path, file), most))
    if not found:
        raise DamagedRecording(f"{path} has no episodes")
    return found


def _of_group(path: Path, group: Any) -> Demonstration:
    """The demonstration of a Minari episode."""
    rewards = read_array(path, group, "rewards")
    flags = [read_array(path, group, name) for name in ("terminations", "truncations")]
    physics = {}
    if all(has(group, f"infos/{name}") for name in ("qpos", "qvel")):
        physics = {name: read_array(path, group, f"infos/{name}")[: len(rewards)] for name in ("qpos", "qvel")}
    return checked(
        path,
        Demonstration(
            observations=read_tree(path, group, "observations", "observation"),
            actions=read_tree(path, group, "actions", "action"),
            rewards=rewards,
            terminated=bool(flags[0][-1:].any()),
            truncated=bool(flags[1][-1:].any()),
            seed=_seed(path, group),
            physics=physics,
        ),
    )


def _seed(path: Path, group: Any) -> int | None:
    """The seed of the reset that began a Minari episode."""
    seed = group.attrs.get("seed")
    if seed is None:
        return None
    if not isinstance(seed, (int, np.integer)) or seed < 0:
        raise DamagedRecording(f"{path}: the seed of {group.name.lstrip('/')} is no integer of at least 0")
    return int(seed)


def _of_flat(path: Path, file: Any) -> Iterator[Demonstration]:
    """Of a D4RL file, whose arrays [step, ...] hold all episodes one after another."""
    if any(_TRAJECTORY.fullmatch(name) for name in file):
        raise DamagedRecording(
            f"{path} is a file of ManiSkill, which needs its metadata beside it, {path.with_suffix('.json').name}"
        )
    if not has(file, "rewards") and (groups := [name for name in file if is_group(file, name)]):
        raise DamagedRecording(
            f"{path} is in a layout that is not read: it has {few(groups, _NAMED)} in place of D4RL's arrays and "
            "Minari's episodes. Files of robosuite and robomimic are read if they name their environment (env_args or "
            "env_info). Write the arrays of D4RL (rewards, observations, actions, terminals, timeouts, infos/qpos, "
            "infos/qvel) from them"
        )
    rewards = read_array(path, file, "rewards").reshape(-1)
    n = len(rewards)
    if not n:
        return
    ends = {
        name: read_array(path, file, name).reshape(-1) != 0 if has(file, name) else np.zeros(n, dtype=np.bool_)
        for name in ("terminals", "timeouts")
    }
    observations, actions = read_array(path, file, "observations"), read_array(path, file, "actions")
    following = read_array(path, file, "next_observations") if has(file, "next_observations") else None
    physics: Arrays = {}
    if all(has(file, f"infos/{name}") for name in ("qpos", "qvel")):
        physics = {name: read_array(path, file, f"infos/{name}") for name in ("qpos", "qvel")}
    every = (*ends.values(), observations, actions, *physics.values(), *([] if following is None else [following]))
    if odd := [array for array in every if len(array) != n]:
        raise DamagedRecording(f"{path}: there are {n} rewards, and {len(odd[0])} rows of another array")
    over = np.flatnonzero(ends["terminals"] | ends["timeouts"]) + 1
    edges = [0, *over.tolist(), *([n] if not over.size or over[-1] < n else [])]
    for begin, end in pairwise(edges):
        seen = observations[begin:end]
        yield checked(
            path,
            Demonstration(
                observations={
                    "observation": seen if following is None else np.concatenate([seen, following[end - 1 : end]])
                },
                actions={"action": actions[begin:end]},
                rewards=rewards[begin:end],
                terminated=bool(ends["terminals"][end - 1]),
                truncated=bool(ends["timeouts"][end - 1]),
                seed=None,
                physics={name: array[begin:end] for name, array in physics.items()},
            ),
        )
