"""Assertions for the tests of others: what they pass, what they fail, and what a failure says."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from gpusimbench import RecordingWriter, UsageError, open_recording, testing
from gpusimbench.evaluator.metrics.divergence import opposite_signs, ulp_distance
from gpusimbench.schemas.fields import body_field
from gpusimbench.testing import assert_batch_invariant, assert_deterministic, assert_identical
from tests.conftest import run_python

BITS = {"float16": 16, "float32": 32, "float64": 64, "int32": 32, "uint8": 8, "int64": 64}


def test_the_public_names() -> None:
    """Offer these names and no others, with their parameters; a name that goes, or comes, is a decision."""
    assert testing.__all__ == ["assert_batch_invariant", "assert_deterministic", "assert_identical"]
    parameters = {name: list(inspect.signature(getattr(testing, name)).parameters) for name in testing.__all__}
    assert parameters == {
        "assert_identical": ["a", "b"],
        "assert_deterministic": ["make_env", "steps", "actions", "runs", "seed"],
        "assert_batch_invariant": ["make_env", "steps", "numbers", "actions", "seed"],
    }
    for name, taken in parameters.items():
        text = getattr(testing, name).__doc__
        assert "Return" in text and "Raises" in text
        assert all(parameter in text for parameter in taken)


def failure(function: Any, *arguments: Any, **others: Any) -> str:
    """The text of the assertion that fails, its lines put together."""
    with pytest.raises(AssertionError) as caught:
        function(*arguments, **others)
    return " ".join(str(caught.value).split())


@given(
    dtype=st.sampled_from(list(BITS)),
    shape=st.tuples(st.integers(1, 5), st.integers(1, 4)),
    rest=st.lists(st.integers(1, 3), max_size=2),
    seed=st.integers(0, 999),
    data=st.data(),
)
def test_a_changed_bit_is_found(
    dtype: str, shape: tuple[int, int], rest: list[int], seed: int, data: st.DataObject
) -> None:
    """Name step, environment, component, both numbers and ULPs of any bit that is changed in any number."""
    size = (*shape, *rest)
    words = np.random.default_rng(seed).integers(0, 2 ** BITS[dtype] - 1, size, dtype=f"u{BITS[dtype] // 8}")
    at = tuple(data.draw(st.integers(0, n - 1)) for n in size)
    other = words.copy()
    other[at] ^= words.dtype.type(1 << data.draw(st.integers(0, BITS[dtype] - 1)))
    a, b = words.view(dtype), other.view(dtype)
    same = {"still": np.zeros(shape), "moved": a}
    assert_identical(same, {"still": np.zeros(shape), "moved": a.copy()})
    said = failure(assert_identical, same, {"still": np.zeros(shape), "moved": b})
    env = f", in env {at[1]}" if shape[1] > 1 else ""
    component = f"[{', '.join(map(str, at[2:]))}]" if rest else ""
    assert said.startswith(f"a and b differ first at step {at[0]}{env}: moved{component}: ")
    assert f"moved{component}: {a[at]!s} and {b[at]!s} (" in said
    if np.dtype(dtype).kind == "f":
        one, another = a[at].reshape(1), b[at].reshape(1)
        ulp = int(ulp_distance(one, another)[0])
        zero = (a[at] == 0) != (b[at] == 0)
        signs = opposite_signs(one, another)[0] and not zero
        assert (f"{ulp:,} ULP" in said or f"{ulp:.2e} ULP" in said) != (signs or zero)
        assert (f"the signs differ ({a[at]!s} and {b[at]!s})" in said) == signs
        assert (f"one is zero ({a[at]!s} and {b[at]!s})" in said) == zero
    else:
        assert "ULP" not in said
        assert f"): {abs(int(a[at]) - int(b[at])):.3g}" in said
    assert "fields moved first number" in said


def test_zeros_and_payloads_are_bits() -> None:
    """Tell -0.0 from 0.0 and a NaN from one with another payload, and take equal NaNs for equal."""
    nan = np.array([[0x7FC00000, 0x7FC00000]], dtype=np.uint32)
    other = nan.copy()
    other[0, 1] += 3
    assert_identical(nan.view(np.float32), nan.copy().view(np.float32))
    said = failure(assert_identical, nan.view(np.float32), other.view(np.float32))
    assert "step 0, in env 1: array: 3 ULP" in said
    assert "nan and nan (0x7fc00000, 0x7fc00003): 3 ULP" in said
    said = failure(assert_identical, [np.zeros((1, 2))], [-np.zeros((1, 2))])
    assert "0: 0.0 and -0.0 (0x0000000000000000, 0x8000000000000000): 1 ULP, 0" in said


@pytest.mark.parametrize(
    ("b", "said"),
    [
        ({"x": np.zeros((3, 2), np.float32)}, "x: dtype float64 in a, float32 in b"),
        ({"x": np.zeros((4, 2))}, "x: shape (3, 2) in a, (4, 2) in b"),
        ({"x": np.zeros((3, 1), int)}, "x: dtype float64 in a, int64 in b; shape (3, 2) in a, (3, 1) in b"),
        ({"x": np.zeros((3, 2)), "y": {"z": np.zeros((3, 2))}}, "y/z: only in b"),
        ({"y": np.zeros((3, 2))}, "x: only in a"),
    ],
)
def test_arrays_that_are_not_alike(b: Any, said: str) -> None:
    """Fail for another dtype, another shape and an array too many or too few, and say which."""
    assert f"not compared: {said}" in failure(assert_identical, {"x": np.zeros((3, 2))}, b)


def test_what_differs_beside_what_cannot_be_compared() -> None:
    """Name the first numbers that differ, and the arrays that were not compared; name what was equal otherwise."""
    a = {"x": np.zeros((3, 2)), "y": np.zeros((3, 2))}
    assert "that could be compared" not in failure(assert_identical, a, {"x": np.ones((3, 2)), "y": np.zeros((3, 1))})
    said = failure(assert_identical, a, {"x": np.zeros((3, 2)), "y": np.zeros((3, 1))})
    assert "a and b are not alike, although what could be compared is bit-identical" in said
    assert_identical({"none": np.zeros((3, 2, 0))}, {"none": np.zeros((3, 2, 0))})


@pytest.mark.parametrize(
    ("a", "b", "message"),
    [
        ({}, {}, "there is no array"),
        (np.zeros(3), np.zeros(3), r"array has shape \(3,\); arrays are \[step, env, ...\]"),
        (np.zeros((1, 1), complex), np.zeros((1, 1), complex), "array is complex128"),
        ([["red"]], [["red"]], "0/0 is <U3"),
        (Path("a.mcap"), np.zeros((1, 1)), "a recording is compared with a recording"),
    ],
)
def test_what_is_no_set_of_arrays(a: Any, b: Any, message: str) -> None:
    """Say so."""
    with pytest.raises(UsageError, match=message):
        assert_identical(a, b)


def log(path: Path, position: NDArray[np.float32], *fields: str) -> Path:
    """A recording of two bodies."""
    names = fields or ("position",)
    layout = [body_field("cubes", name, "float32", ("red", "blue")) for name in names]
    with RecordingWriter(
        path, simulator="mine", version="1.0", scene="toss", n_env=position.shape[1], dt=0.01,
        steps=len(position) - 1, fields=layout,
    ) as writer:  # fmt: skip
        writer.append(*[position] * len(names))
    return path


def test_recordings(tmp_path: Path) -> None:
    """Compare recordings as gsb-diff does: bits, environments, steps and fields."""
    position = np.random.default_rng(0).normal(size=(6, 3, 2, 3)).astype(np.float32)
    a = log(tmp_path / "a.mcap", position)
    assert_identical(a, str(log(tmp_path / "same.mcap", position)))
    moved = position.copy()
    moved[4, 2, 1, 0] = np.nextafter(moved[4, 2, 1, 0], np.float32(9))
    said = failure(assert_identical, open_recording(a), log(tmp_path / "moved.mcap", moved))
    assert "differ first at step 4 (0.04 s), first in env 2: cubes/position of blue, x: 1 ULP" in said
    said = failure(assert_identical, a, log(tmp_path / "one.mcap", position[:, :1]))
    assert "a has 3 envs, b has 1" in said
    said = failure(assert_identical, a, log(tmp_path / "short.mcap", position[:4]))
    assert "not everything was compared" in said
    more = log(tmp_path / "more.mcap", position, "position", "linear_velocity")
    assert "cubes/linear_velocity: only in b" in failure(assert_identical, a, more)


class Counters:
    """Environments that count, with noise from the seed and a difference where it is planted.

    among   add a number that depends on how many environments there are, from that step on
    planted  run, step and environment
    """

    made = 0

    def __init__(self, n_env: int, *, planted: tuple[int, int, int] | None = None, among: int = 10**9) -> None:
        self.n_env, self.planted, self.among = n_env, planted, among
        self.run = Counters.made
        Counters.made += 1
        self.closed = False

    def reset(self, seed: int) -> dict[str, Any]:
        self.at = 0
        self.state = np.stack([np.random.default_rng(seed + env).normal(size=3) for env in range(self.n_env)])
        return {"inner": (self.state,), "count": np.full(self.n_env, self.at)}

    def step(self, actions: Any) -> dict[str, Any]:
        assert not self.closed
        self.at += 1
        self.state *= 1.01  # in place: what was returned before must have been copied
        if actions is not None:
            self.state += actions["push"]
        if self.planted and self.planted[:2] == (self.run, self.at):
            self.state[self.planted[2], 1] = np.nextafter(self.state[self.planted[2], 1], np.inf)
        if self.at >= self.among:
            self.state[1:] += 1 / self.n_env
        return {"inner": (self.state,), "count": np.full(self.n_env, self.at)}

    def close(self) -> None:
        self.closed = True


def test_anything_that_resets_and_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Find a difference in the last of three runs, where it was put."""
    assert_deterministic(lambda: Counters(4), 5, runs=3)
    monkeypatch.setattr(Counters, "made", 0)
    said = failure(assert_deterministic, lambda: Counters(4, planted=(2, 3, 1)), 5, runs=3)
    assert said.startswith("run 0 and run 2 differ first at step 3, in env 1: inner/0[1]: 1 ULP")
    assert "equal up to step 2; 1 of 4 envs differ at that step" in said


