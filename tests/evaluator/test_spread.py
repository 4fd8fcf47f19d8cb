"""How the environments of one run move apart."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs import spread as module
from gpusimbench.evaluator.runs.spread import Spread, spread
from gpusimbench.schemas.errors import DamagedRecording
from tests.synthetic import cubes_field, grid, write_recording

DT = 0.01
RATE = 8.0


def growing(n_env: int, dtype: str = "float64") -> tuple[np.ndarray, Any]:
    """Environments that leave the first one exponentially, each in its own direction: the path and its end."""
    away = np.random.default_rng(0).normal(size=(n_env, 27, 3)) * 1e-7
    away[0] = 0.0

    def path(start: np.ndarray, step: int) -> np.ndarray:
        return np.asarray((start + away * np.exp(RATE * step * DT)).astype(dtype))

    return away, path


def record(folder: Path, *, n_env: int = 5, steps: int = 120, dtype: str = "float64", **keywords: Any) -> Recording:
    """A recording of environments that move apart."""
    away, path = growing(n_env, dtype)
    start = np.zeros((n_env, 27, 3), dtype=dtype)
    final = keywords.pop("final", (start + away).astype(dtype))
    made = write_recording(folder, final, steps=steps, dt=DT, path_of=keywords.pop("path_of", path), **keywords)
    return Recording(made)


def known(recording: Recording) -> Spread:
    """The spread of a recording that has one."""
    found = spread(recording)
    assert isinstance(found, Spread), found
    return found


def by_pairs(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """RMS over all pairs of environments and largest distance from the first, by looking at all pairs."""
    x = np.asarray(recording.state("cubes", "position")).astype(np.float64)
    n_env = x.shape[1]
    one, other = np.triu_indices(n_env, 1)
    apart = np.linalg.norm(x[:, one] - x[:, other], axis=-1)
    from_first = np.linalg.norm(x - x[:, :1], axis=-1)
    return np.sqrt((apart**2).mean(axis=(1, 2))), from_first.max(axis=(1, 2))


@pytest.mark.parametrize("read_bytes", [1, 16 << 20])
def test_same_as_all_pairs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, read_bytes: int) -> None:
    """Give what a look at all pairs gives, whatever is read at a time and wherever blocks end."""
    monkeypatch.setattr(module, "_READ_BYTES", read_bytes)
    recording = record(tmp_path, n_env=70)  # two blocks of environments, three of rows
    found = known(recording)
    rms, largest = by_pairs(recording)
    assert found.steps == tuple(range(121))
    assert np.allclose(np.array(found.rms, dtype=float), rms, rtol=1e-6, atol=1e-15)
    assert np.allclose(np.array(found.largest, dtype=float), largest, rtol=1e-9)
    assert (found.not_finite_from, found.resolution, found.groups, found.n_env) == (None, None, ("cubes",), 70)


def test_rate_is_found(tmp_path: Path) -> None:
    """Fit the rate that the environments were given, within the declared window."""
    found = known(record(tmp_path))
    assert not isinstance(found.fit, Missing)
    assert found.fit.rate == pytest.approx(RATE, rel=0.01)
    assert found.fit.r_squared > 0.99
    inside = [d for d, t in zip(found.largest, found.times, strict=True) if found.fit.begin_s <= t <= found.fit.end_s]
    assert all(d is not None and d < 1e-3 for d in inside)
    assert pickle.loads(pickle.dumps(found)) == found


def test_what_agrees_is_not_read(tmp_path: Path) -> None:
    """Read no row at which all hashes agree, and give exact zeros there."""
    final = np.zeros((3, 27, 3))
    final[1, 4, 0] = 0.25

    def path(start: np.ndarray, step: int) -> np.ndarray:
        x = np.zeros_like(start)
        x[1, 4, 1] = 1e-5 if step == 5 else 0.0
        return x

    recording = record(tmp_path, final=final, steps=6, path_of=path)
    found = known(recording)
    assert found.rows_read == 2
    assert found.largest == (0.0, 0.0, 0.0, 0.0, 0.0, 1e-5, 0.25)
    # one of 27 bodies, in two of three pairs
    assert found.rms[-1] == pytest.approx(0.25 * np.sqrt(2 / 3 / 27))


def test_identical_environments(tmp_path: Path) -> None:
    """Say that nothing moved apart, with zeros that are exact."""
    final = np.repeat(np.random.default_rng(0).uniform(size=(1, 27, 3)), 4, axis=0)
    found = known(record(tmp_path, final=final, steps=10, path_of=None))
    assert set(found.rms) == set(found.largest) == {0.0}
    assert found.fit == Missing("nothing moved apart")


def test_long_recordings_are_thinned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Take every k-th row of a long recording."""
    monkeypatch.setattr(module, "MAX_STEPS", 30)
    found = known(record(tmp_path))
    assert found.steps == tuple(range(0, 121, 5))
    rms, _ = by_pairs(Recording(next(tmp_path.glob("*.mcap"))))
    assert np.allclose(np.array(found.rms, dtype=float), rms[::5], rtol=1e-6, atol=1e-15)


