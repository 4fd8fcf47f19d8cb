"""MuJoCo C with one defect each; what is wrong with an adapter is its docstring."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gpusimbench.recorder.conformance.checks.motion import turn_between
from gpusimbench.recorder.simulators.base import Simulator
from gpusimbench.recorder.simulators.captured import Held
from gpusimbench.recorder.simulators.evidence import CONTACTS, Evidence
from gpusimbench.recorder.simulators.flight import HostFlight
from gpusimbench.recorder.simulators.mujoco.simulator import MujocoC
from gpusimbench.recorder.simulators.snapshot import Claim, Extent
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.provenance import Buffer, Counter, OverflowBit


class Spoiled(MujocoC):
    """MuJoCo C whose states all pass through `spoil`: field, array [..., env, item, width], step of each row."""

    def spoil(self, field: Any, array: Any, step: Any) -> Any:
        return array

    def build(self):
        description = super().build()
        self.done, self.fields = 0, description.fields
        return description

    def step(self, n_step):
        super().step(n_step)
        self.done += n_step

    def state(self):
        return tuple(self.spoil(f, a, self.done) for f, a in zip(self.fields, super().state(), strict=True))

    def states(self, n_step):
        steps = self.done + np.arange(1, n_step + 1).reshape(-1, 1, 1, 1)
        arrays = super().states(n_step)
        return tuple(self.spoil(f, a, steps) for f, a in zip(self.fields, arrays, strict=True))


class Apart(Spoiled):
    """Not broken: records float32 in the world's frame, with environments at origins."""

    origins: tuple[Any, ...] = ((0.0, 0.0, 0.0), (-5.0, 0.0, 0.0), (0.0, 1e4, 0.0))
    frame = "world"

    def build(self):
        description = super().build()
        self.fields = tuple(
            replace(f, dtype="float32", frame=self.frame if f.field == "position" else f.frame)
            for f in description.fields
        )
        return replace(description, fields=self.fields, env_origins=self.said())

    def said(self):
        return self.origins[: self.n_env]

    def added(self):
        return np.array(self.origins[: self.n_env])[:, None]

    def spoil(self, field, array, step):
        return (array + self.added() if field.field == "position" else array).astype(np.float32)

    def set_state(self, states, envs=None):
        rows = slice(None) if envs is None else envs
        layouts = zip(self.fields, states, strict=True)
        given = (a.astype(np.float64) - (self.added()[rows] if f.field == "position" else 0) for f, a in layouts)
        super().set_state(tuple(given), envs)


class ApartAndRelative(Apart):
    """Not broken: as SAPIEN on a GPU, it has origins and gives positions without them."""

    frame = "env"

    def spoil(self, field, array, step):
        there = super().spoil(field, array, step)
        return (there - self.added().astype(np.float32)) if field.field == "position" else there

    def set_state(self, states, envs=None):
        Spoiled.set_state(self, tuple(array.astype(np.float64) for array in states), envs)


class OtherOrigin(Apart):
    """Says another origin than the one at which it puts an environment."""

    def said(self):
        return tuple((-x, y, z) for x, y, z in super().said())


class NoOrigins(Apart):
    """Says nothing of origins that are in its positions."""

    def said(self):
        return ()


class OriginTwice(Apart):
    """Calls positions relative to the environment, which are not."""

    frame = "env"


class OtherFrame(MujocoC):
    """Gives positions in a frame that the format does not have."""

    def build(self):
        description = super().build()
        fields = (replace(f, frame="body") if f.field == "position" else f for f in description.fields)
        return replace(description, fields=tuple(fields))


class EndlessOrigin(Apart):
    """Has an origin that is nowhere."""

    def said(self):
        return ((float("nan"), 0.0, 0.0), *super().said()[1:])


class FallsAside(Apart):
    """Far away, bodies creep by a little more than rounding would move them."""

    def spoil(self, field, array, step):
        creep = 1.2e-3 * np.asarray(step) * np.array([0.0, 1.0, 0.0])
        return super().spoil(field, array + creep if field.name == "cubes/position" else array, step)


class Xyzw(Spoiled):
    """Gives quaternions xyzw."""

    def spoil(self, field, array, step):
        return np.roll(array, -1, axis=-1) if field.field == "orientation" else array