def test_the_number_of_environments() -> None:
    """Give the first environments their own actions, and find where results depend on the number of the others."""
    actions = [{"push": np.random.default_rng(step).normal(size=(5, 3))} for step in range(4)]
    assert_batch_invariant(Counters, steps=4, numbers=(5, 1, 2), actions=actions)
    said = failure(assert_batch_invariant, lambda n: Counters(n, among=2), steps=4, numbers=(1, 2, 5), actions=actions)
    assert said.startswith("2 envs and the same 2 among 5 differ first at step 2, in env 1: inner/0[0]: ")
    said = failure(assert_batch_invariant, lambda n: Counters(n, planted=(Counters.made, n, 0)), steps=1)
    assert said.startswith("1 env alone and the same env among 16 differ first at step 1: inner/0[1]: 1 ULP")


class Returning:
    """An environment that returns what it is given, reset first."""

    def __init__(self, *returned: Any) -> None:
        self.returned = iter(returned)

    def reset(self, seed: int) -> Any:
        return next(self.returned)

    def step(self, action: Any) -> Any:
        return next(self.returned)


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        ((1.0,), r"array has shape \(\) at step 0; its first axis must be that of the environments"),
        (({"x": np.zeros(2), "y": np.zeros(3)},), r"y has shape \(3,\) at step 0; its first axis .* 2 environments"),
        ((np.zeros(2), np.zeros(3)), r"array has shape \(3,\) at step 1"),
        ((np.zeros(2), np.zeros(2, int)), r"array is int64 \(2,\) at step 1, and not the same or not there before"),
        (
            ({"x": np.zeros(2)}, {"y": np.zeros(2)}, {"y": np.zeros(2)}),
            "an array that earlier steps returned was not returned",
        ),
        (({"x": np.zeros(2)}, {}, {"x": np.zeros(2)}), "x is float64 .* at step 2, and not the same or not there"),
        (((np.zeros(2), {}), (np.zeros(2), 0.0, False, {})), "step returns .observation, reward, terminated"),
    ],
)
def test_what_is_no_environment(returned: tuple[Any, ...], message: str) -> None:
    """Say what a method returned that cannot be compared."""
    with pytest.raises(UsageError, match=message):
        assert_deterministic(lambda: Returning(*returned), 2)


