"""What a run writes of itself while it goes on: its phases, clocks, events, and the gates that fired."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder import interruption
from gpusimbench.recorder.capture.evidence import EvidenceWriter
from gpusimbench.recorder.capture.samples import Sampling
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.capture.view import LogWriter
from gpusimbench.recorder.probes.host import calendar_ns
from gpusimbench.recorder.simulators.base import Simulator
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.schemas import topics
from gpusimbench.schemas.errors import DataLost
from gpusimbench.schemas.messages import enum_values, message_class

_T = TypeVar("_T")

_NUMBER = re.compile(r"\d+")

_CLOCKED = {
    "build": "import of the engine, sizing of its buffers, loading of the model, allocation",
    "compile_timed": "compilation of what the timed phase runs",
    "compile_capture": "compilation of what the capture phase runs",
}


class Journal:
    """Writes events and clocks of one run into its recording.

    sink       of the recording
    phase      the present one
    problems   cause and sentence of each gate that fired, but for what the simulator says against itself
    said       what that is, by phase
    shown_log  the same events for viewers; None where there are none
    """

    def __init__(self, sink: Sink) -> None:
        self.sink = sink
        self.phase = "baseline"
        self.problems: list[tuple[str, str]] = []
        self.said: dict[str, list[str]] = {}
        self.shown_log: LogWriter | None = None
        self._events = enum_values("gsb.v1.EventKind")

    def event(self, kind: str, text: str = "") -> None:
        """Write an event of the present phase."""
        message = message_class("gsb.v1.Event")(
            kind=self._events[f"EVENT_KIND_{kind}"],
            phase=self.phase,
            monotonic_ns=time.perf_counter_ns(),
            unix_ns=calendar_ns(),
            text=text,
        )
        self.sink.write(topics.RUN_EVENT, message.SerializeToString())
        if self.shown_log:
            self.shown_log.event(kind, message)

    def gate(self, problem: str, cause: str = "ENGINE") -> None:
        """Note why the run is invalid; `cause` is a name of gsb.v1.Cause."""
        self.problems.append((cause, problem))
        self.event("GATE", problem)

    def not_finite(self, problem: str) -> None:
        """Note which state is not finite first, in place of a gate that knew only that one was not in the end."""
        self.problems = [(cause, text) for cause, text in self.problems if cause != "NOT_FINITE"]
        self.gate(problem, "NOT_FINITE")

    @property
    def worth_capturing(self) -> bool:
        """Whether states are of use: no gate fired, or a state is not finite, and those before it show why."""
        return not self.fired or any(cause == "NOT_FINITE" for cause, _ in self.problems)

    @property
    def fired(self) -> bool:
        """Whether any gate did, so that the run is INVALID."""
        return bool(self.problems or self.said)

    @property
    def reason(self) -> tuple[str, str]:
        """Why the run is invalid, and the cause: what was found, and then what the simulator says, each warning once.

        What an engine says against itself does not say of what kind it is, and may follow from the rest. A warning that
        differs in its numbers alone is the same.
        """
        problems = sorted(self.problems, key=lambda problem: problem[0] == "ENGINE")
        parts = list(dict.fromkeys(text for _, text in problems))
        known: set[str] = set()
        again = []
        for phase, fired in self.said.items():
            new = [text for text in fired if _NUMBER.sub("#", text) not in known]
            known |= {_NUMBER.sub("#", text) for text in fired}
            if new:
                parts.append(f"phase {phase}: {'; '.join(dict.fromkeys(new))}")
            else:
                again.append(phase)
        if again:
            parts.append(f"the same in phase{'s' if len(again) > 1 else ''} {' and '.join(again)}")
        return "; ".join(parts), problems[0][0] if problems else "ENGINE"

    def ask_gates(self, simulator: Simulator) -> None:
        """Note what the simulator says against the steps of the present phase: it may say the same of several."""
        fired = simulator.gates()
        for problem in fired:
            self.event("GATE", problem)
        if fired:
            self.said.setdefault(self.phase, []).extend(fired)

    def count(self, found: Evidence | None, counted: EvidenceWriter, first_step: int) -> None:
        """Write what the engine counted from `first_step` on, and note buffers that overflowed."""
        if found is not None:
            self.counted(counted.feed(found, first_step=first_step))

    def counted(self, fired: Sequence[str]) -> None:
        """Note buffers that overflowed, a sentence each."""
        for gate in fired:
            self.gate(gate, "BUFFER")

    def clocked(self, what: str, work: Callable[[], _T]) -> _T:
        """The result of some work, whose duration is written; `what` is "build", "compile_timed"..."""
        start = time.perf_counter_ns()
        done = work()
        clocks = np.array([[start], [time.perf_counter_ns()]], dtype=np.int64)
        self.timing(what, clocks, 0, 1, _CLOCKED[what])
        return done

    def compile(self, simulator: Simulator, phase: str) -> None:
        """Let the engine compile what a phase runs, under clocks of its own."""
        self.clocked(f"compile_{phase}", lambda: simulator.compile(phase))

    def timing(self, what: str, clocks: NDArray[np.int64], first_step: int, interval: int, covers: str) -> None:
        """Write clock readings [ns], shape [2, interval]: begin and end of intervals of so many steps."""
        topic = topics.timing(what)
        self.sink.channel(topic, "gsb.v1.StepTiming", {"clock": "host monotonic [ns]", "covers": covers})
        message = message_class("gsb.v1.StepTiming")(
            first_step=first_step, steps_per_interval=interval, start_ns=clocks[0].tolist(), end_ns=clocks[1].tolist()
        )
        self.sink.write(topic, message.SerializeToString())


class Phase:
    """Marks a phase in the recording and in what is sampled. A context manager."""

    def __init__(self, journal: Journal, sampling: Sampling, name: str) -> None:
        self._journal = journal
        self._sampling = sampling
        self._name = name

    def __enter__(self) -> None:
        interruption.check()
        self._journal.phase = self._name
        self._sampling.enter(self._name)
        self._journal.event("PHASE_BEGIN")

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if isinstance(error, DataLost):
            return  # the file takes nothing more
        self._sampling.leave()
        self._journal.event("PHASE_END")
        self._sampling.drain()