class BodyFrame(MujocoC):
    """Gives angular velocities as MuJoCo holds them: in the body's frame."""

    def state(self):
        return self.raw(super().state(), self._worlds.read("qvel"))

    def states(self, n_step):
        rows = []
        for _ in range(n_step):
            self.step(1)
            rows.append(tuple(np.array(a) for a in self.state()))
        return tuple(np.stack(column) for column in zip(*rows, strict=True))

    def raw(self, state, qvel):
        state = list(state)
        for k, part in enumerate(self._compiled.layout):
            state[4 * k + 3] = qvel[..., part.at_qvel][..., 3:]
        return tuple(state)


class LeftHanded(Spoiled):
    """Turns the wrong way about the axis that it reports."""

    def spoil(self, field, array, step):
        if field.field != "orientation":
            return array
        bodies = {body.name: body for body in self.scene.moving()}
        start = np.array([bodies[item].orientation for item in field.items])
        half = turn_between(start, array) / -2
        angle = np.linalg.norm(half, axis=-1, keepdims=True)
        unit = np.divide(half, angle, out=np.zeros_like(half), where=angle > 0)
        scalar, vector = np.cos(angle), unit * np.sin(angle)
        return np.concatenate(
            [
                scalar * start[..., :1] - np.sum(vector * start[..., 1:], axis=-1, keepdims=True),
                scalar * start[..., 1:] + start[..., :1] * vector + np.cross(vector, start[..., 1:]),
            ],
            axis=-1,
        )


class Unnormalised(Spoiled):
    """Lets quaternions grow."""

    def spoil(self, field, array, step):
        return array * (1 + 1e-5 * np.asarray(step)) if field.field == "orientation" else array


class Weightless(MujocoC):
    """Leaves gravity out."""

    def __init__(self, scene, **keywords):
        super().__init__(replace(scene, gravity=(0.0, 0.0, 0.0)), **keywords)


class StandardGravity(MujocoC):
    """Uses the standard's 9.80665 m/s2 instead of the scene's 9.81."""

    def __init__(self, scene, **keywords):
        super().__init__(replace(scene, gravity=(0.0, 0.0, -9.80665)), **keywords)


class Drifting(Spoiled):
    """Lets cubes creep by 0.1 mm a step."""

    def spoil(self, field, array, step):
        creep = 1e-4 * np.asarray(step) * np.array([1.0, 0.0, 0.0])
        return array + creep if field.name == "cubes/position" else array


class NotANumber(Spoiled):
    """Has a velocity that is no number at step 20."""

    def spoil(self, field, array, step):
        return np.where(np.asarray(step) == 20, np.nan, array) if field.name == "flying/linear_velocity" else array


class StepsWhileBuilding(MujocoC):
    """Gives the state after one step as the first one."""

    def build(self):
        description = super().build()
        super().step(1)
        return description


class StepsWhileCompiling(MujocoC):
    """Makes a step to compile it."""

    def compile(self, phase):
        super().step(1)


class EnvsApart(Spoiled):
    """Lets environments begin differently, by less than anybody would see."""

    def spoil(self, field, array, step):
        return array + 1e-9 * np.arange(array.shape[-3])[:, None, None] if field.field == "position" else array


class OtherUnit(MujocoC):
    """Declares degrees."""

    def build(self):
        description = super().build()
        fields = (replace(f, unit="deg/s") if f.field == "angular_velocity" else f for f in description.fields)
        return replace(description, fields=tuple(fields))


class OtherDtype(Spoiled):
    """Declares float64 and gives float32."""

    def spoil(self, field, array, step):
        return array.astype(np.float32)


class OtherOrder(MujocoC):
    """Names the bodies in another order than the scene."""

    def build(self):
        description = super().build()
        return replace(description, fields=tuple(replace(f, items=f.items[::-1]) for f in description.fields))


class Silent(MujocoC):
    """Does not say what its clocks cover."""

    def build(self):
        return replace(super().build(), timing_covers="")


class HidesAnOption(MujocoC):
    """Does not say which cone it uses."""

    def build(self):
        description = super().build()
        return replace(description, options={k: v for k, v in description.options.items() if k != "cone"})


class NoDefaultLevel(MujocoC):
    """Cannot be left as the engine ships."""

    determinism_levels = {"strict": "everything"}


@dataclass(frozen=True)
class NeedsAnOption:
    """Options of which one must be given."""

    colour: str


