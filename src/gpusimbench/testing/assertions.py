"""The assertions: two things are the same, an environment repeats itself, and does not mind how many there are."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpusimbench.evaluator.diff.arrays import Rows, compare_arrays
from gpusimbench.evaluator.diff.sections import arrays_document
from gpusimbench.evaluator.render.terminal import print_document
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.trees import leaves, mapped, on_host
from gpusimbench.testing.stepping import drawn_actions, stepped

if TYPE_CHECKING:
    from gpusimbench.evaluator.read.recording import Recording
    from gpusimbench.evaluator.render.document import Document

    Side = str | Path | Recording | Mapping[str, Any] | Sequence[Any]


class Differs(AssertionError):
    """What is raised: the text names the first difference.

    names  of the two sides, for people
    sides  arrays by name, or recordings
    """

    def __init__(self, text: str, names: tuple[str, str], sides: tuple[Any, Any]) -> None:
        super().__init__(text)
        self.names = names
        self.sides = sides


def assert_identical(a: Side, b: Side) -> None:
    """Assert that two recordings, or two sets of arrays, are the same bit for bit.

    a, b  both recordings (paths, addresses or open ones), or both arrays [step, env, ...]: one, or nested in dicts,
          tuples and lists

    Returns nothing. Raises AssertionError that names the first step, environment, array and number that differ, or what
    only one side has; UsageError where a and b are nothing that can be compared, and RecordingError where a file cannot
    be read.
    """
    __tracebackhide__ = True
    kinds = [_is_recording(side) for side in (a, b)]
    if all(kinds):
        _assert_recordings(a, b)
    elif any(kinds):
        raise UsageError("a recording is compared with a recording, and arrays with arrays")
    else:
        _assert_rows(("a", "b"), (_rows(a), _rows(b)))


def assert_deterministic(
    make_env: Callable[[], Any], steps: int, actions: Sequence[Any] | None = None, *, runs: int = 2, seed: int = 0
) -> None:
    """Assert that an environment returns the same bits in each run that begins with the same seed.

    make_env  makes a new environment: a Gymnasium VectorEnv, an Env, or anything with reset(seed) and step(action) that
              returns arrays [env, ...]; it is closed after its run
    steps     of each run
    actions   what step is given, one for each step; None: drawn once from the environment's action_space, with the
              seed, and None where it has no action_space
    runs      how many are compared, each with the first
    seed      that reset is given

    Observations, rewards and ends of episodes are compared, and no infos. All runs are made in this process: what
    differs between processes, such as an order of hashes, is not seen. Returns nothing. Raises AssertionError that
    names the first difference, UsageError where the environment cannot be stepped so.
    """
    __tracebackhide__ = True
    if runs < 2 or steps < 1:
        raise UsageError(f"at least 2 runs of 1 step are compared, not {runs} of {steps}")
    given = None if actions is None else _enough(actions, steps)
    first: dict[str, Rows] = {}
    for run in range(runs):
        env = make_env()
        try:
            given = drawn_actions(env, steps, seed) if given is None else given
            found = stepped(env, given, seed)
        finally:
            _close(env)
        if run:
            _assert_rows(("run 0", f"run {run}"), (first, found))
        else:
            first = found


def assert_batch_invariant(
    make_env: Callable[[int], Any],
    *,
    steps: int,
    numbers: Sequence[int] = (1, 2, 16),
    actions: Sequence[Any] | None = None,
    seed: int = 0,
) -> None:
    """Assert that an environment returns the same bits however many others are simulated beside it.

    make_env  makes n new environments as one: as in assert_deterministic, and reset(seed) gives environment i the same
              start whatever n is, as Gymnasium's vector environments do (seed + i)
    steps     of each run
    numbers   of environments
    actions   what step is given with the largest number, one for each step, arrays [env, ...]; with n environments, the
              first n of them. None: as in assert_deterministic
    seed      that reset is given

    Environments are compared with those of the same number among the most. Returns nothing. Raises as
    assert_deterministic does.
    """
    __tracebackhide__ = True
    counts = sorted(set(numbers))
    if len(counts) < 2 or counts[0] < 1 or steps < 1:
        raise UsageError(f"at least two numbers of environments and 1 step are compared, not {numbers} and {steps}")
    most = counts.pop()
    given = None if actions is None else _enough(actions, steps)
    env = make_env(most)
    try:
        given = drawn_actions(env, steps, seed) if given is None else given
        among = stepped(env, given, seed, n_env=most)
    finally:
        _close(env)
    for n in counts:
        env = make_env(n)
        try:
            found = stepped(env, _of_first(n, given), seed, n_env=n)
        finally:
            _close(env)
        first = {name: Rows(rows.values[:, :n], rows.first) for name, rows in among.items()}
        _assert_rows(_sides(n, most), (found, first))


def _of_first(n: int, actions: Sequence[Any]) -> list[Any]:
    """Actions of the first n environments."""
    return [None if action is None else mapped(lambda array: array[:n], action) for action in actions]


def _sides(n: int, most: int) -> tuple[str, str]:
    if n == 1:
        return "1 env alone", f"the same env among {most}"
    return f"{n} envs", f"the same {n} among {most}"


def _assert_rows(names: tuple[str, str], sides: tuple[dict[str, Rows], dict[str, Rows]]) -> None:
    __tracebackhide__ = True
    found = compare_arrays(*sides, names=names)
    if not found.identical:
        raise Differs(_text(arrays_document(found, names)), names, sides)


def _assert_recordings(a: Any, b: Any) -> None:
    __tracebackhide__ = True
    from gpusimbench.evaluator.diff.compare import compare
    from gpusimbench.evaluator.diff.result import DiffVerdict
    from gpusimbench.evaluator.diff.sections import diff_document
    from gpusimbench.evaluator.runs.validation import verify

    recordings = _opened(a), _opened(b)
    for recording in recordings:
        verify(recording)
    found = compare(*recordings)
    n_env = [recording.configuration.n_env for recording in recordings]
    whole = not (found.compared.left_out or found.lost) and n_env[0] == n_env[1]
    if found.verdict is DiffVerdict.IDENTICAL and whole:
        return
    text = _text(diff_document(found))
    if n_env[0] != n_env[1]:
        text += f"\n  a has {n_env[0]} envs, b has {n_env[1]}"
    raise Differs(text, ("a", "b"), recordings)


def _text(document: Document) -> str:
    written = io.StringIO()
    print_document(document, written)
    return "\n".join(line.rstrip() for line in written.getvalue().splitlines())


def _is_recording(side: Any) -> bool:
    if isinstance(side, (str, Path)):
        return True
    from gpusimbench.evaluator.read.recording import Recording

    return isinstance(side, Recording)


def _opened(side: Any) -> Recording:
    from gpusimbench.evaluator.read.recording import Recording
    from gpusimbench.schemas.location import place

    return side if isinstance(side, Recording) else Recording(place(side))


def _rows(side: Any) -> dict[str, Rows]:
    found = {name: on_host(value, name) for name, value in leaves(side, "")}
    if not found:
        raise UsageError("there is no array to compare")
    for name, array in found.items():
        if array.ndim < 2:
            raise UsageError(f"{name} has shape {array.shape}; arrays are [step, env, ...]")
    return {name: Rows(array) for name, array in found.items()}


def _enough(actions: Sequence[Any], steps: int) -> list[Any]:
    given = list(islice(actions, steps))
    if len(given) < steps:
        raise UsageError(f"{steps} steps need as many actions, and {len(given)} were given")
    return given


def _close(env: Any) -> None:
    if callable(close := getattr(env, "close", None)):
        close()
