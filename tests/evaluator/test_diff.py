"""Recordings held against each other: a difference is found where it was put, and nowhere else."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from gpusimbench.evaluator.cli.diff import main as diff_command
from gpusimbench.evaluator.diff.brief import both_of, reached, verdict_of
from gpusimbench.evaluator.diff.common import CommonField
from gpusimbench.evaluator.diff.compare import compare, compare_all_envs, compare_envs
from gpusimbench.evaluator.diff.numbers import Pairing
from gpusimbench.evaluator.diff.result import Basis, Change, Difference, DiffVerdict, StepRange
from gpusimbench.evaluator.diff.words import amount
from gpusimbench.evaluator.inputs.reader import read_run
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.results.details import Equality
from gpusimbench.evaluator.results.evaluate import evaluate
from gpusimbench.evaluator.results.group_runs import GroupRuns
from gpusimbench.evaluator.results.identity_metrics import EQUALITY_RUNS
from gpusimbench.recorder.capture import state_work as capture
from gpusimbench.recorder.capture.states import StateWriter
from gpusimbench.schemas.errors import DamagedRecording, NothingComparable, UsageError
from gpusimbench.schemas.fields import body_field
from tests import synthetic
from tests.synthetic import Shown, cubes_field, grid, write_recording

ROOT = Path(__file__).resolve().parents[2]
H200 = ROOT / "recordings" / "h200"
SWEEPS = ROOT / "recordings" / "sweeps-h100"
STEPS = 8

Path3 = Callable[[int], NDArray[Any]]


def record(folder: Path, at: Path3, *, steps: int = STEPS, dt: float = 0.01, **keywords: Any) -> Recording:
    """A recording whose cubes are at `at(step)` [m], [env, 27, 3], from step 1 on."""
    return Recording(
        write_recording(folder, at(steps), steps=steps, dt=dt, path_of=lambda _, step: at(step), **keywords)
    )


def still(n_env: int = 3, dtype: str = "float32") -> Path3:
    """Cubes that move by the same centimetre in every environment at every step."""
    return lambda step: (grid(n_env, dtype) + np.array(step * 0.01, dtype)).astype(dtype)


def changed(base: Path3, since: int, change: Callable[[NDArray[Any]], None]) -> Path3:
    """The same with a change in place from a step on."""

    def at(step: int) -> NDArray[Any]:
        positions = base(step).copy()
        if step >= since:
            change(positions)
        return positions

    return at


def put(value: float, *where: int) -> Callable[[NDArray[Any]], None]:
    """Replace a number."""

    def change(states: NDArray[Any]) -> None:
        states[where] = value

    return change


def by_ulps(count: int, *where: int) -> Callable[[NDArray[Any]], None]:
    """Move a number by so many units in the last place."""

    def change(positions: NDArray[Any]) -> None:
        word = positions.view(f"<i{positions.dtype.itemsize}")
        word[where] += count

    return change


@settings(max_examples=25)
@given(
    since=st.integers(1, STEPS),
    where=st.tuples(st.integers(0, 2), st.integers(0, 26), st.integers(0, 2)),
    count=st.integers(-3, 3).filter(bool),
    dtype=st.sampled_from(["float32", "float64"]),
    stride=st.sampled_from([1, 4]),
)
def test_a_difference_is_found_where_it_was_put(
    since: int, where: tuple[int, int, int], count: int, dtype: str, stride: int
) -> None:
    """Find step, environment, body, component and ULPs of one changed number, also between recorded states."""
    env, item, component = where
    with tempfile.TemporaryDirectory() as folder:
        a = record(Path(folder), still(dtype=dtype), stride=stride)
        b = record(Path(folder), changed(still(dtype=dtype), since, by_ulps(count, *where)), stride=stride)
        found = compare(a, b)
        expected = a.state("cubes", "position").at_step(-(-since // stride) * stride)[where]
    first = found.first
    assert (first.step_a, first.step_b, first.after_step, first.envs) == (since, since, since - 1, 1)
    assert (first.env_a, first.env_b, first.time) == (env, env, pytest.approx(since * 0.01))
    assert first.state.step == -(-since // stride) * stride
    assert first.located == (since % stride == 0)
    number = first.state.number
    assert (number.item, number.component) == (cubes_field(dtype).items[item], "xyz"[component])
    assert (number.ulp, number.a) == (abs(count), str(expected))
    assert number.hex_a == f"0x{int(expected.view(f'u{expected.itemsize}')):0{2 * expected.itemsize}x}"
    assert first.state.items == (number.item,)
    assert (found.max_ulp, found.bit_identical, found.verdict) == (abs(count), False, DiffVerdict.DIFFERENT)
    assert found.splits.agreeing == (Change(0, 3), Change(since, 2))
    assert found.splits.classes_b == tuple(1 if e == env else 0 for e in range(3))


def test_opposite_signs_are_named_and_not_counted(tmp_path: Path) -> None:
    """Say that signs differ, and both numbers: the numbers in between say nothing. JSON has their count."""
    base = changed(still(), 0, put(0.25, 1, 0, 0))
    found = compare(record(tmp_path, base), record(tmp_path, changed(base, 3, put(-0.25, 1, 0, 0)), run=1))
    assert found.first is not None and found.first.state is not None
    number = found.first.state.number
    assert number.ulp is not None and number.ulp > 10**9
    assert "the signs differ (0.25 and -0.25), 50 cm" in verdict_of(found).text
    assert both_of(number).endswith(": the signs differ, 50 cm")
    assert (found.signs_differ, found.compared.fields[0].signs_from) == (True, 3)
    near = compare(record(tmp_path, base, run=2), record(tmp_path, changed(base, 3, by_ulps(2, 1, 0, 0)), run=3))
    assert (near.signs_differ, near.compared.fields[0].signs_from) == (False, None)


@pytest.mark.parametrize("value", [2.0, -2.0, 1e-3])
def test_a_number_against_zero(tmp_path: Path, value: float) -> None:
    """Say that one is zero, and the distance: all numbers down to zero, which JSON counts, tell nothing."""
    base = changed(still(), 0, put(value, 1, 0, 0))
    found = compare(record(tmp_path, base), record(tmp_path, changed(base, 3, put(0, 1, 0, 0)), run=1))
    assert found.first is not None and found.first.state is not None
    number = found.first.state.number
    assert number.ulp is not None and number.ulp > 10**8
    distance = amount(abs(value), "m")
    assert f"one is zero ({number.a} and 0.0), {distance}" in verdict_of(found).text
    assert both_of(number).endswith(f": one is zero, {distance}")


def test_equal_recordings_are_equal(tmp_path: Path) -> None:
    """Find nothing between two runs of the same numbers, and say over what."""
    found = compare(record(tmp_path, still()), record(tmp_path, still(), run=1))
    assert found.verdict is DiffVerdict.IDENTICAL
    assert (found.bit_identical, found.bitwise, found.same_up_to_env_order) == (True, True, True)
    assert (found.first, found.max_ulp, found.settings, found.copies) == (None, 0, (), False)
    compared = found.compared
    assert compared.state_steps == compared.hash_steps == StepRange(STEPS + 1, 0, STEPS)
    assert (compared.n_env, compared.left_out, compared.fields[0].numbers) == (3, (), 9 * 3 * 27 * 3)
    assert not isinstance(found.growth, Missing)
    assert set(found.growth.max_spatial) == {0.0}
    assert (found.growth.to_1mm, found.growth.fit) == (None, Missing("nothing moved apart"))


def test_recordings_in_which_nothing_moves(tmp_path: Path) -> None:
    """Warn that agreement of two robots at rest says nothing, in gsb-diff and in gsb-eval; not where either moves."""
    moves = record(tmp_path, still())
    start = np.asarray(moves.state("cubes", "position")[0])
    at_rest = [record(tmp_path, lambda _: start) for _ in range(2)]
    (said,) = [note for note in compare(*at_rest).notes if "nothing moves" in note]
    assert said.startswith("nothing moves in a and b: ") and "--initial" in said
    assert [note for note in compare(moves, at_rest[0]).notes if note.startswith("nothing moves in b: ")]
    assert not [note for note in compare(moves, moves).notes if "nothing moves" in note]
    for recording, warned in ((at_rest[0], True), (moves, False)):
        notes = evaluate([read_run(recording, 0.1)]).notes
        assert any("nothing moves" in note for note in notes) is warned


def test_a_copy_is_called_a_copy(tmp_path: Path) -> None:
    """Say that both are recordings of one run."""
    a = record(tmp_path, still(), run_id="one")
    assert compare(a, record(tmp_path, still(), run_id="one")).copies


def test_zeros_and_payloads_are_bits(tmp_path: Path) -> None:
    """Tell -0.0 from 0.0 and NaN from NaN, and count both apart from other differences."""

    def with_numbers(zero: float, nan: int) -> Path3:
        def change(positions: NDArray[Any]) -> None:
            positions[0, 0, 0] = zero
            positions.view("<u4")[1, 1, 1] = nan

        return changed(still(), 2, change)

    a = record(tmp_path, with_numbers(0.0, 0x7FC00000), status="INVALID", reason="a state is not finite")
    found = compare(a, record(tmp_path, with_numbers(-0.0, 0x7FC00005)))
    (field,) = found.compared.fields
    assert (field.different, field.signed_zeros, field.nan_payloads, field.not_finite) == (14, 7, 7, 7)
    assert (found.first.step_a, found.first.state.number.distance, found.max_ulp) == (2, 0.0, 5)
    assert not isinstance(found.growth, Missing)
    assert found.growth.not_finite_from == 2
    assert "invalid" in found.notes[0]
    assert compare(a, a).bit_identical  # the same payload


def test_environments_in_another_order(tmp_path: Path) -> None:
    """See the same trajectories in other environments, and which; no order makes up for another trajectory."""

    def base(step: int) -> NDArray[Any]:
        return (grid(4, "float32") + step * np.array([0, 1, 1, 2], "float32")[:, None, None]).astype("float32")

    a = record(tmp_path, base)
    found = compare(a, record(tmp_path, lambda step: base(step)[[3, 1, 0, 2]]))
    assert (found.bit_identical, found.same_up_to_env_order) == (False, True)
    assert found.splits.classes_a == (0, 1, 1, 2)
    assert found.splits.classes_b == (2, 1, 0, 1)
    assert found.splits.distinct_both == (Change(0, 1), Change(1, 3))
    other = compare(a, record(tmp_path, lambda step: base(step)[[3, 0, 0, 1]]))
    assert other.same_up_to_env_order is False


def test_trajectories_that_meet_again(tmp_path: Path) -> None:
    """Keep apart what was once different, although the last states are equal."""

    def base(step: int) -> NDArray[Any]:
        positions = still(2)(step)
        positions[1, 5, 2] += step == 3
        return positions

    found = compare_all_envs(record(tmp_path, base, stride=4))
    splits = found.splits
    assert splits.distinct_both == (Change(0, 1), Change(3, 2), Change(4, 1))
    assert ((splits.classes_a, splits.classes_b), (splits.last_a, splits.last_b)) == (((0,), (1,)), ((0,), (0,)))
    assert (found.first.step_a, found.first.state, found.max_ulp) == (3, None, 0)


def test_two_environments_and_all(tmp_path: Path) -> None:
    """Compare two chosen environments, one of each file, and all with the first."""
    a = record(tmp_path, changed(still(4), 5, by_ulps(2, 3, 1, 0)))
    assert compare_envs(a, 0, 2).bit_identical
    pair = compare_envs(a, 1, 3)
    assert (pair.first.env_a, pair.first.env_b, pair.max_ulp) == (1, 3, 2)
    everything = compare_all_envs(a)
    assert (everything.first.step_a, everything.first.env_a, everything.first.env_b) == (5, 0, 3)
    assert (everything.compared.n_env, everything.first.envs) == (3, 1)
    b = record(tmp_path, still(4))
    assert compare(a, b, envs=(2, 1)).bit_identical
    assert compare(a, b, envs=(3, 3)).max_ulp == 2


def test_origins_are_no_difference(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compare environments at other origins without them, beyond what float32 can tell there."""
    origins = ((0.0, 0.0, 0.0), (60.0, -8.0, 0.0), (0.1, 900.0, 0.0))

    def nowhere(step: int) -> NDArray[Any]:
        return (grid(3) + step * 0.0123).astype("float32")

    def base(step: int) -> NDArray[Any]:
        return (grid(3) + step * 0.0123 + np.array(origins)[:, None, :]).astype("float32")

    initial = [base(0)]

    class Placed(StateWriter):
        """Writes an initial state that has the origins in it, which the synthetic one has not."""

        def feed(self, arrays: Any) -> str | None:
            return super().feed(arrays if self.last_step >= 0 else [initial[-1][np.newaxis]])

    monkeypatch.setattr(synthetic, "StateWriter", Placed)
    a = record(tmp_path, base, origins=origins)
    found = compare_all_envs(a)
    assert (found.verdict, found.bitwise, found.bit_identical) == (DiffVerdict.WITHIN_RESOLUTION, False, False)
    assert (found.max_ulp, found.same_up_to_env_order, found.compared.hash_steps) == (None, None, None)
    assert "origins" in found.splits.classes_missing
    assert not isinstance(found.growth, Missing)
    assert set(found.growth.max_spatial) == {0.0}

    b = record(tmp_path, changed(base, 2, lambda p: p[2, 7, 1:2].__iadd__(0.002)), origins=origins)
    first = compare_all_envs(b).first
    assert (first.step_a, first.env_b, first.state.items) == (2, 2, (cubes_field("float32").items[7],))
    assert first.state.number.distance == pytest.approx(0.002, abs=1e-4)
    assert first.state.number.resolution == pytest.approx(float(np.spacing(np.float32(900))))
    assert first.state.number.ulp is None
    # the same origins on both sides: bits count, but an environment cannot be held against another
    between = compare(a, b)
    assert between.bitwise
    assert between.splits.agreeing == (Change(0, 3), Change(2, 2))
    assert between.splits.classes_a is between.same_up_to_env_order is None
    # other origins in the other recording
    initial.append(nowhere(0))
    c = record(tmp_path, nowhere)
    assert compare(c, a).verdict is compare(a, c).verdict is DiffVerdict.WITHIN_RESOLUTION
    assert compare(c, b).first is not None
    assert compare_all_envs(c).bit_identical