class NoDefaultOption(MujocoC):
    """Cannot be made without options."""

    Options = NeedsAnOption


class Gated(MujocoC):
    """Finds something wrong."""

    def gates(self):
        return ["contacts were dropped"]


class Counting(MujocoC):
    """Declares and counts as it is told."""

    counters: tuple[Counter, ...] = (CONTACTS, Counter("constraint_rows", "rows"))
    buffers: tuple[Buffer, ...] = ()
    bits: tuple[OverflowBit, ...] = ()
    mask = 0

    def build(self):
        described = super().build()
        return replace(described, counters=self.counters, buffers=self.buffers, overflow_bits=self.bits)

    def counted(self, counts):
        return counts

    def evidence(self):
        counts = self.counted(super().evidence().counts)
        some = next(iter(counts.values()))
        return Evidence(counts, np.full(some.shape, self.mask, dtype=np.uint32) if self.bits else None)


class MisnamedCounter(Counting):
    """Counts under another name than it declares."""

    counters = (CONTACTS, Counter("rows", "constraint rows"))


class TooFewRows(Counting):
    """Counts the last step only."""

    def counted(self, counts):
        return {name: rows[-1:] for name, rows in counts.items()}


class NoContacts(Counting):
    """Loses the contacts of the stack."""

    def counted(self, counts):
        return {**counts, "contacts": counts["contacts"] - 8}


class StaleCounts(Counting):
    """Gives the counts of the last step for every step."""

    def counted(self, counts):
        return {name: np.repeat(rows[-1:], len(rows), axis=0) for name, rows in counts.items()}


class LateCounts(Counting):
    """Gives, for states, the counts of the step before."""

    def counted(self, counts):
        return {name: np.roll(rows, 1, axis=0) for name, rows in counts.items()}


class Overflowing(Counting):
    """Drops contacts."""

    bits = (OverflowBit(3, "NARROWPHASE", fatal=True), OverflowBit(9, "ITERATIONS", fatal=False))
    mask = 1 << 3


class UnknownBit(Overflowing):
    """Sets a bit that it does not declare."""

    mask = 1 << 5


class FullBuffer(Counting):
    """Has a buffer that is as large as what was needed."""

    buffers = (Buffer("nconmax", 10, "env", CONTACTS.name, "guessed"),)


class UnmeasuredBuffer(Counting):
    """Does not say where a buffer's size comes from."""

    buffers = (Buffer("nconmax", 100, "env", CONTACTS.name),)


class StepsOtherwise(Spoiled):
    """Captures something else than it steps."""

    def states(self, n_step):
        return tuple(array + 1e-12 for array in super().states(n_step))


class Overwriting(MujocoC):
    """Captures into the same memory again and again."""

    memory: Any = None

    def states(self, n_step):
        arrays = super().states(n_step)
        if self.memory is None:
            self.memory = tuple(np.array(array) for array in arrays)
        for kept, array in zip(self.memory, arrays, strict=True):
            kept[:n_step] = array
        return tuple(array[:n_step] for array in self.memory)


class OtherActions(MujocoC):
    """Applies the targets of the step before."""

    def prepare(self, actions):
        super().prepare(None if actions is None else np.roll(actions, 1, axis=0))


class OwnActions(MujocoC):
    """Gives each environment the targets of its slot, whichever it is given."""

    done = 0

    def prepare(self, actions):
        if actions is not None:
            first, self.done = self.done, self.done + len(actions)
            actions = self.scene.actions.draw(self.seed, n_env=self.n_env, first_step=first, n_step=len(actions))
        super().prepare(actions)


class FirstEnvOnly(MujocoC):
    """Gives all environments the first one's targets, and does not tell."""

    def prepare(self, actions):
        super().prepare(None if actions is None else np.repeat(actions[:, :1], self.n_env, axis=1))

    def applied(self):
        return None


class Choosy(MujocoC):
    """Has the abilities that free-fall needs, and refuses it."""

    def build(self):
        if self.scene.name == "free-fall":
            raise UsageError("no planes")
        return super().build()


