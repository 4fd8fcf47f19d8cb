"""What a run begins with: the scene's first state, drawn or given positions and velocities, or a snapshot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.run import initial
from gpusimbench.recorder.simulators.base import Description, Simulator, States
from gpusimbench.recorder.simulators.snapshot import Extent, Snapshot
from gpusimbench.schemas import arrays
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.tosses import NOTICE
from gpusimbench.schemas.treatment import GIVEN, TEACHER, Given, parse_initial

ITEMS = "items"
"""Of given states: GROUP/items has the names of a group's bodies or joints, in the order of its arrays."""

Arrays = Mapping[str, NDArray[Any]]


def begin(simulator: Simulator, description: Description, text: str, given: bytes | None) -> None:
    """Give a simulator that was just built the state that a run was asked to begin with.

    text   as RunConfiguration.initial
    given  the attachment of that, for what was not drawn

    UsageError where what was given does not fit the simulator.
    """
    if not text:
        return
    how = parse_initial(text)
    if not isinstance(how, Given):
        first = tuple(np.array(array) for array in simulator.state())
        simulator.set_state(initial.states(how, simulator.scene, description.fields, first, simulator.seed))
        return
    if given is None:
        raise UsageError(f"the run begins with states that were given ({text}), and they are not there")
    found = arrays.decode(GIVEN, given)
    if how.step is None:
        simulator.set_state(states_of(found, simulator, description))
    else:
        simulator.restore(_snapshot_of(found, how.step, simulator))


def states_of(given: Arrays, simulator: Simulator, description: Description) -> States:
    """Given positions and velocities as arrays [env, item, width] of the simulator's fields; what was not given is that
    of the scene's first state. UsageError where something does not fit."""
    names = {field.name for field in description.fields}
    items = {name for name in given if name.endswith(f"/{ITEMS}") or name.startswith(TEACHER)}
    if unknown := sorted(given.keys() - names - items - {NOTICE}):
        raise UsageError(f"initial states have '{unknown[0]}', and the simulator's are {', '.join(sorted(names))}")
    found = []
    for layout, present in zip(description.fields, simulator.state(), strict=True):
        if layout.name not in given:
            found.append(np.array(present))
            continue
        wanted = _ordered(layout, given)
        shape = (simulator.n_env, *present.shape[1:])
        if wanted.shape[1:] != shape[1:] or len(wanted) not in (1, simulator.n_env):
            raise UsageError(
                f"initial states of {layout.name} have the shape {wanted.shape}, not {shape} as environment, item, "
                "component, or 1 environment for all"
            )
        values = np.broadcast_to(wanted.astype(np.float64), shape)
        if layout.field == "position" and layout.frame == "world" and description.env_origins:
            values = values + np.array(description.env_origins)[:, np.newaxis]
        found.append(np.ascontiguousarray(values, dtype=present.dtype))
    return tuple(found)


def _ordered(layout: StateField, given: Arrays) -> NDArray[Any]:
    names = given.get(f"{layout.group}/{ITEMS}")
    array = given[layout.name]
    if names is None or array.ndim != 3 or array.shape[1] != names.size:
        return array
    at = {str(name): index for index, name in enumerate(names.ravel())}
    if missing := [item for item in layout.items if item not in at]:
        raise UsageError(f"initial states have no {layout.group} '{missing[0]}'; they have {', '.join(at)}")
    return array[:, [at[item] for item in layout.items]]


def _snapshot_of(given: Arrays, step: int, simulator: Simulator) -> Snapshot:
    # an engine may use numbers of a snapshot as indices: at least their arrays are like its own
    own = simulator.snapshot().arrays
    for name in sorted(own.keys() | given.keys()):
        mine, theirs = (
            f"{a[name].dtype} {a[name].shape}" if name in a else "nothing of that name" for a in (own, given)
        )
        if mine != theirs:
            raise UsageError(
                f"the snapshot is of another engine, version or configuration: of '{name}' it has {theirs}, and the "
                f"simulator has {mine}"
            )
    return Snapshot(step, {name: np.array(given[name]) for name in own})


def saved(simulator: Simulator) -> bytes:
    """The present state of a simulator, as the attachment of a snapshot."""
    return arrays.encode(simulator.snapshot().arrays)


def refusal(name: str, adapter: type[Simulator], options: object, text: str, snapshots: tuple[int, ...]) -> str:
    """Why a simulator cannot begin so, or save its state; empty where it can."""
    claims = adapter.state_claims(options)
    how = parse_initial(text) if text else None
    continues = isinstance(how, Given) and how.step is not None
    if how and not continues and claims.set_state.extent is Extent.NONE:
        return f"simulator '{name}' has no initial states per environment (--initial): {claims.set_state.why}"
    if (continues or snapshots) and claims.snapshot.extent is Extent.NONE:
        asked = "--from" if continues else "--snapshot"
        return f"simulator '{name}' cannot save and restore its state ({asked}): {claims.snapshot.why}"
    return ""
