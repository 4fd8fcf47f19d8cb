"""Where on a cluster runs are made: seats, each of which makes one run at a time."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from gpusimbench.recorder.cluster.connection import Cluster, Lost, Node
from gpusimbench.recorder.cluster.gathering import Spoiled, gather
from gpusimbench.recorder.cluster.node import code
from gpusimbench.recorder.process.launch import Interruptions, Result
from gpusimbench.recorder.process.planned_run import PlannedRun
from gpusimbench.recorder.run.pace import Report
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import ExitCode, UsageError

_REOPEN_S = 60.0  # for another agent on a node whose first was lost: or else the node is


@dataclass(frozen=True)
class Spot:
    """A part of a node that a run has to itself.

    cpus, gpus  that Ray gives to nobody else meanwhile
    """

    node: Node
    cpus: int
    gpus: int


def spots(nodes: Iterable[Node], *, gpu: bool, resource: str | None = None) -> list[Spot]:
    """What the nodes have room for: one run a GPU, or one run a node with all its CPUs.

    gpu       runs step on a GPU: nodes without one have no room. A GPU comes with its share of the node's CPUs
    resource  leave out nodes that do not have this resource of Ray's
    """
    found = []
    for node in nodes:
        if resource is not None and node.resources.get(resource, 0) <= 0:
            continue
        if gpu:
            found += [Spot(node, node.cpus // node.gpus, 1) for _ in range(node.gpus)]
        elif node.cpus:
            found.append(Spot(node, node.cpus, 0))
    return found


@dataclass(frozen=True)
class Wanted:
    """What every run of a command is of.

    scene   name of a registered scene; None: the runs bring their own
    python  interpreter on the nodes, as the user gave it; empty: the one that each node finds
    """

    simulator: str
    scene: str | None
    python: str = ""


class Seat:
    """One spot, held for as long as the command runs.

    where  machine and software, as of recorder.sets.finished; known once it was asked
    """

    def __init__(self, cluster: Cluster, spot: Spot, wanted: Wanted) -> None:
        self.spot = spot
        self.where = ""
        self._cluster = cluster
        self._wanted = wanted
        self._key = ""
        self.agent = cluster.new_agent(spot.node, cpus=spot.cpus, gpus=spot.gpus)

    @property
    def name(self) -> str:
        """For people."""
        return f"node {self.spot.node.address}"

    def ask(self) -> None:
        """Whether runs can be made here, and with what. UsageError says why not; Lost where nobody answers."""
        last = self._talk("check", None, lambda phase, done, of: None, Interruptions())
        if "error" in last:
            raise UsageError(f"{self.name} cannot record this: {last['error']}")
        if "where" not in last:
            raise UsageError(
                f"{self.name} does not run this project's code: {last['said']}; install gpusimbench in the Python that "
                f"its Ray was started with, or share this checkout with it (PYTHONPATH)"
            )
        self.where = last["where"]
        self.let_go()

    def make(self, planned: PlannedRun, report: Report, interruptions: Interruptions) -> dict[str, Any]:
        """Make a run; returns what the node says of it. Its files stay there until let_go.

        Lost where the agent is, or the process that it started.
        """
        last = self._talk(planned.provenance.run_id, planned, report, interruptions)
        if "result" not in last and "error" not in last:
            raise Lost(f"the process that followed the run ended: {last['said']}")
        return last

    def fetch(self, planned: PlannedRun, last: dict[str, Any], folder: Path, stop: Callable[[], bool]) -> Result:
        """The result of a run that was made, and its files in a folder here. Errors as of gather, and Lost."""
        index = planned.configuration.run_index
        if "error" in last:
            return Result(index, "incomplete", f"{self.name}: {last['error']}", None, ExitCode(last["exit_code"]))

        def read(path: str, offset: int, length: int) -> bytes:
            piece: bytes = self._cluster.call(self.agent, "piece", path, offset, length)
            return piece

        said, source = last["result"], last["folder"]
        try:
            here = gather(planned, last["files"], source, folder, read, stop)
        except Spoiled as error:
            raise Lost(str(error)) from None
        reason = said["reason"]
        for name, path in here.items():
            reason = reason.replace(f"{source}/{name}", str(path))
        file, ended = here.get(said["file"] or ""), ExitCode(said["exit_code"])
        return Result(index, said["status"], reason, file, ended, said["cause"], died=said["died"])

    def interrupt(self, count: int) -> None:
        """Tell the present run how often the user has interrupted by now; at the second time it is killed."""
        self._cluster.tell(self.agent, "say", self._key, str(count))

    def let_go(self) -> None:
        """The present run's files are needed no more."""
        with suppress(Lost):
            self._cluster.call(self.agent, "end")

    def close(self) -> None:
        """Give the spot back."""
        self._cluster.kill(self.agent)

    def reopen(self) -> bool:
        """A new agent instead of one that was lost; whether there is one."""
        self.close()
        if all(node.id != self.spot.node.id for node in self._cluster.nodes()):
            return False
        self.agent = self._cluster.new_agent(self.spot.node, cpus=self.spot.cpus, gpus=self.spot.gpus)
        there, _ = self._cluster.wait_ready([self.agent], limit=_REOPEN_S)
        if not there:
            self.close()
        return bool(there)

    def _talk(
        self, key: str, planned: PlannedRun | None, report: Report, interruptions: Interruptions
    ) -> dict[str, Any]:
        # the node's last word, with what it said in no form of ours
        first = {
            **asdict(self._wanted),
            "code": code().sha256,
            "run": planned.to_json() if planned else None,
        }
        self._key = key
        self._cluster.call(
            self.agent, "begin", key, ["-P", "-m", "gpusimbench.recorder.cluster.node"], json.dumps(first)
        )
        if count := interruptions.count:  # of before there was a process to tell
            self.interrupt(count)
        known, ended, said = 0, False, "nothing"
        while not ended:
            lines, ended = self._cluster.call(self.agent, "lines", known)
            if planned is None and not lines and not ended:
                raise Lost("it does not answer")  # a run may be silent for as long as its --timeout lets it
            known += len(lines)
            for line in filter(None, lines):
                record = _record(line)
                if record is None:
                    said = line
                elif "phase" in record:
                    report(record["phase"], record["done"], record["of"])
                else:
                    return {**record, "said": said}
        return {"said": said}


def needs_gpu(configuration: RunConfiguration, devices: tuple[str, ...], device: str | None, nodes: list[Node]) -> bool:
    """Whether runs are to be given a GPU each.

    devices  that the simulator steps on; empty where nobody knows
    device   its option of that name, as it is in force; None where it has none

    UsageError where it wants a GPU that no run gets.
    """
    there = any(node.gpus for node in nodes)
    if device == "cpu" or (devices and "cuda" not in devices):
        return False
    if device in (None, "auto"):
        return there
    if not there:
        raise UsageError(f"simulator '{configuration.simulator}' is to step on {device}, and no node has a GPU for Ray")
    if device.startswith("cuda:") and device != "cuda:0":
        raise UsageError(f"--ray gives each run one GPU, which is cuda:0 to it; leave out --device {device}")
    return True


def _record(line: str) -> dict[str, Any] | None:
    try:
        record = json.loads(line)
    except ValueError:
        return None
    return record if isinstance(record, dict) else None
