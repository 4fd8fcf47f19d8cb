"""What comparing recordings found. A value that could not be computed is Missing, or None with a sentence beside it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from gpusimbench.evaluator.diff.program_parts import ProgramDifference
from gpusimbench.evaluator.metrics.divergence import GrowthFit
from gpusimbench.evaluator.missing import Missing
from gpusimbench.schemas.location import Place


class Basis(Enum):
    """What makes two numbers of a field different.

    BITS     any other bit: -0.0 is not 0.0, and NaNs are equal only with the same payload
    FLOAT32  one side is float64: they are further apart than float32 can tell there
    LOCAL    the environments have different origins: without them, they are further apart than the recorded precision
             can tell at that distance from the world's origin
    """

    BITS = "bits"
    FLOAT32 = "float32"
    LOCAL = "local"


class DiffVerdict(Enum):
    """What the comparison comes to, over what was compared."""

    IDENTICAL = "bit-identical"
    WITHIN_RESOLUTION = "equal within the resolution"
    DIFFERENT = "different"


@dataclass(frozen=True)
class Side:
    """One of the two that are compared.

    file    of the recording
    run_id  of its run
    label   simulator and version
    dt      its time step [s]
    envs    its environments: the i-th is compared with the other side's i-th; a single one with all of the other's
    status  of the recording
    lost    one sentence for each thing that the recording should hold and does not
    """

    file: Place
    run_id: str
    label: str
    dt: float
    envs: range
    status: str
    lost: tuple[str, ...]


@dataclass(frozen=True)
class Setting:
    """Something that the two recordings say of themselves and differ in: dotted name, and both values as text."""

    name: str
    a: str
    b: str


@dataclass(frozen=True)
class FieldDifference:
    """A field that both sides have, over all common recorded steps, environments, items and components.

    field             "group/field"
    unit              of its numbers
    basis             what counts as different
    numbers           how many pairs of numbers were compared
    different         how many of them differ
    signed_zeros      of those, pairs of -0.0 and 0.0
    nan_payloads      of those, pairs of NaNs with other bits
    not_finite        of those, pairs of which one or both are not finite, or too far apart for a number
    first_step        first recorded step with a difference, of side a; None where there is none
    first_ulp         largest distance at that step in units in the last place (see `ulp_distance`); of float32 where
                      the basis is FLOAT32; None where the basis is LOCAL, and where nothing differs
    max_ulp           the same over all steps, 0 where nothing differs; None where LOCAL, and without a common state
    max_distance      largest |a - b| [unit] where both are finite; None where that is nowhere. Of quaternions, b is
                      taken with the sign with which it is nearer to a, since q and -q are one rotation
    other_sign        of those that differ, numbers of quaternions with b = -a: the same rotation
    signs_from        first recorded step, of side a, with numbers of opposite signs; None where there is none
    """

    field: str
    unit: str
    basis: Basis
    numbers: int
    different: int
    signed_zeros: int
    nan_payloads: int
    not_finite: int
    first_step: int | None
    first_ulp: int | None
    max_ulp: int | None
    max_distance: float | None
    other_sign: int
    signs_from: int | None


@dataclass(frozen=True)
class ComparedStates:
    """Over what the comparison is.

    fields          by name, with what became of each
    n_env           pairs of environments
    state_steps     common recorded steps of the states, as steps of side a: count, first and last; None without any
    hash_steps      the same of the state hashes; None where they cannot be used, and `hash_steps_missing` says why
    hash_phase      the phase that these hashes are of: "capture", or "timed" where nothing was captured; empty without
    timed_steps     the same of the timed phase's hashes beside those of the capture; None where none can be used
    unseen_steps    steps of either phase at which hashes differ and no state is common: no number of them is known
    left_out        what either side has and the comparison has not, a sentence each
    """

    fields: tuple[FieldDifference, ...]
    n_env: int
    state_steps: StepRange | None
    hash_steps: StepRange | None
    hash_phase: str
    timed_steps: StepRange | None
    unseen_steps: int
    hash_steps_missing: str
    left_out: tuple[str, ...]


@dataclass(frozen=True)
class StepRange:
    """How many steps, and which are the first and the last."""

    count: int
    first: int
    last: int


@dataclass(frozen=True)
class Number:
    """A pair of numbers that differ.

    field, item, component  where; no item where the field is an array of something else than bodies or joints
    unit                    of the values; "unknown" where nothing tells it
    basis                   see Basis
    a, b                    as recorded: the shortest decimal text that gives the same number again
    hex_a, hex_b            their bits
    ulp                     distance in units in the last place; None where the basis is LOCAL, and of whole numbers
    distance                |a - b| [unit], without the environments' origins; None where one is not finite
    resolution              what `distance` had to exceed [unit]; None where the basis is BITS
    other_sign              the two are of quaternions with b = -a: the same rotation
    """

    field: str
    item: str
    component: str
    unit: str
    basis: Basis
    a: str
    b: str
    hex_a: str
    hex_b: str
    ulp: int | None
    distance: float | None
    resolution: float | None
    other_sign: bool


@dataclass(frozen=True)
class StateDifference:
    """The first recorded states that differ.

    step, time     of side a; simulated time [s]
    env_a, env_b   first environments that differ
    envs           how many pairs of environments differ at this step
    fields         names of the fields that differ in any of them
    items          names of the bodies or joints that differ in the first
    number         the first pair of numbers that differ: lowest environment, then field, item and component
    """

    step: int
    time: float
    env_a: int
    env_b: int
    envs: int
    fields: tuple[str, ...]
    items: tuple[str, ...]
    number: Number


@dataclass(frozen=True)
class Contacts:
    """The counter of contacts at a step: mean over all environments, and the largest."""

    mean: float
    max: float


@dataclass(frozen=True)
class Divergence:
    """Where the two part first.

    phase           "capture", or "timed" where nothing of the capture differs
    step_a, step_b  first step at which any environment differs; the two are unequal where dt is
    time            simulated time [s]
    after_step      last common step before it, of side a: up to there all are equal; None where there is none. Where it
                    is not step_a - 1, the first difference lies somewhere in between
    env_a, env_b    first environments that differ at this step
    envs            how many pairs of environments differ at this step
    by_hashes       the step was found by the recorded state hashes
    state           first recorded states that differ; at a later step where none was recorded at this one; None where
                    recorded states are equal again, or there are none
    contacts_a, contacts_b  at that step; None where they were not counted
    begins_episode  an episode of a task begins in that state of env_a or env_b, by a reset after the first one
    """

    phase: str
    step_a: int
    step_b: int
    time: float
    after_step: int | None
    env_a: int
    env_b: int
    envs: int
    by_hashes: bool
    state: StateDifference | None
    contacts_a: Contacts | None
    contacts_b: Contacts | None
    begins_episode: bool

    @property
    def located(self) -> bool:
        """Whether the states of this very step were recorded, so that body, field and component are known."""
        return self.state is not None and self.state.step == self.step_a and self.phase == "capture"


@dataclass(frozen=True)
class Growth:
    """How far bodies lie apart at each common recorded step, over the bodies of all environments. Lists are [step].

    group                          whose positions; all common groups together
    steps                          of side a
    times                          simulated time [s]
    median_planar, max_planar      distance in x and y [m]; None where no pair is finite
    median_spatial, max_spatial    in x, y and z [m]; None likewise, or where heights were not recorded
    not_finite_from                first step with a position that is not finite; None without any
    max_not_fallen                 the largest distance among bodies that have not fallen off the board of the scene
                                   in either recording, in space [m]; empty where the scene has no board, heights were
                                   not recorded, or all bodies have in the end
    fallen                         bodies that have, at the last of these steps
    to_1mm, to_1cm                 first recorded time at which `largest` has that size [s]; None: never
    fit                            exponential growth of `largest`
    """

    groups: tuple[str, ...]
    steps: tuple[int, ...]
    times: tuple[float, ...]
    median_planar: tuple[float | None, ...]
    max_planar: tuple[float | None, ...]
    median_spatial: tuple[float | None, ...]
    max_spatial: tuple[float | None, ...]
    not_finite_from: int | None
    to_1mm: float | None
    to_1cm: float | None
    fit: GrowthFit | Missing
    max_not_fallen: tuple[float | None, ...] = ()
    fallen: int = 0

    @property
    def largest(self) -> tuple[float | None, ...]:
        """The largest distance in space, or in the plane where heights were not recorded; without bodies that have
        fallen off the board, which fall on for as long as is recorded. [step]"""
        if self.max_not_fallen:
            return self.max_not_fallen
        return self.max_spatial if any(d is not None for d in self.max_spatial) else self.max_planar


@dataclass(frozen=True)
class Change:
    """From this step of side a on, so many."""

    step: int
    count: int


@dataclass(frozen=True)
class Splits:
    """Which states are the same, by 64-bit hashes of every number that is compared.

    by_hashes      the recorded hashes were used, otherwise those of the recorded states
    steps          at which this is known
    agreeing       pairs of environments that are equal at a step, where that changes
    distinct_a     distinct states among the environments of side a, where that changes
    distinct_b     the same of side b
    distinct_both  the same of both together
    classes_a      by environment of side a: class of its trajectory; those of one class are equal at every common step
    classes_b      the same of side b, with the same classes
    last_a, last_b classes at the last common step likewise
    classes_missing  why environments can only be compared with their own counterpart, and all of these are None; empty
                   where they can be compared with others
    """

    by_hashes: bool
    steps: StepRange
    agreeing: tuple[Change, ...]
    distinct_a: tuple[Change, ...] | None = None
    distinct_b: tuple[Change, ...] | None = None
    distinct_both: tuple[Change, ...] | None = None
    classes_a: tuple[int, ...] | None = None
    classes_b: tuple[int, ...] | None = None
    last_a: tuple[int, ...] | None = None
    last_b: tuple[int, ...] | None = None
    classes_missing: str = ""


@dataclass(frozen=True)
class Difference:
    """Two sides and what tells them apart.

    a, b                   the sides
    one_recording          both are of one recording
    compared               over what
    bitwise                whether every field could be compared bit by bit
    bit_identical          all that was compared is, bit for bit, hashes of the timed phase included; False where bits
                           could not be compared
    same_up_to_env_order   the environments of b have the trajectories of those of a, in any order; None where that
                           cannot be told
    same_up_to_body_order  at every common recorded state, the bodies of b have the numbers of those of a, in one other
                           order, within each environment or in other environments; None where that was not looked for:
                           nothing differs, environments alone are in another order, or bits cannot be compared
    bodies_of_other_envs   that order is of bodies and of environments
    first                  where they part; None where they do not
    max_ulp                largest of any field that has one, at any common recorded step; None where there is none
    growth                 how far bodies lie apart
    splits                 which states are the same, and when they part
    settings               what configurations, provenance, options, versions and attachments differ in
    other_packages         how many of these, the last, are installed packages that no recorder lists as computing
    copies                 both are recordings of the same run, so that being equal says nothing
    notes                  what a reader must know beside, a sentence each
    described              whether the simulators were described, so that `settings` is of their versions and options
    program                what differs first of states and of arrays that a program hashed; None without such hashes
    """

    a: Side
    b: Side
    one_recording: bool
    compared: ComparedStates
    bitwise: bool
    bit_identical: bool
    same_up_to_env_order: bool | None
    same_up_to_body_order: bool | None
    bodies_of_other_envs: bool
    first: Divergence | None
    max_ulp: int | None
    growth: Growth | Missing
    splits: Splits
    settings: tuple[Setting, ...]
    other_packages: int
    copies: bool
    notes: tuple[str, ...]
    described: bool = True
    program: ProgramDifference | None = None

    @property
    def other_program(self) -> bool:
        """Whether a part of the program differs: its arrays, or what the simulator returned beside them."""
        return self.program is not None and self.program.first is not None

    @property
    def different(self) -> bool:
        """Whether anything that was compared differs."""
        return self.first is not None or self.other_program

    @property
    def verdict(self) -> DiffVerdict:
        """The verdict on the whole comparison."""
        if self.different:
            return DiffVerdict.DIFFERENT
        return DiffVerdict.IDENTICAL if self.bit_identical else DiffVerdict.WITHIN_RESOLUTION

    @property
    def signs_differ(self) -> bool:
        """Whether some numbers have opposite signs, so that `max_ulp` says nothing."""
        return any(field.signs_from is not None for field in self.compared.fields)

    @property
    def same_rotations(self) -> bool:
        """Whether all that differs, as far as states tell, is the sign of quaternions: every rotation is the same."""
        fields = self.compared.fields
        known = self.first is not None and self.first.phase == "capture" and not self.compared.unseen_steps
        return known and any(f.different for f in fields) and all(f.different == f.other_sign for f in fields)

    @property
    def lost(self) -> tuple[str, ...]:
        """What the recordings should hold and do not."""
        return tuple(dict.fromkeys((*self.a.lost, *self.b.lost)))
