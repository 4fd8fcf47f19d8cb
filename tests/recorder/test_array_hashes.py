"""Hashes of a program's arrays: as the format defines them, wherever the arrays are."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as drawn

import gpusimbench
from gpusimbench import open_recording
from gpusimbench.recorder.capture import array_hashes
from gpusimbench.recorder.capture.array_hashes import hashed
from gpusimbench.schemas import fingerprint as definition
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.fingerprint import array_fingerprint, fingerprint
from gpusimbench.schemas.mixing import GOLDEN, mix
from tests.reading import verified
from tests.recorder.test_log import states, writer

_DTYPES = ("float32", "float64", "float16", "int8", "uint16", "int32", "int64", "bool")


@given(st.sampled_from(_DTYPES).flatmap(lambda kind: drawn.arrays(kind, drawn.array_shapes(min_dims=0, max_dims=3))))
def test_an_array_is_hashed_by_the_formula(array: np.ndarray) -> None:
    """Compute the sum of the format's description word by word."""
    words = np.frombuffer(array.tobytes(), dtype=f"<u{array.dtype.itemsize}").astype(np.uint64)
    terms = [int(mix(np.array([(int(w) + (i + 1) * GOLDEN) % 2**64], np.uint64))[0]) for i, w in enumerate(words)]
    assert array_fingerprint(array) == sum(terms) % 2**64
    assert hashed(array, "a").hashes == (sum(terms) % 2**64,)


@pytest.mark.parametrize("length", [0, 1, 7, 8, 9, 21])
def test_parts_of_a_long_array_make_one_hash(monkeypatch: pytest.MonkeyPatch, length: int) -> None:
    """Hash in parts of eight words what the hash of states takes as a whole."""
    array = np.random.default_rng(0).normal(size=(1, length))
    whole = int(fingerprint([array])[()]) if length else 0
    monkeypatch.setattr(definition, "_WORDS", 8)
    assert array_fingerprint(array) == whole


def test_names_dtypes_and_shapes_are_those_of_the_tree() -> None:
    """Describe what is nested, numbers, None and texts."""
    tree = {"layers": [{"w": np.zeros((2, 3), np.float32)}, 0.5], "betas": (0.9, None), "mode": "min"}
    found = hashed(tree, "policy")
    assert found.arrays == (
        "float32 2x3 policy/layers/0/w", "float64 - policy/layers/1", "float64 - policy/betas/0",
        "text 4 policy/betas/1", "text 5 policy/mode",
    )  # fmt: skip
    assert hashed({"\udc80": 2**64}, "rng").arrays == ("text 20 rng/\\udc80",)  # no UTF-8, and no 64 bits
    assert len(set(found.hashes)) == len(found.hashes)


_ENDLESS: list[object] = []
_ENDLESS.append(_ENDLESS)


@pytest.mark.parametrize(
    "value",
    [np.zeros(2, complex), np.array([object()]), {}, np.array(["a"]), np.zeros(2, "V5"), np.zeros(2, "V0"), _ENDLESS],
)
def test_other_values_are_refused(value: object) -> None:
    """Refuse what has no words, and a tree without arrays."""
    with pytest.raises(UsageError, match="batch"):
        hashed({"x": value} if isinstance(value, np.ndarray) else value, "batch")


def test_arrays_of_jax_hash_as_those_of_numpy() -> None:
    """Take float32 and bfloat16 from JAX."""
    jnp = pytest.importorskip("jax.numpy")
    array = np.linspace(-1, 1, 12, dtype=np.float32).reshape(3, 4)
    assert hashed(jnp.asarray(array), "a") == hashed(array, "a")
    half = jnp.asarray(array, dtype=jnp.bfloat16)
    assert hashed(half, "a").arrays == ("bfloat16 3x4 a",)
    assert hashed(half, "a").hashes == (array_fingerprint(np.asarray(half).view(np.uint16)),)


