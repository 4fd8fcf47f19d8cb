"""Data sets in HDF5: flat ones, as D4RL has them, and Minari's, with a group for each episode."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.demonstrations.data_set import DataSet, Made
from gpusimbench.recorder.demonstrations.demonstration import Arrays, Demonstration
from gpusimbench.schemas.errors import DamagedRecording, NotARecording, UsageError
from gpusimbench.schemas.text import few

MINARI_FILE, METADATA = "main_data.hdf5", "metadata.json"

_EPISODE = re.compile(r"episode_(\d{1,9})")
_MOST_BYTES = 16 << 30  # of an array, which a small file can claim to have
_MOST_METADATA = 1 << 20
_DEEPEST = 8
_NAMED = 3


def opened(path: Path) -> DataSet | None:
    """The data set in a file, by its suffix, or in the folder of a Minari data set; None for anything else."""
    file = path if not path.is_dir() and path.suffix in (".hdf5", ".h5") and path.exists() else None
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
    """Of a file, or of the folder in which a Minari file lies."""
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
    with _opened(path) as file:
        numbers = sorted(int(named.group(1)) for name in file if (named := _EPISODE.fullmatch(name)))
        if numbers:
            found = [_of_group(path, _item(path, file, f"episode_{number}")) for number in numbers[:most]]
        else:
            found = list(islice(_of_flat(path, file), most))
    if not found:
        raise DamagedRecording(f"{path} has no episodes")
    return found


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        import h5py
    except ImportError:
        raise UsageError("data sets in HDF5 need h5py: pip install h5py") from None
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        if error.errno:
            raise NotARecording(f"cannot read {path}: {os.strerror(error.errno)}") from None
        raise NotARecording(f"{path} is no HDF5 file: {error}") from None
    with file:
        try:
            yield file
        except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
            # h5py has no kind of error for damaged bytes: which one it raises depends on what they were
            raise DamagedRecording(f"{path} is damaged, get it again: {error}") from error


def _item(path: Path, group: Any, name: str) -> Any:
    """A member of a group; DamagedRecording where there is none, or where it is a link or lies in another file."""
    import h5py

    for part in name.split("/"):
        link = group.get(part, getlink=True) if isinstance(group, h5py.Group) else None
        if link is not None and not isinstance(link, h5py.HardLink):
            raise DamagedRecording(f"{path}: {name} is a link, and none is followed")
        if link is None:
            raise DamagedRecording(f"{path} has no {name}")
        group = group[part]
    if isinstance(group, h5py.Dataset) and (group.external or group.is_virtual or group.nbytes > _MOST_BYTES):
        raise DamagedRecording(f"{path}: {name} lies in another file, or is too large")
    return group


def _has(group: Any, name: str) -> bool:
    return name in group


def _is_group(file: Any, name: str) -> bool:
    # no link is followed
    import h5py

    return isinstance(file.get(name, getlink=True), h5py.HardLink) and isinstance(file[name], h5py.Group)


def _array(path: Path, group: Any, name: str) -> NDArray[Any]:
    item = _item(path, group, name)
    if hasattr(item, "keys"):
        raise DamagedRecording(f"{path}: {name} is a group, and no array of numbers")
    found = np.asarray(item[()])
    if found.dtype.kind not in "fiub" or not found.ndim:
        raise DamagedRecording(f"{path}: {name} is no array of numbers")
    return found


def _tree(path: Path, group: Any, name: str, called: str, depth: int = 0) -> dict[str, NDArray[Any]]:
    """The arrays of a member, named as gpusimbench.wrap names those of nested observations."""
    item = _item(path, group, name)
    if not hasattr(item, "keys"):
        return {called: _array(path, group, name)}
    if depth > _DEEPEST:
        raise DamagedRecording(f"{path}: {name} is nested too deeply")
    found: dict[str, NDArray[Any]] = {}
    for key in item:
        found |= _tree(path, item, key, f"{called}/{key.removeprefix('_index_')}", depth + 1)
    return found


def _of_group(path: Path, group: Any) -> Demonstration:
    """Of a Minari episode."""
    rewards = _array(path, group, "rewards")
    flags = [_array(path, group, name) for name in ("terminations", "truncations")]
    physics = {}
    if _has(group, "infos") and all(_has(group["infos"], name) for name in ("qpos", "qvel")):
        physics = {name: _array(path, group, f"infos/{name}")[: len(rewards)] for name in ("qpos", "qvel")}
    return _checked(
        path,
        Demonstration(
            observations=_tree(path, group, "observations", "observation"),
            actions=_tree(path, group, "actions", "action"),
            rewards=rewards,
            terminated=bool(flags[0][-1:].any()),
            truncated=bool(flags[1][-1:].any()),
            seed=_seed(path, group),
            physics=physics,
        ),
    )


def _seed(path: Path, group: Any) -> int | None:
    """Of the reset that began a Minari episode."""
    seed = group.attrs.get("seed")
    if seed is None:
        return None
    if not isinstance(seed, (int, np.integer)) or seed < 0:
        raise DamagedRecording(f"{path}: the seed of {group.name.lstrip('/')} is no integer of at least 0")
    return int(seed)


def _of_flat(path: Path, file: Any) -> Iterator[Demonstration]:
    """Of a D4RL file, whose arrays [step, ...] hold all episodes one after another."""
    if not _has(file, "rewards") and (groups := [name for name in file if _is_group(file, name)]):
        raise DamagedRecording(
            f"{path} is in a layout that is not read: it has {few(groups, _NAMED)} in place of D4RL's arrays and "
            "Minari's episodes. robomimic, robosuite, LIBERO and ManiSkill write such files. Write the arrays of D4RL "
            "(rewards, observations, actions, terminals, timeouts, infos/qpos, infos/qvel) from them"
        )
    rewards = _array(path, file, "rewards").reshape(-1)
    n = len(rewards)
    if not n:
        return
    ends = {
        name: _array(path, file, name).reshape(-1) != 0 if _has(file, name) else np.zeros(n, dtype=np.bool_)
        for name in ("terminals", "timeouts")
    }
    observations, actions = _array(path, file, "observations"), _array(path, file, "actions")
    following = _array(path, file, "next_observations") if _has(file, "next_observations") else None
    physics: Arrays = {}
    if all(_has(file, f"infos/{name}") for name in ("qpos", "qvel")):
        physics = {name: _array(path, file, f"infos/{name}") for name in ("qpos", "qvel")}
    every = (*ends.values(), observations, actions, *physics.values(), *([] if following is None else [following]))
    if odd := [array for array in every if len(array) != n]:
        raise DamagedRecording(f"{path}: there are {n} rewards, and {len(odd[0])} rows of another array")
    over = np.flatnonzero(ends["terminals"] | ends["timeouts"]) + 1
    edges = [0, *over.tolist(), *([n] if not over.size or over[-1] < n else [])]
    for begin, end in pairwise(edges):
        seen = observations[begin:end]
        yield _checked(
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


def _checked(path: Path, found: Demonstration) -> Demonstration:
    n = len(found)
    if not n:
        raise DamagedRecording(f"{path} has an episode without a step")
    if found.rewards.ndim != 1:
        raise DamagedRecording(f"{path}: rewards have the shape {found.rewards.shape}, and not one number a step")
    for what, arrays in (("observations", found.observations), ("actions", found.actions)):
        if not arrays or not all(array.size for array in arrays.values()):
            raise DamagedRecording(f"{path} has an episode whose {what} have no numbers")
    if any(len(array) not in (n, n + 1) for array in found.observations.values()) or any(
        len(array) != n for array in (*found.actions.values(), *found.physics.values())
    ):
        raise DamagedRecording(f"{path}: the arrays of an episode of {n} steps have other lengths")
    if len({len(array) for array in found.observations.values()}) > 1:
        raise DamagedRecording(f"{path}: the observations of an episode of {n} steps have different lengths")
    return found
