"""The state hash: as defined, and sensitive to every bit."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.schemas import fingerprint as module
from gpusimbench.schemas.fingerprint import COMPILED_BYTES, expect, fingerprint

_MASK = 2**64 - 1


def _reference(words: list[int]) -> int:
    # the definition of the format's description, one Python number at a time
    total = 0
    for index, word in enumerate(words):
        z = (word + (index + 1) * 0x9E3779B97F4A7C15) & _MASK
        z = ((z ^ z >> 30) * 0xBF58476D1CE4E5B9) & _MASK
        z = ((z ^ z >> 27) * 0x94D049BB133111EB) & _MASK
        total += z ^ z >> 31
    return total & _MASK


@given(st.lists(st.integers(0, 2**32 - 1), min_size=1, max_size=30))
def test_as_defined_float32(words: list[int]) -> None:
    """Equal the definition for single precision."""
    array = np.array(words, dtype=np.uint32).view(np.float32).reshape(1, -1, 1)
    assert int(fingerprint([array])[0]) == _reference(words)


@given(st.lists(st.integers(0, 2**64 - 1), min_size=1, max_size=30))
def test_as_defined_float64(words: list[int]) -> None:
    """Equal the definition for double precision."""
    array = np.array(words, dtype=np.uint64).view(np.float64).reshape(1, -1, 1)
    assert int(fingerprint([array])[0]) == _reference(words)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_every_bit_counts(dtype: Any) -> None:
    """Change with any single bit of any number."""
    state = np.random.default_rng(0).standard_normal((1, 4, 3)).astype(dtype)
    words = state.view({4: np.uint32, 8: np.uint64}[state.itemsize])
    seen = {int(fingerprint([state])[0])}
    for index in range(words.size):
        for bit in range(8 * state.itemsize):
            words.reshape(-1)[index] ^= words.dtype.type(1 << bit)
            seen.add(int(fingerprint([state])[0]))
            words.reshape(-1)[index] ^= words.dtype.type(1 << bit)
    assert len(seen) == 1 + words.size * 8 * state.itemsize


def test_order_counts() -> None:
    """Tell two bodies that swapped places, and fields in another order, from the original."""
    state = np.random.default_rng(1).standard_normal((1, 2, 3))
    swapped = state[:, ::-1]
    assert fingerprint([state])[0] != fingerprint([swapped])[0]
    assert fingerprint([state, swapped])[0] != fingerprint([swapped, state])[0]


def test_steps_and_environments_are_independent() -> None:
    """Give each step and environment the hash that it has alone."""
    fields = [np.random.default_rng(i).standard_normal((3, 5, 4, w)).astype(np.float32) for i, w in enumerate((3, 4))]
    whole = fingerprint(fields)
    for step in range(3):
        for env in range(5):
            assert whole[step, env] == fingerprint([f[step, env][np.newaxis] for f in fields])[0]


def test_different_leading_shapes_are_refused() -> None:
    """Raise where fields disagree on steps or environments."""
    with pytest.raises(ValueError, match="leading shapes"):
        fingerprint([np.zeros((2, 1, 1)), np.zeros((3, 1, 1))])


@pytest.fixture
def nothing_expected(monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that was not told of any states yet."""
    monkeypatch.setattr(module, "_expected", 0)
    monkeypatch.setattr(module, "_seen", 0)
    monkeypatch.setattr(module, "_asked", False)
    monkeypatch.setattr(module, "_compiled", None)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.usefixtures("nothing_expected")
