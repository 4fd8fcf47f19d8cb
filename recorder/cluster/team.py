"""The runs of a command on the seats of a cluster: a Maker, as of recorder.sets.series."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import Empty

from gpusimbench.recorder.cluster.batch import Batch, Ended, PhaseReport, Said, lost
from gpusimbench.recorder.cluster.connection import Cluster, Lost
from gpusimbench.recorder.cluster.gathering import Stopped
from gpusimbench.recorder.cluster.node import KILLING
from gpusimbench.recorder.cluster.seats import Seat, Spot, Wanted, needs_gpu, spots
from gpusimbench.recorder.options import parse_options
from gpusimbench.recorder.process.launch import Interruptions, Result
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.sets.progress import SetProgress, say
from gpusimbench.recorder.sets.series import Request
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import ExitCode, GsbError, UsageError
from gpusimbench.schemas.text import plural

_PATIENCE_S = 30.0  # for the seats that others still occupy
_LOOK_S = 0.5  # between looks at what the user wants
_LAST_S = 30.0  # for nodes to tell of runs that were killed


@contextmanager
def team(
    address: str, configuration: RunConfiguration, *, resource: str | None = None, python: Path | None = None
) -> Iterator[Team]:
    """Seats for runs of this configuration on the cluster at that address.

    resource  use only nodes that have this resource of Ray's
    python    interpreter on the nodes; None: the one that each node finds

    UsageError where there is no such cluster, no room on it, or a node that cannot make such runs.
    """
    entry = find_simulator(configuration.simulator)
    scene = configuration.registered_scene
    own = make_scene(scene).own_options if scene else frozenset[str]()
    given = {name: value for name, value in configuration.options.items() if name not in own}
    options = parse_options(configuration.simulator, entry.adapter().Options, given)
    named = "" if python is None else str(python if len(python.parts) == 1 else python.absolute())
    wanted = Wanted(configuration.simulator, configuration.registered_scene, named)
    with Cluster(address) as cluster:
        nodes = cluster.nodes()
        gpu = needs_gpu(configuration, entry.devices, getattr(options, "device", None), nodes)
        room = spots(nodes, gpu=gpu, resource=resource)
        if not room:
            what = "a GPU" if gpu else "CPUs"
            also = f" and the resource '{resource}'" if resource else ""
            raise UsageError(f"none of the {len(nodes)} nodes at '{address}' has {what}{also} for Ray to give")
        with Team(cluster, room, wanted) as hired:
            yield hired


class Team:
    """Seats of one kind, machine and software, that share the runs of a command. A context manager."""

    def __init__(self, cluster: Cluster, spots: Sequence[Spot], wanted: Wanted) -> None:
        self._cluster = cluster
        self._spots = spots
        self._wanted = wanted
        self._seats: list[Seat] = []

    def __enter__(self) -> Team:
        """Wait for the seats, ask each, and keep those of the kind that most are of. UsageError as of Seat.ask."""
        seats = [Seat(self._cluster, spot, self._wanted) for spot in self._spots]
        by_agent = {seat.agent: seat for seat in seats}
        agents, busy = self._cluster.wait_ready(list(by_agent), limit=_PATIENCE_S)
        if busy and not agents:
            say(
                f"others use all that this cluster has ({plural(len(busy), 'run')} at a time); waiting until "
                "something is free"
            )
        while busy and not agents:
            agents, busy = self._cluster.wait_ready(busy, limit=_PATIENCE_S)
        there = [by_agent[agent] for agent in agents]
        with ThreadPoolExecutor(max(1, len(there))) as pool:
            for _ in pool.map(_ask, there):
                pass
        kinds = Counter(seat.where for seat in there if seat.where)
        if not kinds:
            raise GsbError("no node of the cluster answers")
        chosen = max(sorted(kinds), key=lambda where: kinds[where])
        self._seats = [seat for seat in there if seat.where == chosen]
        for seat in seats:
            if seat not in self._seats:
                seat.close()
        nodes = len({seat.spot.node.id for seat in self._seats})
        say(f"{plural(len(self._seats), 'run')} at a time on {plural(nodes, 'node')} of the cluster")
        if busy:
            say(f"left out, since others use them: room for {plural(len(busy), 'run')}")
        if other := len(there) - len(self._seats):
            say(
                f"left out, as machines or packages of another kind: room for {plural(other, 'run')} "
                "(--ray-resource chooses)"
            )
        return self

    def __exit__(self, *details: object) -> None:
        for seat in self._seats:
            seat.close()

    def where(self) -> str:
        """See Maker.where."""
        return self._seats[0].where

    def make(
        self, request: Request, planned: Sequence[RunConfiguration], progress: SetProgress, interruptions: Interruptions
    ) -> Generator[tuple[RunConfiguration, Result], None, None]:
        """See Maker.make. A run whose node dies is made again on another, at most batch.TRIES times in all."""
        batch = Batch(planned)
        workers = [_Worker(seat, batch, request, interruptions) for seat in self._seats]
        for worker in workers:
            worker.thread.start()
        try:
            yield from self._tell(batch, workers, progress, interruptions)
        finally:
            batch.stop()
            for worker in workers:
                worker.seat.interrupt(KILLING)
            deadline = time.monotonic() + _LAST_S
            for worker in workers:
                worker.thread.join(max(0.0, deadline - time.monotonic()))
                if worker.thread.is_alive():
                    worker.seat.close()
            self._seats = [worker.seat for worker in workers if worker.seated and not worker.thread.is_alive()]

    def _tell(
        self, batch: Batch, workers: Sequence[_Worker], progress: SetProgress, interruptions: Interruptions
    ) -> Generator[tuple[RunConfiguration, Result], None, None]:
        passed_on, deadline = 0, None
        while True:
            over = batch.over  # before the look into the news: what ended until then is in it
            for news in _drain(batch, 0 if over else _LOOK_S):
                match news:
                    case Ended(run, result, seconds):
                        progress.finish(result, seconds)
                        yield run, result
                        batch.decide()
                    case PhaseReport(run, phase, done, of):
                        progress.update(run.run_index, phase, done, of)
                    case _:
                        say(news.text)
            if over:
                return
            while passed_on < interruptions.count:
                passed_on += 1
                batch.begin_no_more()
                for worker in workers:
                    worker.seat.interrupt(passed_on)
                if passed_on > 1:
                    deadline = deadline or time.monotonic() + _LAST_S
            if deadline and time.monotonic() > deadline:
                return
            if not any(worker.thread.is_alive() for worker in workers):
                batch.give_up("no node is left to make it")


class _Worker:
    """A seat at work, in a thread of its own.

    seated  whether the seat is there still
    """

    def __init__(self, seat: Seat, batch: Batch, request: Request, interruptions: Interruptions) -> None:
        self.seat = seat
        self.seated = True
        self.thread = threading.Thread(target=self._work, daemon=True)
        self._batch = batch
        self._request = request
        self._interruptions = interruptions

    def _work(self) -> None:
        while self.seated and (run := self._batch.take()) is not None:
            began = time.monotonic()
            result = self._make(run, began)
            if result is not None:
                self._batch.end(run, result, time.monotonic() - began)

    def _make(self, run: RunConfiguration, began: float) -> Result | None:
        # None where the run comes to its end elsewhere, or nowhere
        planned = self._request.planned(run)

        def report(phase: str, done: int, of: int) -> None:
            self._batch.news.put(PhaseReport(run, phase, done, of))

        try:
            last = self.seat.make(planned, report, self._interruptions)
            wanted = self._batch.wait_turn(run)
            result = self.seat.fetch(planned, last, self._request.out, self._unwanted) if wanted else None
            self.seat.let_go()
        except Lost as error:
            why = f"{self.seat.name}: {error}"
            self._batch.lose(run, why, again=not self._interruptions.count, seconds=time.monotonic() - began)
            self.seated = not self._batch.stopped and self.seat.reopen()
            return None
        except Stopped as error:
            self.seat.let_go()
            return Result(run.run_index, "incomplete", str(error), None, ExitCode.FAILURE)
        except Exception as error:  # such as a full disk; in silence, the command would wait for ever
            self.seat.let_go()
            return lost(run, str(error) if isinstance(error, GsbError) else f"{type(error).__name__}: {error}")
        return result

    def _unwanted(self) -> bool:
        return self._batch.stopped or self._interruptions.count > 1


def _ask(seat: Seat) -> None:
    with suppress(Lost):  # it died meanwhile, and is left out
        seat.ask()


def _drain(batch: Batch, patience: float) -> Iterator[PhaseReport | Ended | Said]:
    with suppress(Empty):
        yield batch.news.get(timeout=patience) if patience else batch.news.get_nowait()
        while True:
            yield batch.news.get_nowait()