def test_what_cannot_be_asked() -> None:
    """Refuse comparisons of one run, of one number, of another number than was made, and with too few actions."""
    with pytest.raises(UsageError, match="at least 2 runs"):
        assert_deterministic(lambda: Counters(1), 5, runs=1)
    with pytest.raises(UsageError, match="at least 2 runs of 1 step"):
        assert_deterministic(lambda: Counters(1), 0)
    with pytest.raises(UsageError, match="5 steps need as many actions, and 3 were given"):
        assert_deterministic(lambda: Counters(1), 5, [None] * 3)
    with pytest.raises(UsageError, match="at least two numbers"):
        assert_batch_invariant(Counters, steps=5, numbers=(2, 2))
    with pytest.raises(UsageError, match="its first axis must be that of 3 environments"):
        assert_batch_invariant(lambda n: Counters(n + 1), steps=5, numbers=(2, 3))


@pytest.mark.parametrize("library", ["jax", "warp"])
def test_arrays_of_other_libraries(library: str) -> None:
    """Compare arrays that are not numpy's; in a process of its own, as every engine."""
    pytest.importorskip(library)
    make = {"jax": "import jax.numpy as jp; make = jp.asarray", "warp": "import warp as wp; make = wp.array"}[library]
    code = (
        f"import numpy as np\nfrom gpusimbench.testing import assert_identical\n{make}\n"
        "a = np.ones((2, 2), np.float32)\nassert_identical(make(a), a)\n"
        "try:\n    assert_identical(make(a), make(-a))\nexcept AssertionError as error:\n    print(error)\n"
    )
    done = run_python(code)
    assert "differ first at step 0, in env 0: array: " in done.stdout


def test_mujoco_by_its_own_bindings() -> None:
    """Hold MuJoCo C, stepped as the how-to does, to the same bits in each run and beside others."""
    pytest.importorskip("mujoco")
    page = (Path(__file__).parent.parent / "docs" / "how-to" / "test-your-simulator.md").read_text(encoding="utf-8")
    found = re.search(r'```python title="test_pendulums.py"\n(.*?)^```', page, re.DOTALL | re.MULTILINE)
    shown: dict[str, Any] = {}
    exec(found[1], shown)
    assert_deterministic(lambda: shown["Pendulums"](2), 100)
    assert_batch_invariant(shown["Pendulums"], steps=100)

    class Stirred(shown["Pendulums"]):  # type: ignore[name-defined,misc]
        def reset(self, seed: int) -> Any:
            self.data[-1].qvel[0] = 1e-9  # which is reset, and so is no difference
            state = super().reset(seed)
            self.data[-1].qfrc_applied[0] = np.random.default_rng().normal()
            return state

    assert "differ first at step 1, in env 1: qpos[" in failure(assert_deterministic, lambda: Stirred(2), 100)
