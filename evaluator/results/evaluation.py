"""The result of evaluating a set of recordings, before any presentation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from gpusimbench.evaluator.check.rules.findings import Unmet
from gpusimbench.evaluator.inputs.reader import Unreadable
from gpusimbench.evaluator.probe.questions import Probed
from gpusimbench.evaluator.results.convergence import Convergence
from gpusimbench.evaluator.results.determinism_cost import Family
from gpusimbench.evaluator.results.ranking import Comparison
from gpusimbench.evaluator.results.reference import Reference
from gpusimbench.evaluator.results.result import GroupResult, Map
from gpusimbench.evaluator.results.sweeps import Accumulation, Sweep
from gpusimbench.schemas.fields import ENV


@dataclass(frozen=True)
class Evaluation:
    """The result of evaluating a set of recordings.

    sample_time  simulated time at which positions are compared [s]; of most scenes, where it differs
    results      one per group
    unreadable   files that could not be read, with their errors
    reference    None where there is none; `reference_note` says why, or where it came from
    sweeps       groups that differ in the number of environments alone
    accumulation how variability of sweeps goes with the number of environments
    comparison   of simulators: radar and guidelines
    maps         by scene; none for a scene whose positions were not recorded or lie too far apart
    price_list   what levels of determinism cost
    unmet        rules of the benchmark's protocol that the recordings do not meet
    notes        about the set as a whole
    shorter      by scene, the time at which positions are compared instead of `sample_time` [s]: no recording of the
                 scene is as long
    probed       what results depend on, of configurations whose runs answer a question of gsb-probe
    convergences  of groups that differ in the time step alone: how fast states approach those of the finest step
    """

    sample_time: float
    results: tuple[GroupResult, ...]
    unreadable: tuple[Unreadable, ...]
    reference: Reference | None
    reference_note: str
    sweeps: tuple[Sweep, ...]
    accumulation: tuple[Accumulation, ...]
    comparison: Comparison
    maps: dict[str, Map]
    notes: tuple[str, ...] = ()
    price_list: tuple[Family, ...] = ()
    unmet: Unmet = Unmet()
    shorter: Mapping[str, float] = field(default_factory=dict)
    probed: tuple[Probed, ...] = ()
    convergences: tuple[Convergence, ...] = ()

    @property
    def of_programs(self) -> bool:
        """Whether programs logged all recordings: there no real trials and no protocol are to be expected."""
        return all(run.of_program for result in self.results for run in result.group.recordings)

    @property
    def placed(self) -> bool:
        """Whether states of bodies or joints were captured, and not arrays of a task alone."""
        groups = [result.group for result in self.results if result.group.captured]
        return any(field.group != ENV for group in groups for run in group.recordings for field in run.fields)

    @property
    def of_bodies(self) -> bool:
        """Whether where bodies end can be asked: not of tasks, of which programs logged arrays alone."""
        return self.placed or not self.of_programs

    @property
    def timed(self) -> bool:
        """Whether some run was timed."""
        runs = (run for result in self.results for run in result.group.recordings)
        return any("timed" in run.configuration.phases for run in runs)

    def sampled_at(self, scene: str) -> float:
        """Simulated time at which positions of a scene are compared [s]."""
        return self.shorter.get(scene, self.sample_time)

    def sampled(self) -> str:
        """When positions are compared, in words: each time of any scene, such as "t = 1 and 5 s"."""
        times = sorted({self.sampled_at(result.group.key.scene) for result in self.results} or {self.sample_time})
        return f"t = {' and '.join(f'{time:.4g}' for time in times)} s"
