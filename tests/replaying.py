"""What gsb-replay does with a data set, but for what it prints: in Pythons of engines that lack what it prints with."""

from __future__ import annotations

from pathlib import Path

from gpusimbench import open_recording, verify
from gpusimbench.evaluator.read.episodes import At
from gpusimbench.evaluator.replays.comparison import ReplayComparison, compare
from gpusimbench.recorder.demonstrations.formats import data_set_at
from gpusimbench.recorder.vector.making import registered
from gpusimbench.recorder.vector.open_loop import replay
from gpusimbench.replay.dataset import converted
from gpusimbench.replay.origin import given, origin_of
from gpusimbench.replay.parts import infos_of, parts_of, seed_of


def replayed(file: Path, *changed: str, env: str | None = None) -> ReplayComparison:
    """Make a recording of a data set, replay it, and compare; both recordings lie in the working directory.

    changed  as of --set
    env      as of --env
    """
    source = data_set_at(file)
    assert source is not None
    return replayed_recording(converted(source, env, given(changed)), Path("replay.mcap"), *changed, env=env)


def replayed_recording(file: Path, path: Path, *changed: str, env: str | None = None) -> ReplayComparison:
    """The same of a recording; the replay is written to a path."""
    original = open_recording(file)
    verify(original)
    origin = origin_of(original, env, given(changed))
    envs = registered(origin.spec_id, origin.keywords, 1, vectorization=origin.vectorization)
    infos = infos_of(original)
    replay(
        envs, path, parts_of(original), seed=seed_of(original), infos=infos, dt=original.configuration.dt,
        images="numbers",
    )  # fmt: skip
    again = open_recording(path)
    verify(again)
    return compare(original, again, success="success", at=At.LAST, tolerance=0.01)