class OneSlot(MujocoC):
    """Gives every block of captured steps in the same memory."""

    blocks_ahead = 2

    def begin_states(self, n_step):
        block = super().begin_states(n_step)
        arrays = block.states(slice(None))
        if not hasattr(self, "slot"):
            self.slot = tuple(array.copy() for array in arrays)
        for slot, array in zip(self.slot, arrays, strict=True):
            slot[:n_step] = array[: len(slot)]
        return Held(tuple(slot[:n_step] for slot in self.slot), block.evidence())


class OneStepBehind(MujocoC):
    """Holds in a flight, for each step, the state of the one before."""

    def flight(self, watch):
        class Behind(HostFlight):
            def window(self, env, first, last):
                return tuple(np.roll(array, 1, axis=0) for array in super().window(env, first, last))

        return Behind(self, watch)


class LooksElsewhere(MujocoC):
    """Finds in a flight who leaves bounds a hundredth as wide."""

    def flight(self, watch):
        return HostFlight(self, replace(watch, within=watch.within / 100))


class ForgetsTheWarmStart(MujocoC):
    """Saves what mjSTATE_FULLPHYSICS has, and calls that complete."""

    def restore(self, snapshot, envs=None):
        kept = {**snapshot.arrays, "qacc_warmstart": np.zeros_like(snapshot.arrays["qacc_warmstart"])}
        super().restore(replace(snapshot, arrays=kept), envs)


class RestoresAll(MujocoC):
    """Restores all environments where some are asked for."""

    def restore(self, snapshot, envs=None):
        super().restore(snapshot)


class ResetKeepsSpeeds(MujocoC):
    """Lets bodies fly on after a reset."""

    def reset(self, envs=None):
        speeds = self._worlds.read("qvel").copy()
        super().reset(envs)
        self._worlds.write("qvel", speeds)


class ResetKeepsTheWarmStart(MujocoC):
    """Writes the first positions and velocities, and calls that a reset."""

    def reset(self, envs=None):
        self._worlds.write("qpos", self._compiled.qpos0, envs)
        self._worlds.write("qvel", self._compiled.qvel0, envs)


class ResetsAll(MujocoC):
    """Resets all environments where some are asked for."""

    def reset(self, envs=None):
        super().reset()


class SetsPosesOnly(MujocoC):
    """Forgets the velocities that it is given."""

    def set_state(self, states, envs=None):
        super().set_state(states, envs)
        self._worlds.write("qvel", self._compiled.qvel0, envs)


class LosesItsStart(MujocoC):
    """Goes back to the scene's first state when it compiles."""

    def compile(self, phase):
        self.reset()


class WarmsUpAgain(MujocoC):
    """Loses the warm start, and nothing that is shown, when it compiles."""

    def compile(self, phase):
        self._worlds.write("qacc_warmstart", np.zeros_like(self._worlds.read("qacc_warmstart")))


class SetsNothingElse(MujocoC):
    """Keeps the warm start where it is given another state."""

    def set_state(self, states, envs=None):
        for name, values in zip(("qpos", "qvel"), self._compiled.joined(states), strict=True):
            self._worlds.write(name, values, envs)


class ClaimsTooMuch(Spoiled):
    """Claims to save the state, and has no method for it."""

    snapshot, restore = Simulator.snapshot, Simulator.restore


class SaysNotWhatIsMissing(MujocoC):
    """Claims a partial reset, and does not say what is missing."""

    @classmethod
    def state_claims(cls, options):
        return replace(super().state_claims(options), reset=Claim(Extent.PARTIAL))


class FirstEnvsMasses(MujocoC):
    """Gives all environments the masses of the first one."""

    def vary(self, variation):
        first = variation.alike(0).factors["mass"]
        super().vary(replace(variation, factors={**variation.factors, "mass": first}))


class MassesAlone(MujocoC):
    """Gives environments masses and leaves what follows from them, such as the inverse weights of constraints."""

    def build(self):
        description = super().build()
        common = self._compiled.model
        for model in self._worlds._batch._models or ():
            for name in ("body_invweight0", "dof_invweight0", "body_inertia"):
                getattr(model, name)[:] = getattr(common, name)
        return description


class FirstEnvsSizes(MujocoC):
    """Gives all environments the sizes of the first one."""

    def vary(self, variation):
        super().vary(replace(variation, factors={**variation.factors, "size": variation.alike(0).factors["size"]}))


class AllAlike(MujocoC):
    """Takes parameters per environment, and builds the scene as it is."""

    def vary(self, variation):
        pass
