"""Gates of a run: which actions the engine holds, and whether states are worth capturing once a gate fired."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.run.given_actions import write_applied
from gpusimbench.recorder.run.journal import Journal
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.schemas import topics
from gpusimbench.schemas.action_generator import Streams
from gpusimbench.schemas.configuration import RunConfiguration

N_ENV, SEED, FIRST, STEPS = 4, 3, 20, 10


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    """Of a recording that is never finished."""
    sink = Sink(tmp_path / "run.mcap", compression="none")
    sink.channel(topics.RUN_EVENT, "gsb.v1.Event")
    yield Journal(sink)
    sink.abandon()


def _given(step: int) -> NDArray[np.float32]:
    """The actions of a step, [env, action]."""
    actions = make_scene("franka").actions
    return actions.draw(SEED, n_env=N_ENV, first_step=step, n_step=1, streams=Streams.usual(N_ENV))[0]


_LAST = _given(FIRST + STEPS - 1)
_ONE_OTHER = _LAST.copy()
_ONE_OTHER[2, 1] += 0.5


@pytest.mark.parametrize(
    ("held", "said"),
    [
        (_LAST, None),
        (None, None),
        (_ONE_OTHER, "step 29 are not those it was given, in 1 envs"),
        (_given(FIRST + STEPS - 2), "step 29 are not those it was given, in 4 envs: they are those of the step before"),
        (np.roll(_LAST, 1, axis=0), "in 4 envs: they are those of the neighbouring environments"),
        (np.roll(_LAST, -1, axis=0), "in 4 envs: they are those of the neighbouring environments"),
        (_LAST[:, :-1], "step 29 are not those it was given, in 4 envs"),
        (np.zeros_like(_LAST), "step 29 are not those it was given, in 4 envs"),
    ],
    ids=["given", "not told", "one other", "late", "next", "previous", "too few", "zeros"],
)
def test_an_engine_that_holds_other_actions_is_gated(
    journal: Journal, held: NDArray[np.float32] | None, said: str | None
) -> None:
    """Fire a gate that says how many environments hold other actions, and whose; none where the engine cannot tell."""
    simulator: Any = SimpleNamespace(scene=make_scene("franka"), streams=Streams.usual(N_ENV), applied=lambda: held)
    configuration = RunConfiguration("mine", "franka", N_ENV, 0.01, 0, seed=SEED)
    write_applied(journal, simulator, configuration, FIRST, STEPS)
    problems = [text for _, text in journal.problems]
    assert len(problems) == (said is not None)
    assert said is None or problems[0].endswith(said)


@pytest.mark.parametrize(
    ("causes", "worth"),
    [
        ((), True),
        (("BUFFER",), False),
        (("ENGINE",), False),
        (("OUT_OF_BOUNDS",), False),
        (("NOT_FINITE",), True),
        (("BUFFER", "NOT_FINITE"), True),
    ],
)
def test_states_are_worth_capturing(journal: Journal, causes: tuple[str, ...], worth: bool) -> None:
    """Capture the states of a sound run, and of one that is not finite; of no other that is INVALID already."""
    for cause in causes:
        journal.gate("something is wrong", cause)
    assert journal.fired is bool(causes)
    assert journal.worth_capturing is worth
