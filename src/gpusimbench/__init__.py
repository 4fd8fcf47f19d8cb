"""Record massively parallel robot simulators, and evaluate the recordings offline.

    from gpusimbench import evaluate, open_recording

    recording = open_recording("run.mcap")
    cubes = recording.state("cubes", "position")  # [step, env, item, 3] in metres, read when indexed
    evaluation = evaluate(["recordings/*.mcap"])

The names in `__all__` are the public interface; whatever else lies below may move between versions.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

from gpusimbench.schemas.errors import (
    DamagedRecording,
    DataLost,
    GateFailed,
    GsbError,
    NotARecording,
    NothingComparable,
    RecordingError,
    Unreachable,
    UsageError,
)
from gpusimbench.schemas.location import place

if TYPE_CHECKING:
    from pathlib import Path

    from gpusimbench.evaluator.compare.compare import Result
    from gpusimbench.evaluator.diff.result import Difference
    from gpusimbench.evaluator.read.recording import Recording
    from gpusimbench.evaluator.results.evaluate import Evaluation
    from gpusimbench.recorder.log import RecordingWriter
    from gpusimbench.recorder.scenes.base import Scene
    from gpusimbench.recorder.simulators.base import Simulator
    from gpusimbench.recorder.vector.wrap import record_rollout, wrap
    from gpusimbench.schemas.location import Place

    Where = str | Path | Place

__all__ = [
    "DamagedRecording",
    "DataLost",
    "GateFailed",
    "GsbError",
    "NotARecording",
    "NothingComparable",
    "RecordingError",
    "RecordingWriter",
    "Scene",
    "Simulator",
    "Unreachable",
    "UsageError",
    "compare",
    "diff",
    "evaluate",
    "open_recording",
    "record_rollout",
    "verify",
    "wrap",
]

# names of the recorder, which is imported when one of them is asked for: evaluating needs none of it
_LATER = {
    "RecordingWriter": "gpusimbench.recorder.log",
    "Scene": "gpusimbench.recorder.scenes.base",
    "Simulator": "gpusimbench.recorder.simulators.base",
    "record_rollout": "gpusimbench.recorder.vector.wrap",
    "wrap": "gpusimbench.recorder.vector.wrap",
}


def __getattr__(name: str) -> Any:
    if name in _LATER:
        return getattr(import_module(_LATER[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def open_recording(path: Where) -> Recording:
    """Open a recording for reading; nothing but its index is read.

    path  of a file of this machine, or its address elsewhere: "s3://bucket/run.mcap", "https://..." (docs/remote.md)

    Returns a Recording: its provenance, its state arrays [step, env, item, width], clocks, counters and events, read
    on demand. Raises NotARecording, DamagedRecording or Unreachable.
    """
    from gpusimbench.evaluator.read.recording import Recording

    return Recording(place(path))


def verify(recording: Recording) -> None:
    """Read all of a recording and check its CRCs, its digests, its content hash, and that no part contradicts another.

    Returns nothing where all of it holds. Raises DamagedRecording that names the first thing that is wrong.
    """
    from gpusimbench.evaluator.runs import validation

    validation.verify(recording)


def evaluate(
    files: Sequence[Where], *, reference: Where | None = None, sample_time: float | None = None, verified: bool = True
) -> Evaluation:
    """Compute every metric of every group of runs, as ``gsb-eval`` does.

    files        paths, folders, addresses, or patterns of them, in any order; copies of one run count once
    reference    recording that simulations are compared with; None: the real trials among the files, if any
    sample_time  simulated time at which positions are compared [s]; None: 5 s, and for a scene whose recordings all end
                 before, the last time that all of them have
    verified     check every byte of the files first; without it, digests are taken on trust

    Returns an Evaluation: a result for each group, with its estimates by the names of docs/metrics.md, sweeps, ranking,
    and the files that could not be read, which do not stop the others. Raises the reference's own error where that
    cannot be read, and Unreachable where a pattern's file system cannot be reached.
    """
    from gpusimbench.evaluator.inputs.reader import Reader
    from gpusimbench.evaluator.results.evaluate import read_and_evaluate

    compared = place(reference) if reference is not None else None
    how = Reader(sample_time, verify=verified)
    return read_and_evaluate([place(file) for file in files], how, reference=compared)[0]


def compare(
    base: Sequence[Where], head: Sequence[Where], *, across: Collection[str] = (), sample_time: float | None = None,
    alpha: float = 0.05, threshold: float = 0.05,
) -> Result:  # fmt: skip
    """Compare two sets of recordings, as ``gsb-compare`` does: speed, memory, physics, validity, determinism.

    base, head   paths, addresses, or folders of recordings
    across       options that may differ between them, or "simulator", "determinism", "warmup", "timed_steps"
    sample_time  simulated time at which positions are compared [s]; None: as of evaluate
    alpha        chance of any false alarm in this comparison
    threshold    smallest relative change of an amount that counts

    Returns a Result: a comparison for each configuration that both have, with its findings, and an exit code. Raises
    UsageError where a run is in both sets, or where a folder has no recordings.
    """
    from gpusimbench.evaluator.compare import compare as comparing
    from gpusimbench.evaluator.compare.finding import Settings
    from gpusimbench.evaluator.compute.work import HERE
    from gpusimbench.evaluator.inputs.reader import Reader
    from gpusimbench.evaluator.read.addresses import expand

    ours, theirs = expand(list(map(place, base))), expand(list(map(place, head)))
    sides = comparing.read_sides(ours, theirs, Reader(sample_time), HERE)
    return comparing.compare(*sides, Settings(alpha=alpha, threshold=threshold), HERE, across)


def diff(a: Where, b: Where | None = None, *, envs: tuple[int, int] | None = None) -> Difference:
    """Find where two recordings, or environments of one, first differ, as ``gsb-diff`` does.

    a, b  paths or addresses; without b, environments of a are compared with each other
    envs  one environment of a and one of b (or two of a); None: all that both have

    Returns a Difference: the first step, environment, body and number that differ, in ULPs and in SI units, and how the
    difference grows. Raises NothingComparable where they have nothing in common, UsageError for an environment that is
    not there, RecordingError where a file cannot be read.
    """
    from gpusimbench.evaluator.diff import compare as comparing

    first = open_recording(a)
    verify(first)
    if b is None:
        return comparing.compare_envs(first, *envs) if envs else comparing.compare_all_envs(first)
    second = open_recording(b)
    verify(second)
    return comparing.compare(first, second, envs=envs)
