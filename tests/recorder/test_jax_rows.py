"""Rows of JAX's arrays: every bit of every dtype comes to the host."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies

from gpusimbench import wrap
from gpusimbench.recorder.vector.device.jax_rows import JaxRows
from gpusimbench.schemas.errors import DataLost
from tests.conftest import finished
from tests.reading import verified
from tests.recorder.engines import needed

jax = needed("jax")

N_ENV = 3  # so that numbers of 8 and 16 bits fill no word
ARRAYS: dict[str, tuple[str, tuple[int, ...]]] = {
    "observation/image": ("uint8", (5, 2, 3)),
    "observation/half": ("float16", (3,)),
    "observation/none": ("float32", (0,)),
    "observation/joints": ("float32", (2, 2)),
    "action": ("int8", (3,)),
    "double": ("float64", (2,)),
    "count": ("uint64", ()),
    "reward": ("float32", ()),
    "done": ("bool", ()),
}


def drawn(rng: np.random.Generator, dtype: str, shape: tuple[int, ...]) -> np.ndarray[Any, Any]:
    """Any bits; floats of the first environment are NaN with a payload, those of the second negative zeros."""
    if dtype == "bool":
        return rng.integers(0, 2, (N_ENV, *shape)).astype(bool)
    data = rng.integers(0, 256, (N_ENV, *shape, np.dtype(dtype).itemsize), dtype=np.uint8)
    if dtype.startswith("float"):
        data[0, ..., -2:] = 0xFF
        data[1] = np.array(-0.0, dtype).reshape(1).view(np.uint8)
    return data.view(dtype).reshape(N_ENV, *shape)


def test_bits_of_all_dtypes() -> None:
    """Keep rows of all dtypes in any order, replace some arrays, and take all bits; arrays are aligned on the host."""
    rng = np.random.default_rng(5)
    with jax.enable_x64(True):
        rows, kept = JaxRows(), []
        for number in range(4):
            row = {name: drawn(rng, *described) for name, described in ARRAYS.items()}
            arrays = {name: jax.numpy.asarray(array) for name, array in row.items()}
            rows.keep(dict(reversed(arrays.items())) if number % 2 else arrays)
            kept.append(row)
        other = {name: drawn(rng, *ARRAYS[name]) for name in ("action", "observation/half", "observation/joints")}
        before = rows.last(other)
        rows.replace({name: jax.numpy.asarray(array) for name, array in other.items()})
        for name, array in before().items():
            assert array.tobytes() == kept[-1][name].tobytes()
        kept[-1] |= other
        found = rows.take()()
    assert found.keys() == ARRAYS.keys()
    for name, array in found.items():
        assert array.shape == (len(kept), N_ENV, *ARRAYS[name][1])
        assert array.dtype == ARRAYS[name][0]
        assert array.flags.aligned
        assert array.tobytes() == np.stack([row[name] for row in kept]).tobytes(), name


def test_bits_as_jax_has_them() -> None:
    """Take bfloat16 as float32, and numpy's float64 in the 32 bits that JAX makes of it."""
    rows = JaxRows()
    for number in range(2):
        half = jax.numpy.full(N_ENV, number + 0.3, jax.numpy.bfloat16)
        rows.keep({"reward": np.full(N_ENV, number + 0.1), "half": half})
    found = rows.take()()
    assert {name: array.dtype.name for name, array in found.items()} == {"reward": "float32", "half": "float32"}
    assert np.array_equal(found["reward"], np.float32([[0.1] * 3, [1.1] * 3]))
    assert np.array_equal(found["half"], np.float32(jax.numpy.bfloat16([[0.3] * 3, [1.3] * 3])))


