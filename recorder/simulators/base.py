"""The contract of a simulator adapter. This page is all that an engine must provide.

An adapter holds N identical environments of one scene. The recorder calls, in this order: the constructor, ``vary``
where environments are to differ in their parameters (abilities VARIED_MASS, ...), ``build`` once, ``compile`` once,
then ``prepare``, ``step`` or ``states``, ``evidence`` and ``gates`` any number of times, ``close``; where only failing
environments are kept, ``flight`` instead of ``states``. A capture that needs a fresh start gets a new instance, so
nothing has to be reset for it. ``snapshot``, ``restore``, ``reset`` and ``set_state`` come between steps, where
``state_claims`` offers them; ``set_state`` may come right after ``build`` too, and gives environments initial states of
their own.

Importing an adapter's module must be cheap and must not touch a device: engines are imported in ``build``, when the
environment variables that ``environment`` asks for are set.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.abilities import Ability, listed, titles
from gpusimbench.recorder.options import names_of, parse_options
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.variation import Variation
from gpusimbench.recorder.simulators.captured import Captured, Held, States
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.flight import Flight, HostFlight, Watch
from gpusimbench.recorder.simulators.snapshot import Envs, Extent, Snapshot, StateClaims
from gpusimbench.schemas.action_generator import Streams
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.imported import Imported
from gpusimbench.schemas.provenance import EngineFacts, Simulation

__all__ = ["Ability", "Captured", "Description", "Envs", "Evidence", "Held", "Simulator", "Snapshot", "States"]


@dataclass(frozen=True)
class Description(EngineFacts):
    """What a built simulator says of itself, field by field as of EngineFacts; all of it goes into the recording.

    attachments  files worth keeping, such as the model that was loaded: name -> (media type, bytes)
    """

    attachments: dict[str, tuple[str, bytes]] = field(default_factory=dict)

    def recorded(self, scene: Scene, fresh_start: str) -> Simulation:
        """As the recording has it. fresh_start: how the capture phase came to its initial state."""
        facts = {fact.name: getattr(self, fact.name) for fact in fields(EngineFacts)}
        own = {name: scene.parameters[name] for name in scene.own_options & scene.parameters.keys()}
        facts["options"] = {**facts["options"], **own}
        about = {"name": scene.name, "sha256": scene.sha256(), "parameters": scene.parameters}
        return Simulation(**facts, scene=about, fresh_start=fresh_start)


class Simulator(ABC):
    """N identical environments of one scene on one engine.

    Options          frozen dataclass of the engine's own options; every field has a default
    distribution     what pip installs to have a release of the engine; empty where pip has none
    abilities        what the engine can do, with some of its options at least; none where a class does not say
    timing_interval  steps between two clock readings of the timed phase; 1 unless reading the clock would cost
    determinism_levels    levels that can be asked for, and what each sets, in words; "default" is the engine as it
                          ships
    levels_without_effect  by kind of device ("cpu", "cuda"), levels that are known to change nothing there, and why
    across_releases  options with which all releases of the engine step in the same way, so that two can be compared
    draws_actions    True where the adapter makes the scene's actions on its device, step by step, instead of taking
                     them from ``prepare``
    blocks_ahead     blocks of captured steps that may be begun before the first of them is waited for
    """

    Options: ClassVar[type]
    distribution: ClassVar[str] = ""
    abilities: ClassVar[frozenset[Ability]] = frozenset()
    timing_interval: ClassVar[int] = 1
    determinism_levels: ClassVar[dict[str, str]] = {"default": "the engine as it ships"}
    levels_without_effect: ClassVar[dict[str, dict[str, str]]] = {}
    across_releases: ClassVar[dict[str, str]] = {}
    draws_actions: ClassVar[bool] = False
    blocks_ahead: ClassVar[int] = 1

    def __init__(
        self, scene: Scene, *, n_env: int, dt: float, seed: int, options: Any, determinism: str = "default"
    ) -> None:
        """Keep the arguments; touch no device yet. UsageError where the scene needs an ability that is not there.

        n_env        number of environments
        dt           step [s]
        seed         of whatever the engine draws at random
        options      an instance of Options
        determinism  one of determinism_levels
        """
        if refusal := self.refusal(type(self).__name__, scene, options):
            raise UsageError(refusal)
        self.scene = scene
        self.n_env = n_env
        self.dt = dt
        self.seed = seed
        self.options = options
        self.determinism = determinism
        self.variation: Variation | None = None
        self.streams = Streams.usual(n_env)

    def vary(self, variation: Variation) -> None:
        """Take the parameters of each environment, before ``build``, as far as the abilities go that are offered.

        Environment e is to move as an environment of the scene ``variation.of(self.scene, e)`` does. ``build`` finds
        them in ``self.variation``.
        """
        self.variation = variation

    @classmethod
    def parsed(cls, name: str, scene: Scene, given: Mapping[str, str]) -> Any:
        """Options from text, those that the scene itself has to say included; UsageError as of parse_options.

        name  of the simulator
        """
        takes_models = Ability.MODELS in cls.abilities
        given = {option: value for option, value in given.items() if option not in scene.own_options}
        return parse_options(name, cls.Options, scene.options(given, names_of(cls.Options)) if takes_models else given)

    @classmethod
    def withheld(cls, options: Any) -> dict[Ability, str]:
        """Abilities that the engine has, but not with these options, and what to use instead, such as an option."""
        return {}

    @classmethod
    def offered(cls, options: Any) -> frozenset[Ability]:
        """What the engine can do: its abilities, and initial states per environment where a state can be set."""
        settable = cls.state_claims(options).set_state.extent is not Extent.NONE
        return cls.abilities | ({Ability.ENV_STARTS} if settable else frozenset())

    @classmethod
    def refusal(cls, name: str, scene: Scene, options: Any) -> str:
        """Why the simulator of that name cannot simulate a scene with these options; empty where it can."""
        needs, withheld = scene.needs(), cls.withheld(options)
        if missing := titles(needs - cls.offered(options)):
            why = f"it has no {listed(missing)}"
        elif missing := titles(needs & withheld.keys()):
            instead = dict.fromkeys(how for ability, how in withheld.items() if ability in needs)
            why = f"with these options it has no {listed(missing)}: use {'; '.join(instead)}"
        else:
            return ""
        return f"simulator '{name}' cannot simulate scene '{scene.name}': {why}"

    @classmethod
    def environment(cls, options: Any, determinism: str) -> dict[str, str]:
        """Environment variables that must be set before the engine is imported.

        A variable that the user has set stays as it is; flags of XLA_FLAGS are added to it.
        """
        return {}

    @abstractmethod
    def build(self) -> Description:
        """Load the scene into the engine, in its initial state, ready to step.

        Raises UsageError where the engine was given an option or a scene that it does not take for a reason that no
        ability names, and recorder.failure.Refused where the engine itself does not accept a setting.
        """

    def compile(self, phase: str) -> None:  # noqa: B027 - most engines have nothing to compile
        """Compile what ``step`` ("timed") or ``states`` ("capture") needs, so that neither has to; timed apart."""

    def prepare(self, actions: NDArray[np.float32] | None) -> None:  # noqa: B027 - most scenes have no actions
        """Take the actions of the next steps, shape [step, env, action]; None where the scene has none.

        Outside the timed region: an adapter moves them to its device here. The steps that follow use them in order,
        one row a step; row i is held during step i. None as well for an adapter that draws them itself, by
        ``self.streams`` as they are now: the steps that follow are those after the last one made, beginning with 0.
        """

    def applied(self) -> NDArray[np.float32] | None:
        """The actions that the engine holds from the last step, [env, action], to be compared with what was meant.

        None where the engine cannot tell.
        """
        return None

    @abstractmethod
    def step(self, n_step: int) -> None:
        """Advance all environments by n_step steps; return when the device is done, with nothing copied to the host."""

    @abstractmethod
    def state(self) -> States:
        """The present state: one array [env, item, width] per field, exactly the numbers that the engine holds."""

    def states(self, n_step: int) -> States:
        """Advance by n_step steps and return the state after each: arrays [step, env, item, width].

        Engines that can snapshot on the device override this loop.
        """
        rows = []
        for _ in range(n_step):
            self.step(1)
            rows.append(tuple(array.copy() for array in self.state()))
        return tuple(np.stack(column) for column in zip(*rows, strict=True))

    def reserve(self, n_step: int) -> None:  # noqa: B027 - most engines have nothing to reserve
        """Make room for the blocks of a capture, which have at most n_step steps; called before the first of them."""

    def begin_states(self, n_step: int) -> Captured:
        """Begin what ``states`` does, with the evidence of these steps; return before the device is done, if it can.

        The recorder writes one block while the next ones are being made. At most `blocks_ahead` blocks are not waited
        for yet, and at most RING_BLOCKS (captured.py) are not released. Engines that can go on without waiting for
        their device override this.
        """
        return Held(self.states(n_step), self.evidence())

    def flight(self, watch: Watch) -> Flight:
        """Step on from the present state, holding the last steps alone, and tell which environments fail.

        Nothing but the flight steps the simulator from then on; ``set_state`` may come between two steps. This default
        copies all states to the host; engines that can hold them, and look at them, on their device override it.
        """
        return HostFlight(self, watch)

    @classmethod
    def state_claims(cls, options: Any) -> StateClaims:
        """What the four operations below cover with these options; what is not claimed is not called."""
        return StateClaims()

    def snapshot(self) -> Snapshot:
        """The engine's complete state of all environments, as far as ``state_claims`` says; copies, on the host."""
        raise NotImplementedError

    def restore(self, snapshot: Snapshot, envs: Envs = None) -> None:
        """Bring environments back to a snapshot that this simulator, or one of the same configuration, has made.

        Where all are restored, the steps that follow continue after ``snapshot.step``. Where some are, the others stay
        as they are, and actions go on being those of the steps since the build.
        """
        raise NotImplementedError

    def reset(self, envs: Envs = None) -> None:
        """Bring environments back to the scene's first state by whatever the engine has for it.

        Actions go on being those of the steps since the build, unless all environments are reset.
        """
        raise NotImplementedError

    def set_state(self, states: States, envs: Envs = None) -> None:
        """Give environments positions and velocities; all else is as ``reset`` leaves it.

        states  one array [env of envs, item, width] per field of the Description, as ``state`` returns them
        """
        raise NotImplementedError

    def imported(self) -> Imported | None:
        """The parameters of a model file as the engine holds them, read from what it steps; None where it tells none.

        Called after ``build``, where the scene is a model file. Things have the model's own names; what the engine has
        no name for is called as recorder.simulators.mujoco.imported calls it.
        """
        return None

    def link_poses(self) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Where the engine's own kinematics place the bodies that ``imported`` names, in the present state: positions
        [env, body, 3] in the world's frame [m], and orientations wxyz [env, body, 4]. For who offers ``imported``."""
        raise NotImplementedError

    def hold(self, controls: NDArray[np.float64]) -> None:
        """Hold these controls, [env, actuator] in the order of ``imported``, in all steps until the next ``set_state``.

        For model files without actions. NotImplementedError where environments cannot have controls of their own.
        """
        raise NotImplementedError

    def evidence(self) -> Evidence | None:
        """Counts of the steps of the last call of ``states``, or of the last step, one row, after ``step``.

        After ``step`` the overflow bits are those of all steps since the last call; an engine that clears them at each
        step has to gather them on its device. None where the engine tells nothing.
        """
        return None

    def allocator_bytes(self) -> tuple[int, int] | None:
        """Bytes of device memory in use by the engine's own allocator, and their peak; None where it does not tell."""
        return None

    def gates(self) -> list[str]:
        """Validity gates that fired since the last call, one sentence each: dropped contacts, solver failures, resets.

        Non-finite states and overflow bits need no mention; the recorder looks for them itself.
        """
        return []

    def close(self) -> None:  # noqa: B027 - an engine without resources of its own has nothing to do here
        """Release the device. Called once, also after an error."""
