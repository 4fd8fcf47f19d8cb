"""Data sets of LeRobot, versions 2.0 to 3.0: a folder with metadata in JSON and frames in Parquet.

The layout is that of lerobot.datasets (version 0.4.4 of the package): meta/info.json names the features of a frame with
their dtypes and shapes; data/**/*.parquet have a row a frame, with its episode_index and frame_index. Version 2 has a
file for each episode, version 3 has several episodes in a file. Video and images are not read.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.demonstrations.data_set import DataSet, Demonstration, read_json
from gpusimbench.schemas.errors import DamagedRecording, UsageError

INFO = Path("meta") / "info.json"

_VERSIONS = ("v2.0", "v2.1", "v3.0")
_EPISODE, _FRAME = "episode_index", "frame_index"
_ACTION, _OBSERVATION = "action", "observation."
_REWARD, _SUCCESS, _SEED = "next.reward", "next.success", "seed"
_PHYSICS = ("physics.qpos", "physics.qvel")
_STATE = "observation/state"
_SUCCESS_INFO = "is_success"  # what the environments of LeRobot call it
_DTYPE = r"(float|u?int)(16|32|64|8)|bool"
_MOST_INFO = 16 << 20
_MOST_NUMBERS = 2 << 30  # of all frames, which a small file can claim to have

Arrays = dict[str, NDArray[Any]]


def opened(path: Path) -> DataSet | None:
    """The data set in a folder; None for anything else. UsageError for another version of the layout."""
    if not (path / INFO).is_file():
        return None
    info = _info(path)
    version = str(info.get("codebase_version", "none"))
    if version not in _VERSIONS:
        raise UsageError(f"{path} is a LeRobot data set of version {version[:20]}: {', '.join(_VERSIONS)} are read")
    fps = info.get("fps")
    frames = tuple(_frame_files(path))
    return DataSet(
        path=path,
        name=path.resolve().name or "lerobot",
        version=f"lerobot {version}",
        files=(path / INFO, *frames),
        read=lambda most, space: read(path, most, space),
        dt=1 / fps if isinstance(fps, (int, float)) and fps is not True and 0 < fps < float("inf") else None,
    )


def read(path: Path, most: int | None = None, space: Any = None) -> list[Demonstration]:
    """The episodes of a data set, in their order, without the last observation of each, which no frame has.

    most   that many at most; None: all
    space  of observations of an environment, whose names arrays get: the only array is "observation" unless it is a
           space of several, where LeRobot calls "state" what environments call "agent_pos"

    Of the features, actions are `action`, observations are those whose names begin with "observation.", rewards are
    `next.reward`, and the info is_success is `next.success`. The layout knows neither seeds nor states of the physics:
    a program that adds the features `seed`, or `physics.qpos` and `physics.qvel`, to its frames has them. What ended
    an episode is not known.

    UsageError where polars is not installed; DamagedRecording where frames are missing or not what the metadata say.
    """
    info = _info(path)
    shapes = dict(_shapes(path, info))
    files = _frame_files(path)
    if not files:
        raise DamagedRecording(f"{path} has no frames: data/ has no file in Parquet")
    table = _table(path, files, [*shapes, _EPISODE, _FRAME], sum(map(prod, shapes.values())), most)
    number, at = (_numbers(path, table[name], (), len(table)) for name in (_EPISODE, _FRAME))
    if number.dtype.kind not in "iu":
        raise DamagedRecording(f"{path}: {_EPISODE} has something else than whole numbers")
    total = info.get("total_episodes")
    if most is None and isinstance(total, int) and len(np.unique(number)) != total:
        raise DamagedRecording(f"{path} has {len(np.unique(number))} of {total} episodes: get the other files, too")
    if not len(table):
        raise DamagedRecording(f"{path} has no frames: its files in data/ have no rows")
    arrays = {name: _numbers(path, table[name], shape, len(table)) for name, shape in shapes.items()}
    edges = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(number)]
    found = []
    for begin, end in zip(edges, edges[1:], strict=False):
        if (at[begin:end] != np.arange(end - begin)).any():
            raise DamagedRecording(f"{path}: frames of episode {number[begin]} are missing")
        of_one = {name: array[begin:end] for name, array in arrays.items()}
        found.append(_episode(path, int(number[begin]), of_one, space))
    return found


def _frame_files(path: Path) -> list[Path]:
    return sorted(file for file in (path / "data").rglob("*.parquet") if file.is_file())


def _info(path: Path) -> dict[str, Any]:
    file = path / INFO
    info = read_json(file, _MOST_INFO)
    if not isinstance(info, dict) or not isinstance(info.get("features"), dict):
        raise DamagedRecording(f"{file} names no features")
    return info


def _shapes(path: Path, info: Mapping[str, Any]) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Features that are read, with the shapes of their arrays in a frame."""
    for name, feature in info["features"].items():
        asked = name in (_ACTION, _REWARD, _SUCCESS, _SEED, *_PHYSICS) or name.startswith((_OBSERVATION, f"{_ACTION}."))
        try:
            if asked and re.fullmatch(_DTYPE, feature["dtype"]):
                shape = tuple(int(n) for n in feature["shape"])
                if not all(0 < n < _MOST_NUMBERS for n in shape):
                    raise ValueError
                yield name, shape
        except (TypeError, LookupError, ValueError, OverflowError):
            raise DamagedRecording(f"{path / INFO}: the feature {name} has no dtype and shape") from None