def test_float32_and_float64(tmp_path: Path) -> None:
    """Compare two precisions by what float32 can tell, never by bits."""
    a, b = record(tmp_path, still()), record(tmp_path, lambda step: still()(step).astype("float64"))
    found = compare(a, b)
    assert (found.verdict, found.max_ulp, found.bit_identical) == (DiffVerdict.WITHIN_RESOLUTION, 0, False)
    assert found.compared.fields[0].basis is Basis.FLOAT32
    assert "float32" in found.notes[0]
    assert {"state.cubes/position"} <= {s.name for s in found.settings}

    def moved(step: int) -> NDArray[Any]:
        return changed(lambda s: still()(s).astype("float64"), 6, lambda p: p[1, 2].__iadd__(1e-3))(step)

    first = compare(a, record(tmp_path, moved)).first
    assert (first.step_a, first.env_a, first.state.number.component) == (6, 1, "x")
    assert first.state.number.distance == pytest.approx(1e-3, rel=1e-3)


def test_time_steps_of_a_ratio(tmp_path: Path) -> None:
    """Compare states of the same simulated time where the steps are of another length."""
    a = record(tmp_path, still(), dt=0.02)
    b = record(tmp_path, lambda step: still()(step // 2), dt=0.01, steps=2 * STEPS)
    found = compare(a, b)
    assert found.bit_identical
    assert found.compared.state_steps == StepRange(STEPS + 1, 0, STEPS)
    assert "dt" in {s.name for s in found.settings}
    late = compare(a, record(tmp_path, changed(lambda s: still()(s // 2), 10, by_ulps(1, 0, 0, 0)), dt=0.01, steps=16))
    assert (late.first.step_a, late.first.step_b, late.first.time) == (5, 10, 0.1)
    with pytest.raises(NothingComparable, match="simulated times"):
        compare(a, record(tmp_path, still(), dt=0.02 * np.pi))


def test_what_is_common_is_compared(tmp_path: Path) -> None:
    """Compare common environments, steps and bodies, by name, and say what is left out."""
    a = record(tmp_path, still(2), stride=2, steps=12)
    b = record(tmp_path, still(5), stride=4)
    found = compare(a, b)
    assert found.bit_identical
    assert found.compared.state_steps == StepRange(3, 0, 8)
    assert found.compared.hash_steps == StepRange(9, 0, 8)
    assert found.compared.left_out == (
        "environments from 2 on: a has 2, b has 5",
        "states of a after its step 8, up to 12",
    )
    assert found.same_up_to_env_order is None
    field = cubes_field("float32")
    names = (*field.items[1:], "another")
    other = record(tmp_path, lambda step: np.roll(still(2)(step), -1, axis=1), field=replace(field, items=names))
    found = compare(a, other)
    assert found.compared.left_out[0] == "cubes/position: 26 items in common, of 27 in a, 27 in b"
    assert "different items" in found.compared.hash_steps_missing
    assert "state.cubes/position.items" in {s.name for s in found.settings}
    # the scene's initial state is in the order of its own names
    assert (found.first.step_a, found.compared.fields[0].numbers) == (0, 2 * 26 * 3 * 5)
    assert [f.first_step for f in compare(a, record(tmp_path, still(2))).compared.fields] == [None]


def test_an_exponential_is_measured(tmp_path: Path) -> None:
    """Return rate, window and times of a planted exponential growth."""

    def grown(step: int) -> NDArray[Any]:
        positions = grid(2)
        if step >= 10:
            positions[1, 4, 0] += 1e-8 * np.exp(9.0 * (step - 10) * 0.02)
        return positions

    a, b = record(tmp_path, lambda _: grid(2), steps=100, dt=0.02), record(tmp_path, grown, steps=100, dt=0.02)
    growth = compare(a, b).growth
    assert not isinstance(growth, Missing)
    assert growth.fit
    assert growth.fit.rate == pytest.approx(9.0, rel=1e-4)
    assert growth.fit.r_squared == pytest.approx(1, abs=1e-6)
    assert (growth.fit.begin_s, growth.fit.n_point) == (pytest.approx(0.2), 64)
    assert growth.to_1mm == pytest.approx(0.2 + 0.02 * np.ceil(np.log(1e5) / 9 / 0.02))
    assert growth.to_1cm == pytest.approx(0.2 + 0.02 * np.ceil(np.log(1e6) / 9 / 0.02))
    assert growth.median_spatial[50] == 0
    assert growth.max_planar[50] == pytest.approx(1e-8 * np.exp(9 * 0.8), rel=1e-4)


def test_bodies_that_fell_off_are_in_no_growth(tmp_path: Path) -> None:
    """Measure the growth of cubes on the board, not of those that fell, in a or in b; of all if all fell in the end."""

    def moved(side: int, fall: slice) -> Path3:
        def at(step: int) -> NDArray[Any]:
            positions = grid(2)
            if side and step >= 10:
                positions[1, 4, 0] += 1e-8 * np.exp(9.0 * (step - 10) * 0.02)
            if step >= 5:
                positions[:, fall] += (0.8e-3 * side, 0.0, -4.905 * (step * 0.02) ** 2)
            return positions

        return at

    a, b = (record(tmp_path, moved(side, slice(7, 8)), steps=60, dt=0.02) for side in (0, 1))
    growth = compare(a, b).growth
    assert growth
    assert growth.fit
    assert (growth.fallen, growth.fit.rate, growth.to_1mm) == (2, pytest.approx(9.0, rel=1e-4), None)
    assert reached(growth) == ["1 mm never reached on the board", "1 cm never reached on the board"]
    assert growth.max_spatial[60] == pytest.approx(0.8e-3, rel=1e-4)
    assert growth.largest[60] == growth.max_not_fallen[60] == pytest.approx(1e-8 * np.exp(9), rel=1e-4)

    a, c = (record(tmp_path, moved(side, slice(27 * side)), steps=60, dt=0.02) for side in (0, 1))
    growth = compare(a, c).growth
    assert growth
    assert (growth.fallen, growth.max_not_fallen) == (54, ())
    assert growth.largest == growth.max_spatial


def test_contacts_at_the_divergence(tmp_path: Path) -> None:
    """Show the counters of both at the first differing step."""
    counts = [Shown({"capture": {"contacts": np.arange(STEPS * 3).reshape(STEPS, 3) + more}}) for more in (0, 6)]
    a = record(tmp_path, still(), shown=counts[0])
    first = compare(a, record(tmp_path, changed(still(), 4, by_ulps(1, 0, 0, 0)), shown=counts[1])).first
    assert (first.contacts_a.mean, first.contacts_a.max) == (10, 11)
    assert (first.contacts_b.mean, first.contacts_b.max) == (16, 17)


def test_settings_that_differ_are_listed(tmp_path: Path) -> None:
    """Name options, switches and versions that the two do not share, and nothing that belongs to a run."""
    a = record(tmp_path, still(), options={"iterations": 10, "cone": "elliptic"}, run=0)
    b = record(tmp_path, still(), options={"iterations": 20}, environment={"XLA_FLAGS": "x" * 1000}, run=1)
    found = {s.name: (s.a, s.b) for s in compare(a, b).settings}
    assert found["engine.iterations"] == ("10", "20")
    assert found["engine.cone"] == ("elliptic", "(unset)")
    assert found.keys() == {
        "engine.iterations", "engine.cone", "options.iterations", "options.cone", "environment.XLA_FLAGS",
    }  # fmt: skip
    assert len(found["environment.XLA_FLAGS"][1]) < 250


def test_what_was_lost_is_said(tmp_path: Path) -> None:
    """Compare what a cut-short recording has, and say that it is."""
    cut = record(tmp_path, still(), end=False)
    found = compare(record(tmp_path, still()), cut)
    assert found.bit_identical
    assert len(found.lost) == 1
    assert "no end record" in found.lost[0]
    assert "lost data" in compare(cut, record(tmp_path, still(), dropout="disk full")).lost[1]


def test_each_field_is_compared_over_its_own_steps(tmp_path: Path) -> None:
    """Compare what a file that was cut within a block has of each field, and say what it lacks."""
    whole = ROOT / "recordings" / "mujoco-pyramidal-r0.mcap"
    data = whole.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[:300000])
    cut = Recording(tmp_path / "cut.mcap")
    ends = {f.name: int(cut.state(f.group, f.field).steps[-1]) for f in cut.fields}
    assert set(ends.values()) == {50, 100}  # in the middle of a block
    found = compare(Recording(whole), cut)
    assert found.bit_identical
    assert found.compared.state_steps == StepRange(101, 0, 100)
    for f, field in zip(found.compared.fields, cut.fields, strict=True):
        assert f.numbers == (ends[f.field] + 1) * 16 * len(field.items) * field.width
    lacking = [name for name, end in ends.items() if end == 50]
    assert f"states of a of {', '.join(lacking)} after its step 50, up to 500" in found.compared.left_out
    other = compare(Recording(ROOT / "recordings" / "mujoco-xeon-r0.mcap"), cut)
    assert not other.bit_identical
    assert [f.different > 0 for f in other.compared.fields] == [True] * len(ends)


def test_distances_that_are_not_finite(tmp_path: Path) -> None:
    """Give no distance where one side is NaN, in place of zero, and the largest finite one where there is any."""

    def with_nan(positions: NDArray[Any]) -> None:
        positions[0, 0, 0] = np.nan

    def and_moved(positions: NDArray[Any]) -> None:
        positions[0, 0, 0] = np.nan
        positions[1, 2, 1] += 0.5

    a = record(tmp_path, still())
    found = compare(a, record(tmp_path, changed(still(), 5, with_nan)))
    assert [(f.different, f.max_distance) for f in found.compared.fields] == [(STEPS - 4, None)]
    assert not isinstance(found.growth, Missing)
    assert (found.growth.not_finite_from, found.growth.fit) == (5, Missing("no finite positions moved apart"))
    (field,) = compare(a, record(tmp_path, changed(still(), 5, and_moved))).compared.fields
    assert field.max_distance == pytest.approx(0.5, rel=1e-6)


def test_nothing_in_common(tmp_path: Path) -> None:
    """Refuse what cannot be compared: no states, no fields, no other environment, none of that number."""
    a = record(tmp_path, still(2))
    with pytest.raises(NothingComparable, match="no recorded state"):
        compare(a, Recording(write_recording(tmp_path, None, n_env=2)))
    with pytest.raises(NothingComparable, match="no state field in common"):
        compare(a, record(tmp_path, still(2), field=replace(cubes_field("float32"), unit="cm")))
    with pytest.raises(NothingComparable, match="one environment"):
        compare_all_envs(record(tmp_path, still(1)))
    with pytest.raises(UsageError, match="no environment 2: it has 0 to 1"):
        compare_envs(a, 0, 2)
    with pytest.raises(UsageError, match="two different environments"):
        compare_envs(a, 1, 1)


def test_hashes_that_are_wrong_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse hashes that call states different which are not."""
    a = record(tmp_path, still())
    right = capture.fingerprint
    monkeypatch.setattr(capture, "fingerprint", lambda arrays: right(arrays) ^ np.uint64(1))
    with pytest.raises(DamagedRecording, match="state hashes at step 0 are not those of the states"):
        compare(a, record(tmp_path, still()))


def test_blocks_of_many_environments(tmp_path: Path) -> None:
    """Find one number among environments and steps that need several reads and several blocks."""
    since, env = 120, 150
    a = record(tmp_path, still(160), steps=130, compression="zstd")
    b = record(tmp_path, changed(still(160), since, by_ulps(-1, env, 26, 2)), steps=130, compression="zstd")
    found = compare(a, b)
    assert (found.first.step_a, found.first.env_a, found.max_ulp) == (since, env, 1)
    assert found.compared.fields[0].different == 11
    assert found.splits.distinct_both == (Change(0, 1), Change(since, 2))


def h200(name: str) -> Recording:
    """A shipped recording."""
    return Recording(H200 / f"{name}.mcap")


@pytest.mark.parametrize(
    ("name", "step", "classes"),
    [
        ("genesis-inclined-collision-n16-r0", None, 1),
        ("calibration-identical-inclined-collision-n16-r0", None, 1),
        ("calibration-atomics-inclined-collision-n16-r0", 5, 16),
        ("isaaclab-ovphysx-spacing-0-inclined-collision-n16-r0", 1, 4),
    ],
)
def test_environments_of_shipped_recordings(name: str, step: int | None, classes: int) -> None:
    """Find the classes of environments of engines whose regimes are known."""
    found: Difference = compare_all_envs(h200(name))
    assert (found.first.step_a if found.first else None) == step
    assert found.splits.distinct_both[-1].count == classes


def test_shipped_runs_by_hashes() -> None:
    """Date the first difference of two runs to a step whose state was not recorded, from their hashes."""
    found = compare(h200("warp-inclined-collision-n16-r0"), h200("warp-inclined-collision-n16-r1"))
    assert (found.first.step_a, found.first.by_hashes, found.first.located) == (2, True, False)
    assert found.first.state.step == 250


def test_runs_without_states() -> None:
    """Compare the hashes of the timed phase where no states were captured."""
    found = compare(
        Recording(SWEEPS / "genesis-franka-n512-r0.mcap"), Recording(SWEEPS / "genesis-franka-n512-r1.mcap")
    )
    assert (found.bit_identical, found.max_ulp, found.growth) == (
        True, None, Missing("no positions of bodies were recorded by both")
    )  # fmt: skip
    assert (found.compared.state_steps, found.compared.hash_steps) == (None, StepRange(2, 100, 200))
    assert "timed phase" in found.notes[0]


def both_kinds(positions: NDArray[Any]) -> NDArray[Any]:
    """Every environment and body with numbers of its own."""
    numbers = np.arange(positions[..., 0].size).reshape(positions.shape[:2])
    return np.asarray(positions + 1e-3 * numbers[..., np.newaxis].astype(positions.dtype), positions.dtype)


@pytest.mark.parametrize(
    ("envs", "bodies", "same", "said"),
    [
        (None, "each", (False, True, False), "equal up to the order of bodies"),
        ((2, 0, 1), None, (True, None, False), "equal up to the order of environments"),
        (
            (2, 0, 1),
            "each",
            (False, True, True),
            "equal up to the order of environments and bodies",
        ),
        (None, "one more", (False, False, False), ""),
        ((2, 0, 1), "one more", (False, False, False), ""),
    ],
)
def test_another_order_is_recognised(
    envs: tuple[int, ...] | None,
    bodies: str | None,
    same: tuple[bool | None, ...],
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Say that bodies, environments or both are the same ones in another order, by gsb-diff and by gsb-eval alike."""
    rng = np.random.default_rng(0)
    orders = np.array([rng.permutation(27) for _ in range(3)])

    def at(step: int) -> NDArray[Any]:
        return both_kinds(still()(step))

    def other(step: int) -> NDArray[Any]:
        found = at(step)
        if bodies:
            found = np.take_along_axis(found, orders[:, :, np.newaxis], axis=1)
        found = found[list(envs)] if envs else found
        if bodies == "one more" and step > 5:
            by_ulps(1, 1, 7, 2)(found)
        return found

    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    a = record(tmp_path / "a", at, run=0, whole=True)
    b = record(tmp_path / "b", other, run=1, whole=True)
    found = compare(a, b)
    assert found.verdict is DiffVerdict.DIFFERENT
    assert (found.same_up_to_env_order, found.same_up_to_body_order, found.bodies_of_other_envs) == same
    assert diff_command([str(a.path), str(b.path)]) == 4
    assert (said or "The two recordings differ from step 1 ") in " ".join(capsys.readouterr().out.split())
    assert ("up to the order" in said) is bool(said)
    metric = EQUALITY_RUNS.estimate(GroupRuns([read_run(r, 0.08) for r in (a, b)]))
    assert metric.of(Equality).text == (said.split(",")[0] if said else "different")


def turned(folder: Path, sign: int, change: Callable[[NDArray[Any]], None] | None = None) -> Recording:
    """A recording of rotations alone, every number of which has a sign."""
    q = np.random.default_rng(1).normal(size=(2, 27, 4))
    q = (q / np.linalg.norm(q, axis=-1, keepdims=True)).astype(np.float32)
    q[0, 0] = [1, 0, 0, 0]
    q *= np.float32(sign)
    if change:
        change(q)
    field = body_field("cubes", "orientation", "float32", cubes_field("float32").items)
    return Recording(write_recording(folder, q, field=field, path_of=lambda _, step: q, whole=True))


def test_a_rotation_has_two_signs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Find q and -q no distance apart, and say that it is the same rotation; their bits still differ."""
    for name in "abc":
        (tmp_path / name).mkdir()
    a, b = turned(tmp_path / "a", 1), turned(tmp_path / "b", -1)
    found = compare(a, b)
    (field,) = found.compared.fields
    assert (found.verdict, found.same_rotations) == (DiffVerdict.DIFFERENT, True)
    assert (field.max_distance, field.other_sign) == (0.0, field.different)
    state = found.first.state
    assert (state.number.other_sign, state.number.distance) == (True, 0.0)
    assert diff_command([str(a.path), str(b.path)]) == 4
    shown = " ".join(capsys.readouterr().out.split())
    assert "the same rotations, some as quaternions of the other sign" in shown
    assert "same rotation, other sign" in shown
    near = compare(a, turned(tmp_path / "c", -1, lambda q: by_ulps(3, 1, 5, 2)(q)))
    assert not near.same_rotations
    assert 0 < (near.compared.fields[0].max_distance or 0) < 1e-6


@given(st.lists(st.floats(-1, 1, width=32), min_size=8, max_size=8), st.booleans(), st.booleans())
def test_the_distance_of_rotations_has_no_sign(numbers: list[float], one: bool, other: bool) -> None:
    """Give the same distance whichever sign either quaternion has, at most that of two at right angles."""
    a, b = np.array(numbers, dtype=np.float32).reshape(2, 1, 1, 1, 4)
    zero = np.zeros((1, 1, 4))
    field = body_field("cubes", "orientation", "float32", ("c",))
    index = np.arange(4)
    common = CommonField(field, field, ("c",), field.components, index[:1], index[:1], index, index, Basis.BITS)
    how = Pairing(common, zero, zero)
    apart = np.linalg.norm(how.apart(a, b))
    assert np.linalg.norm(how.apart(-a if one else a, -b if other else b)) == pytest.approx(apart, rel=1e-12)
    longest = np.linalg.norm(a.astype(np.float64)) ** 2 + np.linalg.norm(b.astype(np.float64)) ** 2
    assert apart**2 <= longest * (1 + 1e-6)