_TWO_DEVICES = """
import jax
from jax.numpy import ones
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from gpusimbench import UsageError
from gpusimbench.recorder.vector.device.jax_rows import JaxRows
from gpusimbench.schemas.errors import DataLost

first, second = jax.devices()
both = NamedSharding(Mesh((first, second), ("x",)), PartitionSpec("x"))
rows = JaxRows()
rows.keep({"reward": jax.device_put(ones(4), both), "seen": jax.device_put(ones((4, 3)), both), "plain": ones(4)})
assert rows.take()()["seen"].shape == (1, 4, 3)
for other in (second, both):
    apart, moved = JaxRows(), JaxRows()
    moved.keep({"reward": jax.device_put(ones(4), first)})
    for kept, row in ((apart, {"reward": (4, first), "seen": ((4, 3), other)}), (moved, {"reward": (4, other)})):
        try:
            kept.keep({name: jax.device_put(ones(shape), device) for name, (shape, device) in row.items()})
        except UsageError as error:
            print(error)
"""


def test_arrays_on_several_devices() -> None:
    """Keep arrays that two devices share, and name the one that is elsewhere than the others or than in the rows
    before."""
    flags = {"XLA_FLAGS": "--xla_force_host_platform_device_count=2", "JAX_PLATFORMS": "cpu"}
    done = finished([sys.executable, "-c", _TWO_DEVICES], env={**os.environ, **flags})
    told = [line.partition(": ")[0] for line in done.stdout.splitlines()]
    kept = "and the arrays that are kept are on cpu:0"
    assert told == [
        f"{name} is on {at}, {kept}"
        for at in ("cpu:1", "cpu:0, cpu:1") for name in ("seen", "reward")
    ]  # fmt: skip


def _stepped(rows: JaxRows, numbers: range, kept: list[Any]) -> None:
    for number in numbers:
        row = {"observation": jax.numpy.arange(6.0).reshape(3, 2) + number, "reward": jax.numpy.full(N_ENV, number)}
        kept.append(row)
        rows.keep(dict(row))


def test_rows_that_wait_for_others() -> None:
    """Take all of them, in their order, however many there are: with arrays of numpy among them, and replaced ones."""
    for count in (3, 20, 21, 29, 30, 31, 47):
        rows, kept = JaxRows(), list[Any]()
        _stepped(rows, range(count), kept)
        assert np.array_equal(rows.last(["reward"])()["reward"], np.full(N_ENV, count - 1))
        rows.replace({"observation": jax.numpy.zeros((3, 2))})
        kept[-1] = {**kept[-1], "observation": np.zeros((3, 2))}
        _stepped(rows, range(count, count + 4), kept)
        changing = {"observation": np.ones((3, 2), np.float32), "reward": kept[-1]["reward"]}
        rows.keep(changing)
        kept.append({**changing, "observation": np.ones((3, 2))})
        changing["observation"][:] = 5
        found = rows.take()()
        for name, array in found.items():
            assert np.array_equal(array, np.stack([np.asarray(row[name]) for row in kept])), (count, name)
        _stepped(rows, range(3), again := list[Any]())
        assert np.array_equal(rows.take()()["reward"], np.stack([row["reward"] for row in again]))


@pytest.mark.parametrize("take", [False, True])
def test_arrays_whose_memory_is_taken(take: bool) -> None:
    """Keep rows whose arrays are donated in each step; where that begins late, say so, and keep the rows before."""
    give = jax.jit(lambda array: array + 1, donate_argnums=0)
    rows = JaxRows()
    for number in range(45):
        array = jax.numpy.full(N_ENV, float(number))
        rows.keep({"reward": array})
        give(array)
    assert np.array_equal(rows.take()()["reward"][:, 0], np.arange(45.0))

    rows, kept = JaxRows(), list[Any]()
    _stepped(rows, range(27), kept)
    give(kept[-2]["reward"])  # before it is written with the others
    if take:
        found = rows.take()()
        assert "donate_argnums" in str(rows.lost)
    else:
        with pytest.raises(DataLost, match="donate_argnums"):
            _stepped(rows, range(27, 40), kept)
        found = rows.take()()
    assert np.array_equal(found["reward"][:, 0], np.arange(25.0))


