"""One field's numbers, pair by pair: which differ, and how far apart they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.diff.common import CommonField, Selection
from gpusimbench.evaluator.diff.result import Basis, FieldDifference, Number
from gpusimbench.evaluator.metrics.divergence import as_words, differs, opposite_signs, resolution, ulp_distance


@dataclass(frozen=True)
class Pairing:
    """How the numbers of a common field are compared; arrays are [step, env, item, component].

    field               what is common
    origin_a, origin_b  what the environments' origins add, shape [env, 1, component]
    """

    field: CommonField
    origin_a: NDArray[np.float64]
    origin_b: NDArray[np.float64]

    def differs(self, a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.bool_]:
        """Where the numbers differ, by the field's basis."""
        if self.field.basis is Basis.BITS:
            return differs(a, b)
        apart = self.apart(a, b)
        beyond = ~(np.abs(apart) <= self.resolution(a, b))
        special = (a == b) | (np.isnan(a) & np.isnan(b))
        return np.asarray(np.where(np.isfinite(apart), beyond, ~special))

    def apart(self, a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.float64]:
        """a - b in float64 [unit of the field], without the environments' origins; not finite where either is not.

        q and -q are one rotation: of two quaternions, b is taken with the sign with which it is nearer to a.
        """
        with np.errstate(invalid="ignore", over="ignore"):
            if self.field.is_rotation:
                of_a, of_b = a.astype(np.float64), b.astype(np.float64)
                away = (of_a * of_b).sum(axis=-1, keepdims=True) < 0
                return np.asarray(np.where(away, of_a + of_b, of_a - of_b))
            if self.field.basis is Basis.LOCAL:
                return np.asarray((a.astype(np.float64) - self.origin_a) - (b.astype(np.float64) - self.origin_b))
            return np.asarray(a.astype(np.float64) - b.astype(np.float64))

    def negated(self, a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.bool_]:
        """Which bodies have b = -a, number by number, in a field of rotations: shape [step, env, item, 1]."""
        if not self.field.is_rotation:
            return np.zeros((1, 1, 1, 1), dtype=np.bool_)
        return np.asarray((a == -b).all(axis=-1, keepdims=True) & (a != 0).any(axis=-1, keepdims=True))

    def resolution(self, a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.float64]:
        """Spacing of numbers of the coarser dtype at the recorded magnitude [unit of the field]."""
        return resolution(*one_dtype(a, b))


def pairing(field: CommonField, a: Selection, b: Selection) -> Pairing:
    """How the numbers of a field are compared between two selections."""
    columns = ["xyz".index(name) if name in ("x", "y", "z") else 0 for name in field.components]
    return Pairing(
        field, a.offsets(field.a)[:, np.newaxis, :][..., columns], b.offsets(field.b)[:, np.newaxis, :][..., columns]
    )


def one_dtype(a: NDArray[Any], b: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Both as they are where they have one dtype, rounded to float32 where they have not."""
    if a.dtype == b.dtype:
        return a, b
    with np.errstate(over="ignore"):  # beyond float32 is infinite there
        return a.astype(np.float32), b.astype(np.float32)


class Tally:
    """Counts what differs in one field, chunk by chunk."""

    def __init__(self, how: Pairing) -> None:
        self._how = how
        self._numbers = self._different = self._zeros = self._payloads = self._not_finite = self._negated = 0
        self._finite = False
        self._first_step: int | None = None
        self._first_ulp: int | None = None
        self._max_ulp: int | None = None
        self._signs_from: int | None = None
        self._max_distance: float | None = None

    def add(self, steps: NDArray[np.int64], a: NDArray[Any], b: NDArray[Any], mask: NDArray[np.bool_]) -> None:
        """Numbers [step, env, item, component] of both sides, and which of them differ."""
        self._numbers += mask.size
        if self._max_ulp is None and self._how.field.basis is not Basis.LOCAL:
            self._max_ulp = 0
        self._finite = self._finite or bool((np.isfinite(a) & np.isfinite(b)).any())
        rows = np.flatnonzero(mask.any(axis=(1, 2, 3)))
        if not rows.size:
            return
        self._different += int(np.count_nonzero(mask))
        self._negated += int(np.count_nonzero(mask & self._how.negated(a, b)))
        apart = np.abs(self._how.apart(a, b)[mask])
        finite = apart[np.isfinite(apart)]
        self._not_finite += apart.size - finite.size
        if finite.size:
            self._max_distance = max(self._max_distance or 0.0, float(finite.max()))
        of_a, of_b = (np.broadcast_to(side, mask.shape)[mask] for side in one_dtype(a, b))
        self._zeros += int(np.count_nonzero((of_a == 0) & (of_b == 0)))
        self._payloads += int(np.count_nonzero(np.isnan(of_a) & np.isnan(of_b)))
        if self._max_ulp is not None:
            ulps = ulp_distance(of_a, of_b)
            opposite = opposite_signs(of_a, of_b)
            if self._signs_from is None and opposite.any():
                # masked numbers are in order of steps
                self._signs_from = int(steps[np.nonzero(mask)[0][np.argmax(opposite)]])
            self._max_ulp = max(self._max_ulp, int(ulps.max()))
            if self._first_step is None:
                self._first_ulp = int(ulps[: np.count_nonzero(mask[rows[0]])].max())
        if self._first_step is None:
            self._first_step = int(steps[rows[0]])

    def result(self) -> FieldDifference:
        """The difference of the field, once all of its states were added."""
        field = self._how.field
        # zero where nothing differs, and no distance where what differs is not finite
        nothing = 0.0 if self._finite and not self._different else None
        return FieldDifference(
            field=field.name, unit=field.unit, basis=field.basis, numbers=self._numbers, different=self._different,
            signed_zeros=self._zeros, nan_payloads=self._payloads, not_finite=self._not_finite,
            first_step=self._first_step, first_ulp=self._first_ulp, max_ulp=self._max_ulp,
            max_distance=nothing if self._max_distance is None else self._max_distance,
            other_sign=self._negated, signs_from=self._signs_from,
        )  # fmt: skip


def number(how: Pairing, a: NDArray[Any], b: NDArray[Any], at: tuple[int, ...]) -> Number:
    """A pair of numbers that differ, at an index (step, env, item, component)."""
    field = how.field
    apart = float(how.apart(a, b)[at])
    limit = None if field.basis is Basis.BITS else float(how.resolution(a, b)[at])
    one, other = (np.broadcast_to(side, np.broadcast_shapes(a.shape, b.shape))[at] for side in (a, b))
    ulp = None
    if one.dtype.kind != "f":
        apart = float(abs(int(one) - int(other)))  # beyond 2^53, float64 does not have them all
    elif field.basis is not Basis.LOCAL:
        ulp = int(ulp_distance(*one_dtype(np.array([one]), np.array([other])))[0])
    return Number(
        field=field.name, item=field.items[at[-2]], component=field.components[at[-1]], unit=field.unit,
        basis=field.basis, a=str(one), b=str(other), hex_a=_hex(one), hex_b=_hex(other), ulp=ulp,
        distance=abs(apart) if np.isfinite(apart) else None,
        resolution=limit if limit is None or np.isfinite(limit) else None,
        other_sign=bool(np.broadcast_to(how.negated(a, b), np.broadcast_shapes(a.shape, b.shape))[at]),
    )  # fmt: skip


def _hex(value: Any) -> str:
    word = as_words(np.array([value]))[0]
    return f"0x{int(word):0{2 * word.dtype.itemsize}x}"
