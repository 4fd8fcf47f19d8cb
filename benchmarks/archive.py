"""Packing of states against plain Zstandard of the same bytes and a copy in memory, block by block, in turn.

usage: python -m benchmarks.archive [--repeats 5] [FILE...]

Without files it records two: inclined-collision, whose environments MuJoCo C computes to the same bits, and franka,
where every environment has random targets of its own. The cubes of the first are simulated once more, in environments
that begin with velocities 1e-5 m/s and rad/s apart, and so end up to centimetres apart.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from benchmarks.arguments import parser
from benchmarks.machine import machine, spread
from gpusimbench import open_recording
from gpusimbench.schemas import topics
from gpusimbench.schemas.block_parts import raw_bytes
from gpusimbench.schemas.blocks import decode_state
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.packing import pack, unpack

Arrays = list[NDArray[Any]]

_ENVS, _STEPS = 16, 500


def _arrays(path: Path) -> Arrays:
    container = Container(path)
    states = [topic for topic in container.channels if topics.parse_state(topic)]
    return [decode_state(container.read(m)[1])[1].copy() for topic in states for m in container.messages(topic)]


def _record(folder: Path) -> Iterator[Path]:
    for options in (("--scene", "inclined-collision", "--n-env", "16"), ("--scene", "franka", "--n-env", "64")):
        subprocess.run(
            [sys.executable, "-m", "gpusimbench.recorder.cli",
             "--sim", "mujoco", "--runs", "1", "--phases", "capture", *options,
             "--out", str(folder)], check=True, capture_output=True,
        )  # fmt: skip
    yield from sorted(folder.glob("*.mcap"))


def _differing(path: Path) -> Arrays:
    # states of the cubes of a recording by MuJoCo, [step, env, cube, number], 50 steps a block
    import mujoco

    scene = open_recording(path).attachment("scene.xml") or b""
    model = mujoco.MjModel.from_xml_string(scene.decode())
    bodies = [i for i in range(model.nbody) if model.body(i).name.startswith("cube")]
    starts = model.body_dofadr[bodies]
    states = [np.empty((_STEPS, _ENVS, len(bodies), width)) for width in (3, 4, 3, 3)]
    noise = np.random.default_rng(0).standard_normal((_ENVS, model.nv)) * 1e-5
    for env in range(_ENVS):
        data = mujoco.MjData(model)
        data.qvel[:] += noise[env]
        for step in range(_STEPS):
            mujoco.mj_step(model, data)
            found = data.xpos[bodies], data.xquat[bodies], *(data.qvel[starts[:, None] + k + [0, 1, 2]] for k in (0, 3))
            for array, values in zip(states, found, strict=True):
                array[step, env] = values
    return [array[begin : begin + 50] for array in states for begin in range(0, _STEPS, 50)]


def _timed(work: Callable[..., Any], *sources: list[Any]) -> tuple[float, list[Any]]:
    # seconds, and what becomes of each block
    began = time.perf_counter()
    results = [work(*items) for items in zip(*sources, strict=True)]
    return time.perf_counter() - began, results


def _once(arrays: Arrays) -> tuple[dict[str, float], dict[str, float]]:
    # seconds of each kind of work, and sizes against the raw arrays
    plain, back = zstandard.ZstdCompressor(level=3), zstandard.ZstdDecompressor()
    seconds, sizes = {}, {}
    size = sum(array.nbytes for array in arrays)
    seconds["copy"], _ = _timed(lambda array: array.copy(), arrays)
    seconds["pack"], packed = _timed(pack, arrays)
    seconds["zstd -3"], frames = _timed(lambda array: plain.compress(raw_bytes(array)), arrays)
    seconds["unpack"], unpacked = _timed(lambda f, a: unpack(memoryview(f), a.shape, a.dtype), packed, arrays)
    seconds["zstd -d"], _ = _timed(back.decompress, frames)
    if any(a.tobytes() != b.tobytes() for a, b in zip(arrays, unpacked, strict=True)):
        raise SystemExit("what was unpacked is not what was packed")
    for name, blocks in (("packed", packed), ("zstd -3", frames)):
        sizes[name] = sum(map(len, blocks)) / size
    return seconds, sizes


def _measure(name: str, arrays: Arrays, repeats: int) -> None:
    size = sum(array.nbytes for array in arrays)
    if not size:
        raise SystemExit(f"{name} holds no states")
    runs = [_once(arrays) for _ in range(repeats)]
    print(f"{name}: {len(arrays)} blocks, {size / 1e6:.1f} MB, {arrays[0].dtype}")
    for work, share in runs[0][1].items():
        print(f"  {f'size, {work} / raw':<28} {share:.3f}")
    for work in runs[0][0]:
        print(f"  {f'{work} [MB/s]':<28} {spread([size / seconds[work] / 1e6 for seconds, _ in runs], 0)}")
    for work, floor in (("pack", "zstd -3"), ("unpack", "zstd -d"), ("pack", "copy"), ("unpack", "copy")):
        ratios = [seconds[work] / seconds[floor] for seconds, _ in runs]
        print(f"  {f'time, {work} / {floor}':<28} {spread(ratios, 2)}")


def main() -> None:
    """Measure and print."""
    p = parser(__doc__, repeats=5)
    p.add_argument("files", nargs="*", type=Path, metavar="FILE")
    a = p.parse_args()
    print(f"machine: {machine()}")
    with tempfile.TemporaryDirectory() as folder:
        paths = a.files or list(_record(Path(folder)))
        for path in paths:
            _measure(path.name, _arrays(path), a.repeats)
        if not a.files:
            states = _differing(next(p for p in paths if "inclined-collision" in p.name))
            _measure("the same cubes, environments that differ", states, a.repeats)
            _measure("the same as float32", [array.astype("<f4") for array in states], a.repeats)


if __name__ == "__main__":
    main()