_OPERATIONS = strategies.lists(
    strategies.one_of(
        strategies.tuples(strategies.sampled_from(["jax", "jax", "jax", "numpy", "both"]), strategies.integers(1, 24)),
        strategies.tuples(strategies.sampled_from(["replace", "last", "take"]), strategies.integers(0, 1)),
        strategies.tuples(strategies.just("donate"), strategies.integers(1, 12)),
    ),
    max_size=20,
)


@settings(max_examples=40, deadline=None)
@given(_OPERATIONS)
def test_rows_are_those_of_a_list(operations: list[tuple[str, int]]) -> None:
    """Take what a list of copies has, whatever is kept, replaced, asked for, taken and donated; or a part of it that is
    in front, and an error."""
    give = jax.jit(lambda array: array + 1, donate_argnums=0)
    rows, copies, arrays_of = JaxRows(), list[Any](), list[Any]()
    later: list[tuple[Any, Any]] = []  # functions that wait, and what they give
    lost = False
    for what, number in operations:
        try:
            if what in ("jax", "numpy", "both"):
                for _ in range(number):
                    seen = np.arange(6, dtype=np.float32).reshape(3, 2) + len(copies)
                    row = {"observation": seen, "reward": np.full(N_ENV, len(copies), np.int32)}
                    of_numpy = {"jax": (), "numpy": ("observation", "reward"), "both": ("reward",)}[what]
                    arrays = {k: v.copy() if k in of_numpy else jax.numpy.asarray(v) for k, v in row.items()}
                    rows.keep(arrays)
                    for name in of_numpy:
                        arrays[name][:] = -1
                    copies.append(row)
                    arrays_of.append(arrays)
            elif what == "donate" and len(arrays_of) >= number:
                array = arrays_of[-number]["reward"]
                if not isinstance(array, np.ndarray) and not array.is_deleted():
                    give(array)
            elif what == "replace" and copies:
                seen = np.full((3, 2), -7.0, np.float32)
                rows.replace({"observation": jax.numpy.asarray(seen) if number else seen})
                copies[-1] = {**copies[-1], "observation": seen}
            elif what == "last" and copies:
                later.append((rows.last(["observation", "reward"]), copies[-1]))
            elif what == "take" and copies:
                taken, lost = rows.take(), rows.lost is not None
                later.append((taken, copies))
                if lost:
                    break
                copies, arrays_of = [], []
        except DataLost:
            lost = True
            break
    if rows.filled:
        later.append((rows.take(), copies))
        lost = lost or rows.lost is not None
    for function, kept in later:
        found = function()
        if isinstance(kept, list):
            there = len(found["reward"])
            assert there == len(kept) or (lost and kept is copies and there < len(kept))
            kept = {name: np.array([row[name] for row in kept[:there]]) for name in kept[0]} if there else {}
        for name, array in kept.items():
            assert np.array_equal(found[name], array), name


@pytest.mark.parametrize("steps", [60, 28, None])
@pytest.mark.parametrize("hashed", [False, True])
def test_a_recording_whose_rows_were_lost(steps: int | None, hashed: bool, tmp_path: Path) -> None:
    """Raise the error, in a later step or at the end; the rows before are in a whole file, and it says why it ends."""
    from tests.recorder.test_wrap_misuse import Counting, key  # needs JAX

    give = jax.jit(lambda array: array * 1, donate_argnums=0)
    made = 60 if steps == 60 else 28
    with pytest.raises(DataLost, match="donate_argnums"), wrap(Counting(), tmp_path / "a.mcap", steps=steps) as envs:
        states = [envs.reset(key())]
        for number in range(made):
            if number == 27:
                give(states[-2].obs)
            states.append(envs.step(states[-1], jax.numpy.zeros((len(states[0].reward), 1))))
            if hashed:
                envs.fingerprint("policy", np.arange(number + 1))
    recording = verified(tmp_path / "a.mcap")
    assert recording.status == "failed" and "donate_argnums" in recording.reason
    (reward,) = (field for field in recording.fields if field.field == "reward")
    assert len(recording.state(reward.group, reward.field)) == 26
