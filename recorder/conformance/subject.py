"""The adapter under check. What several checks need is made once and kept: few builds, whatever a build costs."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from gpusimbench.recorder.abilities import Ability
from gpusimbench.recorder.conformance.scene import DT, LANDING, N_ENV, N_STEP, conformance_scene
from gpusimbench.recorder.conformance.trajectory import RecordedRun, Trajectory, read
from gpusimbench.recorder.conformance.verdict import NotApplicable
from gpusimbench.recorder.options import parse_options
from gpusimbench.recorder.run.engine import apply_environment
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.registry import SCENES, make_scene
from gpusimbench.recorder.scenes.variation import Variation
from gpusimbench.recorder.simulators.base import Captured, Description, Simulator, States
from gpusimbench.recorder.simulators.captured import RING_BLOCKS
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.registry import Entry, find_simulator
from gpusimbench.recorder.simulators.snapshot import Claim, Extent, Snapshot, StateClaims
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import UsageError

SEED = (3 << 32) + 7
"""Of every build: both of its 32-bit words count."""

_BLOCKS = (30, N_STEP - 30)  # of states: of different sizes, as a recording's last block is
_AHEAD = (8, 8, 8, 8, 8, N_STEP - 40)  # of begin_states: more of them than are held at once
_STEPS = (*(1 for _ in range(LANDING + 5)), N_STEP - LANDING - 5)  # of step: one by one until the counts have changed

MEDDLED = 12
"""Steps after each operation on the state; the pebble lands within them, so that warm starts and caches matter."""

RESTORED, CHOSEN = (1,), (0, 2)
"""Environments that are restored, and those that are reset and set, while the others go on."""

_T = TypeVar("_T")


@dataclass(frozen=True)
class Stepped:
    """A build of the conformance scene that was stepped without asking for states.

    state     after N_STEP steps, arrays [env, item, width]
    evidence  what evidence() returned after each of the first steps, which were made one by one, and at the end
    gates     that fired
    """

    state: States
    evidence: tuple[Evidence | None, ...]
    gates: tuple[str, ...]


@dataclass(frozen=True)
class Meddled:
    """A build of the conformance scene, the state of which was changed from outside between steps.

    states    arrays [env, item, width] or [step, env, item, width] by what had been done; only what the adapter offers
    snapshot  from which "once" was stepped; None where the adapter offers none
    """

    states: dict[str, States]
    snapshot: Snapshot | None


def differing(description: Description, first: States) -> States:
    """The first state with a velocity of its own for every body of every environment [m/s]; poses as they were."""
    given = []
    for layout, array in zip(description.fields, first, strict=True):
        changed = array.copy()
        if layout.field == "linear_velocity":
            env = np.arange(len(array), dtype=array.dtype)[:, None]
            changed[..., 0] += (env + 1) / 64  # exact in either precision
        given.append(changed)
    return tuple(given)


class Subject:
    """An adapter with the options and the determinism level that it is checked with.

    adapter      the class
    name         what users call it
    options      as text, by name
    determinism  one of the adapter's levels
    entry        what the registry says of it; None for an adapter that is not registered

    UsageError for an option or a level that the adapter does not have. Sets the environment variables that the adapter
    asks for; an engine that is imported already no longer heeds them.
    """

    def __init__(
        self,
        adapter: type[Simulator],
        *,
        name: str = "",
        options: Mapping[str, str] | None = None,
        determinism: str = "default",
        entry: Entry | None = None,
    ) -> None:
        self.adapter = adapter
        self.name = name or adapter.__name__
        self.given = dict(options or {})
        self.options: Any = parse_options(self.name, adapter.Options, self.given)
        self.determinism = determinism
        self.entry = entry
        if determinism not in adapter.determinism_levels:
            raise UsageError(
                f"simulator '{self.name}' has no determinism level '{determinism}'; "
                f"it has: {', '.join(adapter.determinism_levels)}"
            )
        apply_environment(adapter.environment(self.options, determinism))
        self._kept: dict[str, tuple[Any, Exception | None]] = {}

    @classmethod
    def named(cls, name: str, options: Mapping[str, str] | None = None, determinism: str = "default") -> Subject:
        """The simulator of that name, built in or added by an installed distribution. UsageError as of the registry."""
        entry = find_simulator(name)
        return cls(entry.load(), name=name, options=options, determinism=determinism, entry=entry)

    @contextmanager
    def built(
        self, scene: Scene, *, n_env: int = N_ENV, variation: Variation | None = None
    ) -> Iterator[tuple[Simulator, Description]]:
        """A fresh build of a scene, at its step; closed at the end. NotApplicable where it needs a missing ability.

        variation  parameters of each environment; None: the scene's
        """
        if refusal := self.adapter.refusal(self.name, scene, self.options):
            raise NotApplicable(refusal)
        simulator = self.adapter(
            scene, n_env=n_env, dt=scene.dt, seed=SEED, options=self.options, determinism=self.determinism
        )
        try:
            if variation is not None:
                simulator.vary(variation)
            yield simulator, simulator.build()
        finally:
            simulator.close()

    @property
    def scenes(self) -> tuple[Scene, ...]:
        """Built-in scenes that need nothing beyond the adapter's abilities."""
        scenes = map(make_scene, SCENES)
        return tuple(scene for scene in scenes if not self.adapter.refusal(self.name, scene, self.options))

    @property
    def trajectory(self) -> Trajectory:
        """The conformance scene, captured."""
        return self._once("trajectory", self._capture)

    @property
    def repeated(self) -> Trajectory:
        """The same in another build, to see whether two are the same."""
        return self._once("repeated", self._capture)

    @property
    def stepped(self) -> Stepped:
        """The conformance scene in another build, stepped without being captured."""
        return self._once("stepped", self._step)

    @property
    def ahead(self) -> tuple[States, tuple[Evidence | None, ...]]:
        """The conformance scene in another build, captured in blocks that are begun before earlier ones are read:
        states without the initial one, and what each block shows."""
        return self._once("ahead", self._capture_ahead)

    @property
    def meddled(self) -> Meddled:
        """The conformance scene in another build, whose state was saved, restored, reset and set."""
        return self._once("meddled", self._meddle)

    @property
    def revived(self) -> tuple[States, States]:
        """The conformance scene in another build, which was given the snapshot of `meddled` before compile: its state
        after compile, and the steps that follow. The adapter offers snapshots."""
        return self._once("revived", self._revive)

    @property
    def claims(self) -> StateClaims:
        """What the adapter says of these operations."""
        return self.adapter.state_claims(self.options)

    @property
    def recording(self) -> RecordedRun:
        """A short run of one of `scenes`, recorded by a process of its own and read back."""
        return self._once("recording", self._record)

    def _once(self, name: str, make: Callable[[], _T]) -> _T:
        # what fails, fails for every check that needs it, without being tried again
        if name not in self._kept:
            try:
                self._kept[name] = make(), None
            except Exception as trouble:
                self._kept[name] = None, trouble
        value, error = self._kept[name]
        if error is not None:
            raise error
        made: _T = value
        return made

    def _capture(self) -> Trajectory:
        scene = conformance_scene()
        with self.built(scene) as (simulator, description):
            described = _copy(simulator.state())
            simulator.compile("capture")
            compiled = _copy(simulator.state())
            rows, evidence = [tuple(array[np.newaxis] for array in compiled)], []
            given: list[States] = []
            for count in _BLOCKS:
                simulator.prepare(None)
                given.append(simulator.states(count))
                rows.append(_copy(given[-1]))
                evidence.append(_copy_evidence(simulator.evidence()))
            return Trajectory(
                scene,
                N_ENV,
                DT,
                description,
                described,
                compiled,
                tuple(np.concatenate(field) for field in zip(*rows, strict=True)),
                given[0],
                _BLOCKS,
                tuple(evidence),
                tuple(simulator.gates()),
                simulator.allocator_bytes(),
            )

    def _capture_ahead(self) -> tuple[States, tuple[Evidence | None, ...]]:
        rows: list[States] = []
        evidence = []
        with self.built(conformance_scene()) as (simulator, _):
            simulator.compile("capture")
            simulator.reserve(max(_AHEAD))
            left, begun, arrived = list(_AHEAD), deque[Captured](), deque[Captured]()
            while left or begun or arrived:
                while left and len(begun) < simulator.blocks_ahead and len(begun) + len(arrived) < RING_BLOCKS:
                    simulator.prepare(None)
                    begun.append(simulator.begin_states(left.pop(0)))
                if begun:
                    begun[0].wait()
                    arrived.append(begun.popleft())
                if len(arrived) + len(begun) == RING_BLOCKS or not begun:  # read as late as the recorder may
                    block = arrived.popleft()
                    parts = [_copy(block.states(envs)) for envs in (slice(0, 1), slice(1, N_ENV))]
                    rows.append(tuple(np.concatenate(pair, axis=1) for pair in zip(*parts, strict=True)))
                    evidence.append(_copy_evidence(block.evidence()))
                    block.release()
        return tuple(np.concatenate(field) for field in zip(*rows, strict=True)), tuple(evidence)

    def _step(self) -> Stepped:
        with self.built(conformance_scene()) as (simulator, _):
            simulator.compile("timed")
            simulator.prepare(None)
            evidence = []
            for count in _STEPS:
                simulator.step(count)
                evidence.append(_copy_evidence(simulator.evidence()))
            return Stepped(_copy(simulator.state()), tuple(evidence), tuple(simulator.gates()))

    def _meddle(self) -> Meddled:
        states: dict[str, States] = {}
        snapshot: Snapshot | None = None
        claims, restored, chosen = self.claims, np.array(RESTORED), np.array(CHOSEN)

        def offered(claim: Claim) -> bool:
            return claim.extent is not Extent.NONE

        with self.built(conformance_scene()) as (simulator, description):

            def steps(count: int) -> States:
                simulator.prepare(None)
                return _copy(simulator.states(count))

            if offered(claims.set_state):
                states["given"] = differing(description, _copy(simulator.state()))
                simulator.set_state(states["given"])
                simulator.compile("capture")
                states["begun"] = _copy(simulator.state())
                states["after begun"] = steps(MEDDLED)
            if offered(claims.reset):
                simulator.reset()
                states["reset"] = _copy(simulator.state())
                states["after reset"] = steps(MEDDLED)
            if offered(claims.snapshot) and offered(claims.reset):
                snapshot = simulator.snapshot()
                states["once"] = steps(MEDDLED)
                simulator.restore(snapshot)
                states["restored"] = _copy(simulator.state())
                states["again"] = steps(MEDDLED)
                if offered(claims.some):
                    simulator.restore(snapshot, restored)
                    states["some restored"] = _copy(simulator.state())
                    states["after some restored"] = steps(MEDDLED)
            if offered(claims.reset):
                states["before some reset"] = _copy(simulator.state())
                simulator.reset(chosen)
                states["some reset"] = _copy(simulator.state())
                states["after some reset"] = steps(MEDDLED)
            if offered(claims.set_state):
                given = tuple(array[chosen] for array in states["given"])
                states["before some set"] = _copy(simulator.state())
                simulator.set_state(given, chosen)
                states["some set"] = _copy(simulator.state())
                states["after some set"] = steps(MEDDLED)
        return Meddled(states, snapshot)

    def _revive(self) -> tuple[States, States]:
        snapshot = self.meddled.snapshot
        assert snapshot is not None  # see `revived`
        with self.built(conformance_scene()) as (simulator, _):
            simulator.restore(snapshot)
            simulator.compile("capture")
            shown = _copy(simulator.state())
            simulator.prepare(None)
            return shown, _copy(simulator.states(MEDDLED))

    def _record(self) -> RecordedRun:
        from gpusimbench.recorder.environments.interpreter import own
        from gpusimbench.recorder.process.launch import Interruptions, make
        from gpusimbench.recorder.process.planned_run import PlannedRun, provenance_now
        from gpusimbench.schemas.scratch import scratch_folder

        if not self.scenes:
            raise NotApplicable("the adapter has not the abilities that any built-in scene needs")

        def cost(scene: Scene) -> tuple[bool, bool, int]:
            # engines on XLA compile longer for more bodies; without a fixed body there is nothing to touch
            moving = len(scene.moving())
            return Ability.ENV_STARTS in scene.needs(), not 0 < moving < len(scene.bodies), moving

        scene = min(self.scenes, key=cost)
        configuration = RunConfiguration(
            simulator=self.name,
            scene=scene.name,
            n_env=2,
            dt=scene.dt,
            steps=4,
            warmup=1,
            timed_steps=3,
            seed=SEED,
            options=self.given,
            determinism=self.determinism,
        )
        command = ("python", "-m", "gpusimbench.recorder.conformance", "--sim", self.name)
        planned = PlannedRun(provenance_now(configuration, command))
        with scratch_folder() as (folder, _):
            with Interruptions() as interruptions:
                result = make(planned, folder, own(), lambda phase, done, of: None, interruptions)
            if interruptions.count:
                raise KeyboardInterrupt
            return read(configuration, result)


def _copy(state: States) -> States:
    return tuple(np.array(array) for array in state)


def _copy_evidence(evidence: Evidence | None) -> Evidence | None:
    return None if evidence is None else evidence.copy()
