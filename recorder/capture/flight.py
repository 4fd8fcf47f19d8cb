"""The environments that failed, and their last states, to messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.interruption import shielded
from gpusimbench.recorder.simulators.captured import States
from gpusimbench.recorder.simulators.flight import AFTER, BEFORE, NEVER, FailureKind, Flight, Watch, step_and_kind
from gpusimbench.schemas import topics
from gpusimbench.schemas.block_parts import state_parts
from gpusimbench.schemas.configuration import sim_time_ns
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.messages import enum_values, message_class

MOST = 16
"""Environments whose states are written."""

_CAUSES = {
    FailureKind.NOT_FINITE: "NOT_FINITE",
    FailureKind.OVERFLOW: "BUFFER",
    FailureKind.OUT_OF_BOUNDS: "OUT_OF_BOUNDS",
}
_WORDS = {
    FailureKind.NOT_FINITE: "not finite",
    FailureKind.OVERFLOW: "overflow",
    FailureKind.OUT_OF_BOUNDS: "out of bounds",
}


@dataclass(frozen=True)
class _Place:
    """The number of a state that is wrong."""

    field: StateField
    item: str
    component: str
    value: float


class FlightWriter:
    """Writes the windows of the first MOST environments that fail, and at the end which they were.

    bits  names of overflow bits by number
    """

    def __init__(self, sink: Sink, watch: Watch, bits: Mapping[int, str], *, n_env: int, dt: float) -> None:
        self._sink = sink
        self._watch = watch
        self._bits = bits
        self._n_env = n_env
        self._dt = dt
        self._failed = np.zeros(n_env, dtype=bool)
        self._counts: Counter[FailureKind] = Counter()
        # step, environment and kind of windows that are not written yet
        self._due: list[tuple[int, int, FailureKind]] = []
        self._chosen = 0
        self._written: list[Any] = []
        self._first = ""
        self._cause = ""
        self._last_step = -1
        sink.channel(topics.RUN_FAILING, "gsb.v1.FailingEnvs")

    def look(self, flight: Flight, failures: NDArray[np.int64], last_step: int) -> None:
        """Take note of failures up to a step, and write the windows that are complete by then."""
        self._last_step = last_step
        new = np.flatnonzero((failures != NEVER) & ~self._failed)
        self._failed[new] = True
        found = sorted((*step_and_kind(int(failures[env])), int(env)) for env in new)
        self._counts.update(kind for _, kind, _ in found)
        chosen = sorted((step, env, kind) for step, kind, env in found)[: MOST - self._chosen]
        self._chosen += len(chosen)
        self._due += chosen
        self._write(flight, [due for due in self._due if due[0] + AFTER <= last_step])

    def finish(self, flight: Flight) -> None:
        """Write the windows that end with the last step, and the list of failures."""
        self._write(flight, list(self._due))
        data = message_class("gsb.v1.FailingEnvs")(
            failures=self._written,
            not_finite=self._counts[FailureKind.NOT_FINITE],
            overflow=self._counts[FailureKind.OVERFLOW],
            out_of_bounds=self._counts[FailureKind.OUT_OF_BOUNDS],
            last_step=max(0, self._last_step),
        )
        self._sink.write(topics.RUN_FAILING, data.SerializeToString(), sim_ns=sim_time_ns(self._last_step, self._dt))
        self._sink.flush()

    @property
    def problem(self) -> tuple[str, str] | None:
        """A sentence that names the first failure, and its cause; None where no environment failed."""
        if not self._counts:
            return None
        counts = ", ".join(f"{self._counts[kind]} {_WORDS[kind]}" for kind in FailureKind if self._counts[kind])
        said = f"{self._counts.total()} of {self._n_env} environments failed ({counts}); first {self._first}"
        return said, self._cause

    def _write(self, flight: Flight, due: list[tuple[int, int, FailureKind]]) -> None:
        for entry in due:
            self._due.remove(entry)
            with shielded():  # what is listed is there, whole
                self._written.append(self._window(flight, *entry))

    def _window(self, flight: Flight, step: int, env: int, kind: FailureKind) -> Any:
        first, last = max(0, step - BEFORE), min(step + AFTER, self._last_step)
        states = flight.window(env, first, last)
        for field, array in zip(self._watch.fields, states, strict=True):
            self._block(field, array, env, first)
        bits = flight.overflow(env, step)
        place = self._place(states, step - first, env, kind)
        if not self._first:
            self._first = f"env {env} at step {step}: {self._failure_in_words(kind, place, bits)}"
            self._cause = _CAUSES[kind]
        where = {} if place is None else {
            "group": place.field.group, "field": place.field.field, "item": place.item, "component": place.component,
            "value": place.value,
        }  # fmt: skip
        return message_class("gsb.v1.EnvFailure")(
            env=env,
            step=step,
            kind=enum_values("gsb.v1.FailureKind")[f"FAILURE_KIND_{kind.name}"],
            overflow_bits=bits,
            first_step=first,
            steps=last - first + 1,
            **where,
        )

    def _block(self, field: StateField, array: NDArray[np.floating], env: int, first: int) -> None:
        topic, time = topics.flight(env, field.group, field.field), sim_time_ns(first, self._dt)
        metadata = {**field.to_metadata(), "stride": "1", "dt": repr(self._dt), "n_env": str(self._n_env)}
        self._sink.channel(topic, "gsb.v1.StateBlock", metadata)
        parts = state_parts(array, first_step=first, stride=1, env_start=env, sim_time_ns=time)
        self._sink.write(topic, b"".join(part.data for part in parts), sim_ns=time)

    def _place(self, states: States, row: int, env: int, kind: FailureKind) -> _Place | None:
        if kind is FailureKind.OVERFLOW:
            return None
        own = slice(env, env + 1)
        for field, array in zip(self._watch.fields, states, strict=True):
            at = array[row : row + 1]
            wrong = ~np.isfinite(at) if kind is FailureKind.NOT_FINITE else self._watch.beyond(field, at, own)
            if wrong.any():
                if kind is FailureKind.OUT_OF_BOUNDS:
                    at = self._watch.local(field, at, own)
                place = tuple(np.argwhere(wrong)[0])
                return _Place(field, field.items[place[2]], field.components[place[3]], float(at[place]))
        raise ValueError(f"environment {env} was said to be {_WORDS[kind]}, and its state is not")

    def _failure_in_words(self, kind: FailureKind, place: _Place | None, bits: int) -> str:
        if place is None:
            names = [name for bit, name in self._bits.items() if bits >> bit & 1]
            return f"buffer overflow {', '.join(names)}: the engine dropped contacts or constraints"
        what = f"{place.field.name} {place.component} of {place.item}"
        if kind is FailureKind.NOT_FINITE:
            return f"{what} is not finite"
        return f"{what} is {place.value:.6g} m from the environment's origin"
