"""Madrona by way of a simulator module that the user builds: C++ with nanobind bindings, on the CPU or a GPU.

The module is held to its contract (docs/madrona.md) before the first step: scene, names, layout, first state.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.abilities import BODIES
from gpusimbench.recorder.simulators.base import Description, Simulator, States
from gpusimbench.recorder.simulators.evidence import CONTACTS, Evidence
from gpusimbench.recorder.simulators.madrona.columns import HostColumns, TorchColumns
from gpusimbench.recorder.simulators.madrona.module import MadronaOptions, SimulatorModule, breach
from gpusimbench.schemas.fields import StateField, body_fields
from gpusimbench.schemas.provenance import MODIFIED

_WIDTHS = {"position_tensor": 3, "rotation_tensor": 4, "velocity_tensor": 6}
_COUNTS = "contact_count_tensor"
_DROPPED = "dropped_count_tensor"

_WHERE = {
    "position": ("position_tensor", slice(0, 3)),
    "orientation": ("rotation_tensor", slice(0, 4)),
    "linear_velocity": ("velocity_tensor", slice(0, 3)),
    "angular_velocity": ("velocity_tensor", slice(3, 6)),
}
"""Where a field is found: the tensor, and which of its last axis."""

_TOLERANCE = 2e-6  # of the first state, absolute and relative: a few roundings of float32


class Madrona(Simulator):
    """N environments, the worlds of one SimManager."""

    Options = MadronaOptions
    abilities = BODIES

    def build(self) -> Description:
        """See Simulator.build."""
        options: MadronaOptions = self.options
        module = self._module = SimulatorModule(options)
        manager = self._manager = module.manager(
            self.scene, n_env=self.n_env, dt=self.dt, seed=self.seed, options=options
        )
        module.check_names(manager, self.scene)
        settings = module.settings(manager, self.scene, dt=self.dt, options=options)
        deviations = module.deviations(manager, self.scene, settings)
        optional = [name for name in (_COUNTS, _DROPPED) if hasattr(manager, name)]
        tensors = {name: getattr(manager, name)() for name in (*_WIDTHS, *optional)}
        kind = HostColumns if options.gpu is None else TorchColumns
        self._columns: Any = kind(tensors, module.name)
        self._check_layout()
        places = {body.name: index for index, body in enumerate(self.scene.moving())}
        self._groups = [np.array([places[name] for name in names]) for names in self.scene.groups().values()]
        self._ring: Any = None
        self._one: Any = self._columns.ring(1)
        self._start = self._read()
        self._check_start()
        self._stepped = False
        self._counts: NDArray[np.int32] | None = None
        self._dropped: NDArray[np.int64] = np.zeros(self.n_env, dtype=np.int64)
        return Description(
            version=module.version,
            device=self._columns.device,
            options={"module": module.name, "device": options.device, **settings},
            switches={
                "precision": "float32",
                "solver": settings["solver"],
                "module_sha256": module.digest,
                **({MODIFIED: settings[MODIFIED]} if settings.get(MODIFIED) else {}),
            },
            deviations=deviations,
            fields=self._fields(),
            timing_covers="SimManager.step of all worlds, once a step, until the device is done; on the CPU Madrona "
            "copies the exported columns in and out in each",
            counters=(CONTACTS,) if _COUNTS in optional else (),
        )

    def _fields(self) -> tuple[StateField, ...]:
        return body_fields(self.scene.groups(), "float32")

    def _check_layout(self) -> None:
        bodies = len(self.scene.moving())
        expected: dict[str, tuple[tuple[int, ...], str]] = {
            **{name: ((self.n_env, bodies, width), "float32") for name, width in _WIDTHS.items()},
            _COUNTS: ((self.n_env,), "int32"),
            _DROPPED: ((self.n_env,), "int32"),
        }
        for name, found in self._columns.described().items():
            if found != expected[name]:
                raise breach(
                    self._module.name, name,
                    f"{name}() is {found[1]} of shape {list(found[0])}, "
                    f"not {expected[name][1]} of shape {list(expected[name][0])}",
                )  # fmt: skip

    def _check_start(self) -> None:
        # Every world begins with the scene's own state, body by body: this finds a mix-up of order, axes or units, a
        # constructor that steps, and worlds that are not alike.
        moving = self.scene.moving()
        for field, (tensor, part) in _WHERE.items():
            found = self._start[tensor][..., part].astype(np.float64)
            if not np.isfinite(found).all():
                world, row, _ = np.argwhere(~np.isfinite(found))[0]
                raise breach(
                    self._module.name, "first state", f"{field} of {moving[row].name} in world {world} is not finite"
                )
            expected = np.array([getattr(body, field) for body in moving])
            if field == "orientation":  # a quaternion and its negative are one orientation
                found = found * np.where(np.sum(found * expected, axis=-1, keepdims=True) < 0, -1.0, 1.0)
            wrong = ~np.isclose(found, expected, rtol=_TOLERANCE, atol=_TOLERANCE).all(axis=-1)
            if wrong.any():
                world, row = np.argwhere(wrong)[0]
                raise breach(
                    self._module.name, "first state",
                    f"{field} of {moving[row].name} in world {world} begins as {found[world, row].tolist()}; "
                    f"the scene has {expected[row].tolist()}",
                )  # fmt: skip

    def step(self, n_step: int) -> None:
        """See Simulator.step."""
        for _ in range(n_step):
            self._manager.step()
        self._stepped = self._stepped or n_step > 0
        self._counts = None

    def state(self) -> States:
        """See Simulator.state."""
        return self._split(self._read())

    def states(self, n_step: int) -> States:
        """See Simulator.states."""
        rows = min(n_step, self._columns.rows or n_step)
        ring = self._columns.ring(rows)
        pieces = []
        for first in range(0, n_step, rows):
            count = min(rows, n_step - first)
            for row in range(count):
                self.step(1)
                self._columns.store(ring, row)
            fetched = self._columns.fetch(ring, count)
            pieces.append((self._split(fetched), fetched[_COUNTS].copy() if _COUNTS in fetched else None))
        counts = [found for _, found in pieces if found is not None]
        self._counts = np.concatenate(counts) if counts else None
        return tuple(np.concatenate(column) for column in zip(*(found for found, _ in pieces), strict=True))

    def _read(self) -> dict[str, NDArray[Any]]:
        # the present columns, copied
        self._columns.store(self._one, 0)
        return {name: array[0].copy() for name, array in self._columns.fetch(self._one, 1).items()}

    def _split(self, columns: dict[str, NDArray[Any]]) -> States:
        # by group and field; copies, as taking rows by number makes them
        return tuple(columns[tensor][..., rows, part] for rows in self._groups for tensor, part in _WHERE.values())

    def evidence(self) -> Evidence | None:
        """See Simulator.evidence; None where the module does not count contacts."""
        counts = self._counts
        if counts is None:
            columns = self._read()
            if _COUNTS not in columns:
                return None
            counts = columns[_COUNTS][np.newaxis]
        return Evidence({CONTACTS.name: counts})

    def gates(self) -> list[str]:
        """See Simulator.gates; contacts that the module says it dropped, and steps that change nothing."""
        columns, fired = self._read(), []
        if self._stepped and any(self.scene.gravity):
            still = all(columns[name].tobytes() == self._start[name].tobytes() for name in _WIDTHS)
            if still:
                fired.append(
                    "the module's step() changes no bit of any state: it does not step, or its tensors are copies"
                )
        if _DROPPED in columns:
            dropped = columns[_DROPPED].astype(np.int64)
            risen, self._dropped = dropped - self._dropped, dropped
            worlds = np.flatnonzero(risen)
            if worlds.size:
                fired.append(
                    f"the module dropped contacts in {worlds.size} of {self.n_env} envs, first in env {worlds[0]}"
                )
        return fired

    def close(self) -> None:
        """See Simulator.close."""
        self._columns = self._one = self._manager = None  # the module frees its memory with its SimManager
