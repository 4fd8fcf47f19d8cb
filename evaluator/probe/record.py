"""The runs of a probe, made by gsb-record where its folder lacks them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from gpusimbench.evaluator.compute.recorder import record
from gpusimbench.evaluator.probe.finding import Answer
from gpusimbench.evaluator.probe.plan import PRICED, Arm, Plan, arm_of, interleaved
from gpusimbench.evaluator.probe.questions import probed
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.commands.progress import each
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.location import Place, place
from gpusimbench.schemas.text import plural


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