def test_compiled_hashes_are_the_same(dtype: Any) -> None:
    """Compile the hashes once many states are expected, and give the same bits, also of arrays that are views."""
    rng = np.random.default_rng(2)
    fields = [rng.standard_normal((3, 40, 28, width + 1)).astype(dtype)[..., 1:] for width in (3, 4)]
    expect(COMPILED_BYTES // 2)
    assert module._compiled is None
    before = fingerprint(fields)
    expect(COMPILED_BYTES - COMPILED_BYTES // 2)
    assert module._compiled is not None
    assert np.array_equal(fingerprint(fields), before)
    words = fields[0][1, 7].reshape(-1).view({4: np.uint32, 8: np.uint64}[np.dtype(dtype).itemsize])
    assert int(fingerprint([fields[0][1, 7]])) == _reference(words.tolist())


@pytest.mark.usefixtures("nothing_expected")
def test_compiled_once_many_were_hashed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compile the hashes once many states were hashed, though nobody announced them, and give the same bits."""
    monkeypatch.setattr(module, "COMPILED_BYTES", 4000)
    state = np.random.default_rng(4).standard_normal((3, 50, 5, 1)).astype(np.float32)  # 3000 bytes
    before = fingerprint([state])
    assert not module._asked
    while_loading = fingerprint([state])
    loading = [thread for thread in threading.enumerate() if thread.name == "compiling"]
    assert module._asked
    for thread in loading:
        thread.join()
    assert module._compiled is not None
    assert np.array_equal(fingerprint([state]), before)
    assert np.array_equal(while_loading, before)


_SHAPES = st.tuples(st.integers(1, 4), st.integers(1, 40), st.lists(st.integers(1, 90), min_size=1, max_size=4))


@given(_SHAPES, st.sampled_from([np.float32, np.float64]), st.integers(0, 2**32 - 1))
def test_compiled_as_numpy(shape: tuple[int, int, list[int]], dtype: Any, seed: int) -> None:
    """Give the same bits by machine code and by numpy, of fields of any width and of any bits."""
    from gpusimbench.schemas.compiled import hash_loop

    steps, envs, widths = shape
    rng = np.random.default_rng(seed)
    size = np.dtype(dtype).itemsize
    fields = [rng.bytes(steps * envs * width * size) for width in widths]
    arrays = [np.frombuffer(f, dtype).reshape(steps, envs, w, 1) for f, w in zip(fields, widths, strict=True)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_compiled", None)
        by_numpy = fingerprint(arrays)
        patch.setattr(module, "_compiled", hash_loop())
        assert np.array_equal(fingerprint(arrays), by_numpy)


@pytest.mark.usefixtures("nothing_expected")
def test_hashes_without_numba(monkeypatch: pytest.MonkeyPatch) -> None:
    """Go on with numpy where numba is not installed, as in the Pythons of some engines."""
    monkeypatch.setitem(sys.modules, "numba", None)
    monkeypatch.delitem(sys.modules, "gpusimbench.schemas.compiled", raising=False)
    expect(COMPILED_BYTES)
    assert module._compiled is None
    assert fingerprint([np.ones((1, 1), dtype=np.float32)]).shape == ()


_HASH_MANY = """
import threading
import numpy as np
from gpusimbench.schemas import action_generator, fingerprint

fingerprint.COMPILED_BYTES = 1000
states = np.random.default_rng(5).standard_normal((3, 50, 5, 1))
by_numpy = fingerprint.fingerprint([states[:1]]), fingerprint.fingerprint([states])
for thread in threading.enumerate():
    if thread.name == "compiling":
        thread.join()
assert fingerprint._asked and fingerprint._compiled is None
assert (fingerprint.fingerprint([states]) == by_numpy[1]).all()
fingerprint._asked = False
fingerprint.expect(1000)
action_generator.expect(1 << 40)
assert fingerprint._asked and fingerprint._compiled is None and action_generator._fill is None
"""


@pytest.mark.parametrize("broken", ["JIT is off", "import", "cache"])
def test_numba_that_compiles_nothing(broken: str, tmp_path: Path) -> None:
    """Hash by numpy, and say nothing, where numba is not to compile, cannot be imported, or has a damaged cache."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    if broken == "JIT is off":
        environment["NUMBA_DISABLE_JIT"] = "1"
    if broken == "import":  # as numba does beside a version of another package that it does not know
        (tmp_path / "numba.py").write_text("raise AttributeError('coverage.types has no attribute Tracer')")
        environment["PYTHONPATH"] = os.pathsep.join([str(tmp_path), *sys.path])
    if broken == "cache":
        made = "from gpusimbench.schemas.compiled import action_loop, hash_loop; action_loop(), hash_loop()"
        subprocess.run([sys.executable, "-c", made], env=environment, check=True)
        indexes = list((tmp_path / "cache").rglob("*.nbi"))
        assert len(indexes) == 2
        for index in indexes:  # as a disk that was full leaves them
            index.write_bytes(index.read_bytes()[:50])
    done = subprocess.run([sys.executable, "-c", _HASH_MANY], env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


_FORK = """
import os
import numpy as np
from gpusimbench.schemas import fingerprint

fingerprint.COMPILED_BYTES = 10
fingerprint.fingerprint([np.ones((4, 3, 1))])
child = os.fork()
if not child:
    import numba
    os._exit(0)
assert os.waitpid(child, 0)[1] == 0
"""


def test_fork_while_numba_is_loaded() -> None:
    """Let a copy of the process import numba: it would wait for the thread that was loading numba, and lacks it."""
    done = subprocess.run([sys.executable, "-c", _FORK], capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")