def test_strides_are_steps(tmp_path: Path) -> None:
    """Name steps of the simulator, not rows."""
    found = known(record(tmp_path, steps=20, stride=2, final=np.zeros((3, 27, 3)), path_of=None))
    assert found.steps[:3] == (0, 2, 4)
    assert found.times[1] == pytest.approx(2 * DT)


def test_origins_are_no_distance(tmp_path: Path) -> None:
    """Take what float32 makes of one place at another origin for no distance, and what is beyond for one."""
    origins = ((0.0, 0.0, 0.0), (100.0, 0.0, 0.0), (0.0, 200.0, 0.0))
    at = np.array(origins)[:, None, :]
    local = np.random.default_rng(0).uniform(0.05, 1.0, size=(1, 27, 3))  # above the board

    def path(start: np.ndarray, step: int) -> np.ndarray:
        return np.asarray((local + at).astype(np.float32))

    moved = local + at
    moved[2, 3, 1] += 0.01
    found = known(
        record(tmp_path, dtype="float32", steps=4, origins=origins, path_of=path, final=moved.astype(np.float32))
    )
    assert found.largest[1:4] == (0.0, 0.0, 0.0)
    assert found.largest[4] == pytest.approx(0.01, abs=2e-5)
    assert found.resolution == np.spacing(np.float32(200.0))


def test_numbers_that_are_not_finite(tmp_path: Path) -> None:
    """Name the first step with NaN, and go on with what is there."""

    def path(start: np.ndarray, step: int) -> np.ndarray:
        x = np.zeros_like(start)
        x[1, 0, 0] = np.nan if step == 3 else step * 1e-5
        return x

    found = known(record(tmp_path, final=np.zeros((3, 27, 3)), steps=5, path_of=path))
    assert (found.not_finite_from, found.largest[3], found.rms[3]) == (3, None, None)
    assert found.largest[4] == pytest.approx(4e-5)
    assert not found.fit


def test_reasons(tmp_path: Path) -> None:
    """Give a reason where there is nothing to follow."""
    for name, keywords, why in (
        ("one", {"final": np.zeros((1, 27, 3)), "steps": 3, "path_of": None}, "two environments"),
        ("none", {"final": None, "n_env": 3}, "no states were recorded"),
    ):
        (tmp_path / name).mkdir()
        assert why in spread(Recording(write_recording(tmp_path / name, **keywords))).reason


@pytest.mark.parametrize("scene", ["inclined-collision", "free-fall"])
def test_refuses_positions_in_other_units(scene: str, tmp_path: Path) -> None:
    """Refuse positions that are in no unit of the format, on a board and without one."""

    def change(attachment: str, record: dict[str, Any]) -> None:
        for field in record.get("fields", ()):
            field["unit"] = "cm"

    made = write_recording(tmp_path, np.zeros((3, 27, 3)), scene=scene, change=change, field=cubes_field("float64"))
    with pytest.raises(DamagedRecording, match="is in cm"):
        spread(Recording(made))