def _table(path: Path, files: Sequence[Path], columns: Sequence[str], width: int, most: int | None) -> Any:
    """Columns of all frames, sorted by episode and frame."""
    try:
        import polars
    except ImportError:
        raise UsageError("data sets of LeRobot need polars: pip install polars") from None
    try:
        frames = polars.scan_parquet(list(files), glob=False, hive_partitioning=False).select(columns)
        if most is not None:
            numbers = frames.select(polars.col(_EPISODE).unique().sort().head(most)).collect()[_EPISODE]
            frames = frames.filter(polars.col(_EPISODE).is_in(numbers.to_list()))
        if frames.select(polars.len()).collect().item() * max(1, width) > _MOST_NUMBERS:
            raise DamagedRecording(f"{path} has more numbers than are read at once: choose with --episodes")
        return frames.sort(_EPISODE, _FRAME).collect()
    except (polars.exceptions.PolarsError, OSError) as error:
        raise DamagedRecording(f"{path}: the frames cannot be read: {_first_line(error)}") from None
    except BaseException as error:
        if type(error).__name__ != "PanicException":  # which polars raises of some damaged bytes, and does not export
            raise
        raise DamagedRecording(f"{path}: the frames cannot be read: {_first_line(error)}") from None


def _numbers(path: Path, series: Any, shape: tuple[int, ...], n: int) -> NDArray[Any]:
    """A column as an array [frame, *shape]; DamagedRecording where it has something else."""
    import polars

    name = series.name
    while isinstance(series.dtype, (polars.List, polars.Array)):
        lists = series.dtype if isinstance(series.dtype, polars.List) else None
        if series.null_count() or (lists is not None and series.list.len().n_unique() > 1):
            raise DamagedRecording(f"{path}: {name} has not the same shape in all frames")
        series = series.explode()
    if not (series.dtype.is_numeric() or series.dtype == polars.Boolean) or series.null_count():
        raise DamagedRecording(f"{path}: {name} has something else than numbers")
    array: NDArray[Any] = series.to_numpy()
    if array.size != n * prod(shape) or array.dtype.kind not in "fiub":
        raise DamagedRecording(f"{path}: {name} has not the shape of {INFO}, {shape}")
    return array.reshape(n, *shape)


def _by_usual_names(observations: Arrays, space: Any) -> Arrays:
    keys = getattr(space, "spaces", {})
    if not keys and len(observations) == 1:
        return {"observation": next(iter(observations.values()))}
    state = "observation/agent_pos" if "agent_pos" in keys and "state" not in keys else _STATE
    return {state if name == _STATE else name: array for name, array in observations.items()}


def _episode(path: Path, number: int, arrays: Arrays, space: Any) -> Demonstration:
    actions = {name.replace(".", "/"): array for name, array in arrays.items() if name.split(".")[0] == _ACTION}
    observations = {name.replace(".", "/"): array for name, array in arrays.items() if name.startswith(_OBSERVATION)}
    if not actions or not observations:
        raise DamagedRecording(f"{path} has no feature {'observation.*' if actions else _ACTION} of numbers")
    n = len(next(iter(actions.values())))
    one = {name: array.reshape(n, -1)[:, 0] for name, array in arrays.items() if name in (_REWARD, _SUCCESS, _SEED)}
    seed = one.get(_SEED)
    if seed is not None and (seed.dtype.kind not in "iu" or (seed != seed[0]).any() or seed[0] < 0):
        raise DamagedRecording(f"{path}: the seed of episode {number} is no integer of at least 0")
    whole = all(name in arrays for name in _PHYSICS)
    return Demonstration(
        observations=_by_usual_names(observations, space),
        actions=actions,
        rewards=one.get(_REWARD, np.zeros(n)),
        rewarded=_REWARD in one,
        terminated=False,
        truncated=False,
        seed=None if seed is None else int(seed[0]),
        physics={name.split(".")[1]: arrays[name] for name in _PHYSICS} if whole else {},
        infos={_SUCCESS_INFO: one[_SUCCESS]} if _SUCCESS in one else {},
    )


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
