"""How far bodies lie apart, step by step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.diff.numbers import Pairing
from gpusimbench.evaluator.diff.result import Basis, Growth
from gpusimbench.evaluator.metrics.divergence import FIT_LIMIT_M, first_reaching, fit_growth
from gpusimbench.evaluator.metrics.lost_cubes import Board, Fallen
from gpusimbench.evaluator.missing import Missing

_MM, _CM = 1e-3, 1e-2


class Distances:
    """Collects distances of bodies, chunk by chunk; the chunks of a step's groups are added together.

    boards  of both sides; None where the scene has none
    """

    def __init__(self, groups: Sequence[Pairing], boards: tuple[Board | None, Board | None] = (None, None)) -> None:
        self._groups = tuple(p.field.a.group for p in groups)
        self._spatial = all("z" in p.field.components for p in groups)
        known = self._spatial and None not in boards
        self._fallen = tuple(tuple(Fallen(board) for board in boards if board and known) for _ in groups)
        self._steps: list[int] = []
        self._rows: dict[str, list[float | None]] = {
            name: [] for name in ("median_planar", "max_planar", "median_spatial", "max_spatial")
        }
        self._not_fallen: list[float | None] = []
        self._n_fallen, self._all_fallen = 0, False
        self._not_finite: int | None = None

    def add(self, steps: NDArray[np.int64], found: Sequence[tuple[Pairing, NDArray[Any], NDArray[Any]]]) -> None:
        """Positions [step, env, item, component] of both sides, of every group."""
        planar, spatial, gone, finite = [], [], [], np.ones(len(steps), dtype=bool)
        for (how, a, b), fallen in zip(found, self._fallen, strict=True):
            apart = how.apart(a, b)
            if how.field.basis is not Basis.BITS:
                # what storing the same place twice can differ by is no distance
                apart = np.where(how.differs(a, b).any(axis=-1, keepdims=True), apart, 0.0)
            finite &= np.isfinite(a).all(axis=(1, 2, 3)) & np.isfinite(b).all(axis=(1, 2, 3))
            axes = [how.field.components.index(name) for name in ("x", "y", "z") if name in how.field.components]
            planar.append(_lengths(apart[..., axes[:2]]))
            spatial.append(_lengths(apart[..., axes]))
            if fallen:
                of_a, of_b = fallen
                below = of_a.feed((a - how.origin_a)[..., axes]) | of_b.feed((b - how.origin_b)[..., axes])
                gone.append(below.reshape(len(below), -1))
        for name, lengths in (("planar", planar), ("spatial", spatial)):
            for row in np.concatenate(lengths, axis=1):
                good = row[np.isfinite(row)]
                known = good.size > 0 and (name == "planar" or self._spatial)
                self._rows[f"median_{name}"].append(float(np.median(good)) if known else None)
                self._rows[f"max_{name}"].append(float(good.max()) if known else None)
        if gone:
            all_gone, apart = np.concatenate(gone, axis=1), np.concatenate(spatial, axis=1)
            here = np.where(all_gone | ~np.isfinite(apart), -1.0, apart).max(axis=1)
            self._not_fallen += [float(most) if most >= 0 else None for most in here]
            self._n_fallen, self._all_fallen = int(all_gone[-1].sum()), bool(all_gone[-1].all())
        if self._not_finite is None and not finite.all():
            self._not_finite = int(steps[np.argmin(finite)])
        self._steps += [int(step) for step in steps]

    def __len__(self) -> int:
        return len(self._steps)

    def result(self, dt: float) -> Growth:
        """The growth.

        dt  time step of side a [s]
        """
        times = np.array(self._steps) * dt
        not_fallen = [] if self._all_fallen else self._not_fallen
        largest = not_fallen or self._rows["max_spatial" if self._spatial else "max_planar"]
        distances = np.array([np.nan if d is None else d for d in largest])
        fit = fit_growth(times, distances, limit=FIT_LIMIT_M)
        if self._not_finite is not None and not (distances > 0).any():
            known = np.isfinite(distances).any()
            fit = Missing("no finite positions moved apart" if known else "no distance is finite")
        return Growth(
            groups=self._groups,
            steps=tuple(self._steps),
            times=tuple(times.tolist()),
            median_planar=tuple(self._rows["median_planar"]),
            max_planar=tuple(self._rows["max_planar"]),
            median_spatial=tuple(self._rows["median_spatial"]),
            max_spatial=tuple(self._rows["max_spatial"]),
            not_finite_from=self._not_finite,
            to_1mm=first_reaching(times, distances, _MM),
            to_1cm=first_reaching(times, distances, _CM),
            fit=fit,
            max_not_fallen=tuple(not_fallen),
            fallen=self._n_fallen,
        )


def _lengths(apart: NDArray[np.float64]) -> NDArray[np.float64]:
    # [step, env, item, axis] to [step, body]
    with np.errstate(invalid="ignore", over="ignore"):
        return np.asarray(np.sqrt((apart**2).sum(axis=-1)).reshape(len(apart), -1))