def test_bodies_that_fell_off_are_in_no_distance(tmp_path: Path) -> None:
    """Measure cubes on the board, as gsb-diff does, not those that fell, in any environment; all if all fell."""

    def falling(*which: tuple[int, slice]) -> Callable[[np.ndarray, int], np.ndarray]:
        def path(_: np.ndarray, step: int) -> np.ndarray:
            x = grid(3)
            x[1, 4, 0] += 1e-8 * np.exp(9.0 * step * 0.02)
            for env, bodies in which:
                x[env, bodies, 2] -= 4.905 * (step * 0.02) ** 2 if step > 5 else 0.0
            return x

        return path

    fell = ((0, slice(2, 3)), (1, slice(7, 8)))
    everything = [(env, slice(0, 27)) for env in range(3)]
    but_one = [(0, slice(0, 27)), (1, slice(0, 26)), (2, slice(0, 27))]
    for name, which in (("some", fell), ("none", ()), ("all", everything), ("but one", but_one)):
        (tmp_path / name).mkdir()
        path = falling(*which)
        write_recording(tmp_path / name, path(grid(3), 60), steps=60, dt=0.02, path_of=path)
    some, none, all_fell, one_left = (
        known(Recording(next((tmp_path / name).glob("*")))) for name in ("some", "none", "all", "but one")
    )
    assert (some.fallen, none.fallen, all_fell.fallen) == (2, 0, 3 * 27)
    assert some.largest[-1] == none.largest[-1] == all_fell.largest[-1] == pytest.approx(1e-8 * np.exp(10.8), rel=1e-4)
    # the one body on the board has none to be compared with: what fell is measured, and not called equal
    assert one_left.fallen == 3 * 27 - 1
    assert one_left.largest[-1] == pytest.approx(4.905 * 1.2**2, rel=1e-4)
    assert one_left.rms[-1]
    assert some.fit
    assert some.fit.rate == pytest.approx(9.0, rel=1e-4)
    # 25 bodies are on the board in three environments, two in two
    pairs = 25 * 3 + 2
    assert some.rms[-1] == pytest.approx(some.largest[-1] * np.sqrt(2 / pairs))
    assert none.rms[-1] == pytest.approx(none.largest[-1] * np.sqrt(2 / (27 * 3)))


def test_rounding_makes_no_negative_square(tmp_path: Path) -> None:
    """Tell no distance between bodies that lie at one place, wherever the one that fell in environment 0 is."""
    n_env, away = 7, np.random.default_rng(3).uniform(0.01, 0.1, size=12)

    for number, x in enumerate(away):

        def path(_: np.ndarray, step: int, x: float = x) -> np.ndarray:
            positions = grid(n_env)
            positions[1:, 4] += x * min(1.0, step / 60)
            positions[0, 4, 2] -= 4.905 * (step * 0.02) ** 2
            return positions

        folder = tmp_path / str(number)
        folder.mkdir()
        found = known(Recording(write_recording(folder, path(grid(n_env), 60), steps=60, dt=0.02, path_of=path)))
        assert (found.fallen, found.largest[-1]) == (1, 0.0)
        assert found.rms[-1] == pytest.approx(0.0, abs=1e-6)


def test_fallen_bodies_are_left_out_wherever_blocks_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the same distances, whatever is read at a time."""
    falls = np.random.default_rng(2).uniform(size=(70, 27)) < 0.05

    def path(_: np.ndarray, step: int) -> np.ndarray:
        x = grid(70) + np.random.default_rng(1).normal(size=(70, 27, 3)) * 1e-6 * step
        x[falls, 2] -= 4.905 * (step * 0.02) ** 2
        return x

    recording = Recording(write_recording(tmp_path, path(grid(70), 60), steps=60, dt=0.02, path_of=path))
    whole = known(recording)
    monkeypatch.setattr(module, "_READ_BYTES", 1)
    parts = known(recording)
    assert whole.fallen == parts.fallen == falls.sum()
    assert whole.largest == parts.largest
    assert parts.rms == pytest.approx(whole.rms)
    on_board = ~(falls | falls[0])
    x = np.asarray(recording.state("cubes", "position")).astype(np.float64)[-1]
    assert whole.largest[-1] == pytest.approx(np.linalg.norm(x - x[0], axis=-1)[on_board].max())
