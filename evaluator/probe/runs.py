"""The runs that a probe needs, in which order, and which of them are there already; the others are made by
gsb-record."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from gpusimbench.evaluator.compute.recorder import record
from gpusimbench.evaluator.probe.finding import Answer
from gpusimbench.evaluator.probe.questions import probed
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.commands.progress import each
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.initial import INITIAL_KINDS, Initial, drawn
from gpusimbench.schemas.location import Place, place
from gpusimbench.schemas.text import plural
from gpusimbench.schemas.treatment import KINDS, Intervention, Vary

CONFIRMED = 3
"""Runs of an arm that differs, in all."""

MANY = 8
"""States of so many times more environments are not worth their room: hashes tell what differs, and since when."""

PRICED = 4
"""Runs of each level that are clocked for its price."""


@dataclass(frozen=True)
class Arm:
    """One run: how it is treated.

    initial   as of a RunConfiguration; "snapshot:STEP": it continues, in a process of its own, the run that saved it
    timed     whether it has a timed phase: beside the capture, so that both can be compared, or alone, for a price
    captured  whether states are captured
    snapshot  step after which the engine's whole state is saved; 0: it is not
    """

    n_env: int
    initial: str = ""
    intervention: str = ""
    timed: bool = False
    captured: bool = True
    snapshot: int = 0

    @property
    def continued(self) -> int:
        """The step of the snapshot that it begins with; 0 where it begins at the beginning."""
        kind, _, step = self.initial.partition(":")
        return int(step) if kind == "snapshot" else 0

    @property
    def words(self) -> str:
        """What is special about it, for who waits for it."""
        saved = f"snapshot after step {self.snapshot}" if self.snapshot else ""
        return ", ".join(filter(None, (plural(self.n_env, "env"), self.initial, self.intervention, saved)))


def interleaved(plans: Sequence[Plan]) -> Iterator[Plan]:
    """The levels of a simulator in the order in which they are clocked: A B B A A B B A, so that drift cancels out."""
    for round_ in range(PRICED):
        yield from plans if round_ % 2 == 0 else reversed(plans)


def arm_of(c: RunConfiguration) -> Arm:
    """How a run was treated."""
    begins = ":".join(c.initial.split(":")[:2]) if c.initial.startswith("snapshot:") else c.initial
    saved = c.snapshots[0] if c.snapshots else 0
    return Arm(c.n_env, begins, c.intervention, "timed" in c.phases, "capture" in c.phases, saved)


@dataclass(frozen=True)
class Model:
    """A model file that is probed in place of a registered scene; its actuators are given random controls.

    path    of the file, as gsb-record takes it
    sha256  of its files, as of a RunConfiguration
    """

    path: str
    sha256: str


@dataclass(frozen=True)
class Plan:
    """The probe of one simulator at one level of determinism.

    simulator, scene, determinism, options, seed  as of gsb-record
    steps    captured in each run
    n_env    environments of the usual runs
    numbers  other numbers of environments
    spread   of initial states that differ [m/s or rad]
    vary     parameters that differ from environment to environment, as of a RunConfiguration, for environments in
             their usual slots; empty: none. They change slots where initial states do, and are others where those are
    stride   of the recorded states, which divides `steps`; hashes are recorded at every step. Of runs with more than
             MANY times as many environments as the usual ones, only the first and the last state are recorded
    model    a model file in place of the scene; None: the scene is a registered one
    """

    simulator: str
    scene: str
    determinism: str
    options: tuple[str, ...]
    seed: int
    steps: int
    n_env: int
    numbers: tuple[int, ...]
    spread: float
    stride: int = 1
    vary: str = ""
    model: Model | None = None

    def arms(self) -> Iterator[Arm]:
        """All runs, in order: those that are alike come first and last, so that a drift of the machine shows."""
        varied = Initial(self.spread)
        at, more = self.steps // 3, max(1, self.steps // 10)
        plain, usual = Arm(self.n_env, timed=True), Arm(self.n_env, str(varied))
        yield from (plain, usual)
        yield from (Arm(n, str(varied)) for n in self.numbers if n != self.n_env)
        for changed in INITIAL_KINDS.values():
            for value in changed.probed(self.n_env):
                yield Arm(self.n_env, str(varied.of_kind(changed.name, value)))
        for kind in KINDS.values():
            intervention = Intervention(kind.name, at, more if kind.more else 0)
            if kind.probed and intervention.treated(self.n_env):
                yield Arm(self.n_env, str(varied), str(intervention))
        if saved := max(self.stride, at // self.stride * self.stride) % self.steps:  # of a step whose state is recorded
            yield from (replace(usual, snapshot=saved), Arm(self.n_env, f"snapshot:{saved}"))
        yield from (usual, plain)

    @property
    def priced(self) -> Arm:
        """The run that is clocked at each level, with as many environments as there are in any arm."""
        return Arm(max(self.n_env, *self.numbers), timed=True, captured=False)

    def missing(self, recorded: Iterable[RunConfiguration], again: Iterable[Arm] = ()) -> list[Arm]:
        """Arms that are not among the runs of a folder that have ended.

        again  arms that differ from others: CONFIRMED runs of each tell that from differences between runs
        """
        there = Counter(arm_of(c) for c in recorded if self.has(c))
        planned = Counter(self.arms())
        more = (arm for turn in range(CONFIRMED) for arm in again if planned[arm] <= turn)
        left = []
        for arm in (*self.arms(), *more):
            there[arm] -= 1
            if there[arm] < 0:
                left.append(arm)
        return left

    def has(self, c: RunConfiguration) -> bool:
        """Whether a run is an arm of this plan."""
        scene, wanted = (c.model, self.model.sha256) if self.model else (c.registered_scene, self.scene)
        found = (c.simulator, scene, c.determinism, c.seed, c.steps, c.stride, c.option_words)
        asked = (
            self.simulator, wanted, self.determinism, self.seed, self.steps, self._stride(c.n_env),
            sorted(self.options),
        )  # fmt: skip
        settings = {"initial": c.initial, "vary": self._varied(c.initial), "intervention": c.intervention}
        if dict(c.settings) != {name: value for name, value in settings.items() if value}:
            return False
        return found == asked and arm_of(c) in {*self.arms(), self.priced}

    def _varied(self, begins: str) -> str:
        # parameters of environments that begin so
        initial = drawn(begins)
        if not self.vary or initial is None:
            return self.vary
        return str(Vary(Vary.parse(self.vary).spreads, initial.shift, initial.but))

    def _stride(self, n_env: int) -> int:
        return self.steps if n_env > MANY * self.n_env else self.stride

    def arguments(self, arm: Arm, out: str, saved: str = "") -> list[str]:
        """Arguments of gsb-record for one arm.

        saved  the recording with the snapshot that a continued arm begins with
        """
        if arm.continued:
            given = ["--replay", saved, "--from", str(arm.continued), *(["--allow-model"] if self.model else [])]
            return [*given, "--no-view", "--compression", "zstd", "--out", out]
        scene = ["--model", self.model.path] if self.model else ["--scene", self.scene]
        given = ["--sim", self.simulator, *scene, "--determinism", self.determinism]
        given += [f"--option={option}" for option in self.options]
        given += ["--n-env", str(arm.n_env), "--runs", "1", "--steps", str(self.steps), "--seed", str(self.seed)]
        given += ["--stride", str(self._stride(arm.n_env))]
        given += ["--initial", arm.initial] if arm.initial else []
        given += ["--vary", self._varied(arm.initial)] if self.vary else []
        given += ["--intervene", arm.intervention] if arm.intervention else []
        given += ["--snapshot", str(arm.snapshot)] if arm.snapshot else []
        # the timed phase passes the step at which the capture ends, so that both have a hash of it
        first = self.steps // 2
        if not arm.captured:
            given += ["--phases", "timed", "--warmup", str(first), "--timed-steps", str(self.steps)]
        elif arm.timed:
            given += ["--warmup", str(first), "--timed-steps", str(self.steps - first)]
        else:
            given += ["--phases", "capture"]
        return [*given, "--no-view", "--compression", "zstd", "--out", out]

    def command(self, arm: Arm, out: str, saved: str = "") -> str:
        """The command that records an arm, as a user would type it."""
        return shlex.join(["gsb-record", *self.arguments(arm, out, saved)])


class ProbeFolder:
    """A folder with the recordings of probes; must be held by nobody else while runs are made.

    problems  runs that could not be recorded, a line each
    """

    def __init__(self, path: Path, say: Callable[[str], None]) -> None:
        """say: gets a line for each run that fails, and for what a simulator refuses."""
        self.path = path
        self.problems: list[str] = []
        self._say = say

    def record(self, plans: Sequence[Plan]) -> list[Place]:
        """Make the runs that are missing; the recordings of all plans.

        UsageError where a simulator takes no run at all, GsbError where gsb-record cannot be run.
        """
        for plan in plans:
            self._record_arms(plan)
        together = gathered(((plan.simulator, plan.scene, plan.options), plan) for plan in plans)
        for levels in together.values():
            self._clock(levels)
        return [recording.path for plan in plans for recording in self._runs(plan)]

    def _record_arms(self, plan: Plan) -> None:
        title = f"recording {plan.simulator}, {plan.determinism}"
        refused = self._record_each(plan, plan.missing(self._configurations(plan)), title)
        again = plan.missing(self._configurations(plan), differing(self._runs(plan)))
        self._record_each(plan, [arm for arm in again if arm not in refused], f"{title} once more")
        for why in dict.fromkeys(refused.values()):  # an ability that is missing is an answer
            count = sum(reason == why for reason in refused.values())
            self._say(f"{plural(count, 'arm')} not recorded: {why}")

    def _record_each(self, plan: Plan, arms: list[Arm], title: str) -> dict[Arm, str]:
        """Make the runs of these arms; returns those that the simulator refuses, with its reason."""
        refused: dict[Arm, str] = {}
        for arm in each(arms, title, [plan.n_env + arm.n_env for arm in arms]):
            if arm not in refused and (why := self._make(plan, arm)):
                refused[arm] = why
        return refused

    def _clock(self, levels: list[Plan]) -> None:
        """Make the runs that tell what each level of determinism costs; none where there is one level alone."""
        if len(levels) < 2:
            return
        there = {plan: sum(arm_of(c) == plan.priced for c in self._configurations(plan)) for plan in levels}
        order = list(interleaved(levels))
        left = [plan for at, plan in enumerate(order) if order[:at].count(plan) >= there[plan]]
        for plan in each(left, f"clocking {levels[0].simulator}, {PRICED} runs a level"):
            self._make(plan, plan.priced)

    def _make(self, plan: Plan, arm: Arm) -> str:
        """Make the run of an arm; returns why the simulator refuses what is done to it."""
        saved = self._snapshot_for(plan, arm) if arm.continued else ""
        if arm.continued and not saved:
            return "there is no snapshot to continue"
        made, refused = record(plan.arguments(arm, str(self.path), saved), lambda text: None)
        for run in made:
            if run.file is None or run.status == "stopped":
                self.problems.append(f"{plan.command(arm, str(self.path), saved)}: {run.status}: {run.reason}")
                self._say(self.problems[-1])
        if refused and not arm.intervention and not arm.initial:
            raise UsageError(refused)
        return refused

    def _snapshot_for(self, plan: Plan, arm: Arm) -> str:
        """The latest recording with the snapshot that an arm continues; empty without one."""
        found = [r for r in self._runs(plan) if arm.continued in r.configuration.snapshots and r.status == "complete"]
        return str(found[-1].path) if found else ""

    def _runs(self, plan: Plan) -> list[Recording]:
        found = (Recording(place(str(path))) for path in sorted(self.path.glob("*.mcap")))
        return [r for r in found if r.status != "incomplete" and plan.has(r.configuration)]

    def _configurations(self, plan: Plan) -> list[RunConfiguration]:
        return [recording.configuration for recording in self._runs(plan)]


def differing(recordings: Sequence[Recording]) -> list[Arm]:
    """Arms of which something differs: more runs of them tell whether that is more than runs do anyway."""
    at = {recording.path: arm_of(recording.configuration) for recording in recordings}
    no = (f for one in probed(recordings) for f in one.findings if f.answer is Answer.NO and f.found is not None)
    return list(dict.fromkeys(at[path] for finding in no if finding.found for path in finding.found.files))