@pytest.mark.parametrize("dtype", ["float32", "float64", "float16", "bfloat16", "int64", "int8", "bool"])
def test_tensors_of_torch_have_the_same_hash_on_a_device(monkeypatch: pytest.MonkeyPatch, dtype: str) -> None:
    """Hash by the arithmetic of torch's integers what numpy hashes, in parts; strides do not matter."""
    torch = pytest.importorskip("torch")
    monkeypatch.setattr(array_hashes, "_CHUNK", 8)
    tensor = torch.linspace(-3, 3, 21).reshape(3, 7).to(getattr(torch, dtype)).T
    words = tensor.contiguous().reshape(-1).view(getattr(torch, f"int{8 * tensor.element_size()}"))
    assert array_hashes._on_device(words, torch) == hashed(tensor, "a").hashes[0]
    assert hashed(tensor, "a").hashes[0] == array_fingerprint(words.numpy())
    assert hashed(tensor, "a").arrays == (f"{dtype} 7x3 a",)


def test_updates_are_recorded_in_the_order_of_the_calls(tmp_path: Path) -> None:
    """Read the order, the states before each update, and layouts that change."""
    position, velocity = states()
    with writer(tmp_path / "a.mcap") as log:
        log.fingerprint("policy", {"w": np.zeros(3)})
        log.append(position[:6], velocity[:6])
        log.fingerprint("gradient", np.ones(3))
        log.fingerprint("policy", {"w": np.ones(3)})
        log.append(position[6:], velocity[6:])
        log.fingerprint("policy", {"w": np.ones(4)})
    recording = verified(tmp_path / "a.mcap")
    policy, gradient = recording.program["policy"], recording.program["gradient"]
    assert policy.order.tolist() == [0, 2, 3]
    assert policy.states.tolist() == [0, 6, 11]
    assert policy.arrays == (("float64 3 policy/w",), ("float64 3 policy/w",), ("float64 4 policy/w",))
    assert [hashes.tolist() for hashes in policy.hashes[:2]] == [
        [array_fingerprint(x)] for x in (np.zeros(3), np.ones(3))
    ]
    assert gradient.order.tolist() == [1]
    assert gradient.states.tolist() == [6]


def test_what_would_not_be_read_is_refused(tmp_path: Path) -> None:
    """Name the name, and record on; outside of the block nothing is recorded, so that it is an error."""
    log = writer(tmp_path / "a.mcap")
    with pytest.raises(UsageError, match="within the block"):
        log.fingerprint("policy", np.zeros(3))
    with log:
        for name in ("My policy", "p" * 101):
            with pytest.raises(UsageError, match=f"not '{name[:100]}'"):
                log.fingerprint(name, np.zeros(3))
        log.append(*states())
    with pytest.raises(UsageError, match="within the block"):
        log.fingerprint("policy", np.zeros(3))
    assert open_recording(tmp_path / "a.mcap").status == "complete"


def wrapped(path: Path, steps: int) -> gpusimbench.recorder.vector.wrapper.Recorded:
    """A recorded vector of two pendulums."""
    return gpusimbench.wrap(gymnasium.make_vec("Pendulum-v1", num_envs=2), path, steps=steps)


def test_a_wrapped_environment_records_updates_after_the_last_step(tmp_path: Path) -> None:
    """Count the states before each update, from before the reset to behind the last step."""
    envs = wrapped(tmp_path / "a.mcap", 3)
    envs.fingerprint("policy", np.zeros(1))
    envs.reset(seed=1)
    envs.fingerprint("policy", np.zeros(1))
    for _ in range(3):
        envs.step(np.zeros((2, 1), np.float32))
        envs.fingerprint("policy", np.zeros(1))
    envs.fingerprint("batch", np.zeros(1))
    envs.step(np.zeros((2, 1), np.float32))  # is not recorded, and ends the recording
    envs.fingerprint("policy", np.zeros(1))
    recording = open_recording(tmp_path / "a.mcap")
    assert recording.status == "complete"
    assert recording.program["policy"].states.tolist() == [0, 1, 2, 3, 4]
    assert recording.program["batch"].order.tolist() == [5]
    envs.close()


def test_a_first_update_behind_the_recording_is_an_error(tmp_path: Path) -> None:
    """Refuse what can no longer be recorded."""
    envs = wrapped(tmp_path / "a.mcap", 1)
    envs.reset(seed=1)
    envs.step(np.zeros((2, 1), np.float32))
    with pytest.raises(UsageError, match="the recording has ended"):
        envs.fingerprint("policy", np.zeros(1))
    envs.close()
