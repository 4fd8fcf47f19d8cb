"""Which environments of several recordings are repeats of each other: one seed, one number, one start.

The next run of a seed is no further sample of the initial states: its episodes are as dependent on those of the first
run as an engine, and a policy, repeat themselves. Such environments are one cluster. Their values are averaged before
anything is resampled or exchanged, so that a cluster counts as one environment (Miller 2024, "Adding error bars to
evals", on clustered questions; Cameron and Miller 2015).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.divergence import by_first_appearance
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.vector import NO_SEED, RESET_KEYS, RESET_SEEDS

Starts = Mapping[str, NDArray[np.generic]]
"""First observations of the environments of a recording, [env, width] by the name of the array."""

_SEEDED_BY_NUMBER = "gymnasium"

_RELATIVE, _ABSOLUTE = 1e-3, 1e-5
"""Starts that are further apart are not one start: an engine that does not repeat itself rounds a reset otherwise."""


def seed_of(run: Run | Recording) -> Hashable:
    """What runs must have in common to be repetitions of each other; a run without a seed is none of any other."""
    return run.provenance.run_id if not _seeded(run) else (run.configuration.seed, *_reset_with(run))


def clusters_of(recordings: Sequence[Recording], starts: Sequence[Starts]) -> NDArray[np.int64]:
    """The cluster of each environment of all recordings, numbered in order of first appearance, shape [env].

    starts  of each recording

    Environments of two recordings are repeats if they have the same number and nearly the same start, and

    * their recordings have one seed and the same number of environments, or
    * neither recording has a seed, and all environments of both begin alike, but not all of one recording;

    or if both are recordings of Gymnasium, which seeds environments by seed plus number, and this sum and every bit of
    the start are the same.
    """
    counts = [recording.configuration.n_env for recording in recordings]
    first = np.cumsum([0, *counts])
    cluster = np.arange(first[-1])
    known: dict[Hashable, list[int]] = defaultdict(list)  # recordings of a seed that repeat no earlier one as a whole
    by_seed: dict[Hashable, int] = {}
    for file, (recording, seen) in enumerate(zip(recordings, starts, strict=True)):
        envs = cluster[first[file] : first[file + 1]]
        alone = envs.copy()
        seeded = _seeded(recording)
        earlier = known[seed_of(recording) if seeded else NO_SEED, counts[file]]
        for other in earlier:
            same = _near(starts[other], seen)
            if seeded or (same.all() and _several(seen)):
                fresh = same & (envs == alone)
                envs[fresh] = cluster[first[other] : first[other + 1]][fresh]
        if (envs == alone).any():
            earlier.append(file)
        if seeded and recording.configuration.simulator == _SEEDED_BY_NUMBER and _reset_with(recording) == (None, None):
            for number, env in enumerate(alone.tolist()):
                bits = b"".join(seen[name][number].tobytes() for name in sorted(seen))
                twin = cluster[by_seed.setdefault((recording.configuration.seed + number, bits), env)]
                if envs[number] != twin:
                    cluster[cluster == envs[number]] = twin
    return by_first_appearance(cluster.astype(np.uint64))


def _reset_with(run: Run | Recording) -> tuple[str | None, str | None]:
    """Seeds and keys of a reset that was given more than one number."""
    options = run.configuration.options
    return options.get(RESET_SEEDS), options.get(RESET_KEYS)


def _seeded(run: Run | Recording) -> bool:
    return run.configuration.options.get(RESET_SEEDS) != NO_SEED


def _near(some: Starts, others: Starts) -> NDArray[np.bool_]:
    """Which environments of two recordings begin alike, but for rounding."""
    if some.keys() != others.keys() or any(some[name].shape != others[name].shape for name in some):
        return np.zeros(len(next(iter(some.values()))), dtype=np.bool_)
    near = [_close(some[name], others[name]) for name in some]
    return np.asarray(np.concatenate(near, axis=1).all(axis=1))


def _several(seen: Starts) -> bool:
    """Whether environments of a recording begin otherwise than each other, so that starts tell them apart.

    What counts as one start in two recordings counts as one here, too.
    """
    return not all(_close(array, array[:1]).all() for array in seen.values())


def _close(a: NDArray[np.generic], b: NDArray[np.generic]) -> NDArray[np.bool_]:
    if a.dtype.kind != "f":
        return np.asarray(np.equal(a, b))
    with np.errstate(over="ignore"):  # large numbers of either sign are infinitely far apart
        return np.asarray(np.isclose(a, b, rtol=_RELATIVE, atol=_ABSOLUTE, equal_nan=True))
