"""The parameters that an engine holds of a model file, compared with the reference's, thing by thing and by name."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.imported import KINDS, PARAMETERS, Imported, Parameter

RELATIVE = 1e-5
"""Of the largest number of a row: what rounding to single precision may change."""

ABSOLUTE = {"m": 1e-6, "wxyz": 1e-5, "": 1e-7}
"""By unit, what may differ beside that: metres; radians between two orientations; numbers without a unit."""

_FOLLOWING = ("joints/limit_solref", "joints/limit_solimp", "joints/margin", "joints/spring_reference")
"""What has a meaning where there is a limit or a spring, which is named where there is none."""

_SIX = ("xx", "yy", "zz", "xy", "xz", "yz")
_COMPONENTS = {"m": "xyz", "m/s": "xyz", "m/s^2": "xyz", "kg m^2": _SIX}


class ParameterFault(StrEnum):
    """What is wrong with a parameter or a thing."""

    DIFFERS = "differs"
    MISSING = "missing"
    ADDED = "added"
    ORDER = "order"
    LOST = "lost"


@dataclass(frozen=True)
class ParameterDifference:
    """A difference.

    kind        of the thing: one of KINDS
    item        its name; empty where all are meant
    parameter   that differs; empty where the thing itself is missing or added, or the order differs
    wanted      of the reference, as people read it
    found       of the engine; where it is lost, why
    difference  largest of any component, in the unit; None where there is no number
    unit        of the difference
    """

    verdict: ParameterFault
    kind: str
    item: str
    parameter: str
    wanted: str
    found: str
    difference: float | None = None
    unit: str = ""


@dataclass(frozen=True)
class ComparedKind:
    """One kind of things.

    things        that both have
    values        rows of parameters that were compared
    findings      all differences
    not_compared  names of parameters that were not, and why
    """

    kind: str
    things: int
    values: int
    findings: tuple[ParameterDifference, ...]
    not_compared: tuple[tuple[str, str], ...]


def compare(reference: Imported, engine: Imported) -> tuple[ComparedKind, ...]:
    """Every kind of things that the reference or the engine has."""
    kinds = [kind for kind in KINDS if reference.names.get(kind) or engine.names.get(kind)]
    return tuple(_compared(kind, reference, engine) for kind in kinds)


def _compared(kind: str, reference: Imported, engine: Imported) -> ComparedKind:
    if kind not in engine.names:
        why = engine.unread.get(kind, "the engine's are not read")
        return ComparedKind(kind, 0, 0, (), (("all of them", why),))
    wanted, found = reference.names.get(kind, ()), engine.names[kind]
    common = [name for name in wanted if name in set(found)]
    unseen = _only_shown(reference) if kind == "geoms" else frozenset()
    needed = [name for name in wanted if name in set(found) or name not in unseen]
    findings = list(_presence(kind, needed, found, engine.unread.get(kind, "")))
    rows = [(wanted.index(name), found.index(name)) for name in common]
    values, left = 0, []
    if away := len(wanted) - len(needed):
        left.append(("shapes", f"{away} that collide with nothing are not there"))
    for parameter in (p for p in PARAMETERS if p.kind == kind and common):
        if parameter.key not in reference.values:
            continue
        ours = reference.values[parameter.key][[row for row, _ in rows]]
        theirs = engine.values.get(parameter.key)
        if theirs is None:
            why = engine.unread.get(parameter.key) or "the engine's value is not read"
            used = _used(parameter, ours)
            if used is None:
                left.append((parameter.name, why))
            elif used.any():
                findings.append(_lost(parameter, ours, used, why))
            continue
        values += len(common)
        findings += _rows(parameter, common, ours, theirs[[row for _, row in rows]])
    return ComparedKind(kind, len(common), values, tuple(findings), tuple(left))


def _only_shown(reference: Imported) -> frozenset[str]:
    # shapes that collide with nothing: an engine that leaves them out loses no more than their looks
    masks = [reference.values.get(f"geoms/{name}") for name in ("contype", "conaffinity")]
    if any(mask is None for mask in masks):
        return frozenset()
    paired = {name for pair in reference.names.get("pairs", ()) for name in pair.split(" - ")}
    still = np.logical_and.reduce([np.asarray(mask, dtype=np.float64)[:, 0] == 0 for mask in masks])
    return frozenset(
        name for name, alone in zip(reference.names["geoms"], still, strict=True) if alone and name not in paired
    )


def _presence(kind: str, wanted: Sequence[str], found: Sequence[str], why: str) -> Iterator[ParameterDifference]:
    there, known = set(found), set(wanted)
    for name in wanted:
        if name not in there:
            yield ParameterDifference(ParameterFault.MISSING, kind, name, "", "there", why or "not there")
    for name in found:
        if name not in known:
            yield ParameterDifference(ParameterFault.ADDED, kind, name, "", "not there", "there")
    ours, theirs = [name for name in wanted if name in there], [name for name in found if name in known]
    if ours != theirs:
        at = next(i for i, (a, b) in enumerate(zip(ours, theirs, strict=True)) if a != b)
        yield ParameterDifference(ParameterFault.ORDER, kind, "", "", _from(ours, at), _from(theirs, at))


def _from(names: Sequence[str], at: int) -> str:
    shown = names[at : at + 3]
    return f"from number {at} on: {', '.join(shown)}{', ...' if len(names) > at + 3 else ''}"


def _used(parameter: Parameter, ours: NDArray[np.generic]) -> NDArray[np.bool_] | None:
    # which rows differ from what an engine does that does not know the parameter; None where there is no such thing
    if parameter.default is None or ours.dtype.kind == "U":
        return None
    numbers = np.abs(ours.astype(np.float64))
    return np.asarray(((numbers != parameter.default) & ~np.isnan(numbers)).any(axis=1))


def _lost(parameter: Parameter, ours: NDArray[np.generic], used: NDArray[np.bool_], why: str) -> ParameterDifference:
    count, first = int(used.sum()), int(np.argmax(used))
    item = "" if parameter.kind == "model" else f"{count} of {len(used)}"
    wanted = text_of(ours[first])
    return ParameterDifference(
        ParameterFault.LOST, parameter.kind, item, parameter.name, wanted if count == 1 else f"such as {wanted}", why
    )


def _rows(
    parameter: Parameter, names: Sequence[str], ours: NDArray[np.generic], theirs: NDArray[np.generic]
) -> Iterator[ParameterDifference]:
    for name, a, b in zip(names, ours, theirs, strict=True):
        if a.dtype.kind == "U":
            if a.tolist() != b.tolist():
                yield ParameterDifference(
                    ParameterFault.DIFFERS, parameter.kind, name, parameter.name, text_of(a), text_of(b)
                )
            continue
        x, y = _alike(parameter, a.astype(np.float64), b.astype(np.float64))
        if not x.size or (parameter.key in _FOLLOWING and np.isnan(y).all()):
            continue  # nothing that has a meaning
        apart = angle(x, y) if parameter.unit == "wxyz" else _apart(x, y)
        if apart > _tolerance(parameter, x):
            unit = "rad" if parameter.unit == "wxyz" else parameter.unit
            shown = _shown(parameter, x, y)
            yield ParameterDifference(
                ParameterFault.DIFFERS, parameter.kind, name, parameter.name, *shown, float(apart), unit
            )


def _alike(
    parameter: Parameter, ours: NDArray[np.float64], theirs: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # the components that have a meaning in the reference; what the engine has none of is what it does without it
    width = max(len(ours), len(theirs))
    x, y = (np.concatenate([row, np.full(width - len(row), np.nan)]) for row in (ours, theirs))
    if parameter.default == 0:
        y = np.where(np.isnan(y), 0.0, y)
    meant = ~np.isnan(x)
    return x[meant], y[meant]


def _apart(ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> float:
    same = ours == theirs  # infinities too
    difference = np.zeros(len(ours))
    np.subtract(ours, theirs, out=difference, where=~same)
    difference = np.abs(difference)
    difference[np.isnan(difference)] = np.inf
    return float(difference.max(initial=0.0))


def angle(ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> float:
    """Between two orientations wxyz [rad]; the same with both signs. Infinite for what is none."""
    norms = np.linalg.norm(ours) * np.linalg.norm(theirs)
    if not norms > 0 or not len(ours) == len(theirs) == 4:
        return float("inf")
    w, u = ours[0], ours[1:]
    s, v = theirs[0], theirs[1:]
    turned = w * v - s * u - np.cross(u, v)  # of the conjugate's product with the other
    return float(2 * np.arcsin(min(1.0, float(np.linalg.norm(turned) / norms))))


def _tolerance(parameter: Parameter, ours: NDArray[np.float64]) -> float:
    absolute = ABSOLUTE.get(parameter.unit, 0.0)
    if parameter.unit == "wxyz":
        return absolute
    finite = np.abs(ours[np.isfinite(ours)])
    return absolute + RELATIVE * float(finite.max(initial=0.0))


def _shown(parameter: Parameter, ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> tuple[str, str]:
    # of a long row the components that differ, with their names or numbers
    if len(ours) <= 4:
        return text_of(ours), text_of(theirs)
    limit = _tolerance(parameter, ours)
    apart = [i for i in range(len(ours)) if _apart(ours[i : i + 1], theirs[i : i + 1]) > limit]
    names = _COMPONENTS.get(parameter.unit, ())
    labels = [names[i] if len(names) == len(ours) else f"[{i}]" for i in apart]
    shown = [", ".join(f"{label} {text_of(row[i : i + 1])}" for label, i in zip(labels, apart, strict=True))
             for row in (ours, theirs)]  # fmt: skip
    return shown[0], shown[1]


def text_of(row: NDArray[np.generic]) -> str:
    """A row as people read it; a range without limits is "none"."""
    if row.dtype.kind == "U":
        return ", ".join(map(str, row)) or "nothing"
    numbers = row.astype(np.float64)
    if len(numbers) == 2 and np.isinf(numbers).all():
        return "none"
    return " ".join(f"{number:.6g}" for number in numbers)
