"""Ray, and how this project speaks to it: nodes, an agent on a node, calls of an agent.

Nothing else here imports Ray. Agents are ``recorder.cluster.agent.Agent``, sent by value.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import time
from collections.abc import Collection
from contextlib import ExitStack, redirect_stdout, suppress
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from gpusimbench.recorder.cluster import agent
from gpusimbench.recorder.interruption import SIGNALS, shielded
from gpusimbench.schemas.commands.output import OfMainThread, unheard
from gpusimbench.schemas.errors import UsageError

LOCAL = "local"
"""Address that means: a cluster of this machine alone, for as long as the command runs."""

_STORE_BYTES = 256 << 20  # of a local cluster: pieces of files pass through it, and simulators need the memory
_TRIES, _PAUSE_S = 30, 2.0  # of a node that does not answer, but is not known to be dead

# Ray would send statistics; kill what it takes for the reason of a full memory, which is what a sweep may be after; and
# let everything else on the machine go before a run that is timed.
_SETTINGS = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_memory_monitor_refresh_ms": "0", "RAY_worker_niceness": "0"}


class Lost(Exception):
    """An agent, or its node, is there no more."""


@dataclass(frozen=True)
class Node:
    """A machine of the cluster, as Ray describes it.

    address    for people
    resources  by Ray's names, such as "CPU" and "GPU"
    """

    id: str
    address: str
    resources: dict[str, float] = field(default_factory=dict)

    @property
    def cpus(self) -> int:
        """CPUs of the node that Ray may give away."""
        return int(self.resources.get("CPU", 0))

    @property
    def gpus(self) -> int:
        """GPUs of the node that Ray may give away."""
        return int(self.resources.get("GPU", 0))


class Cluster:
    """A connection to a cluster. A context manager; of a local one, the cluster ends with it."""

    def __init__(self, address: str) -> None:
        """address  as ray.init takes it: HOST:PORT, auto, ray://HOST:PORT; or LOCAL"""
        self._address = address
        self._ray: Any = None
        self._quiet = ExitStack()
        self._agents: Any = None
        self._on_node: Any = None

    def __enter__(self) -> Cluster:
        try:
            with shielded():  # an import that is interrupted shows as one that is broken
                ray = import_module("ray")
                strategies = import_module("ray.util.scheduling_strategies")
        except ImportError as error:
            raise UsageError(
                "--ray needs Ray, which is not installed: pip install 'gpusimbench[ray]', or in a clone: "
                f"pip install '.[ray]' ({error})"
            ) from None
        for name, value in _SETTINGS.items():
            os.environ.setdefault(name, value)
        logging.getLogger("ray").setLevel(logging.ERROR)
        with ExitStack() as quiet:  # closed if connecting fails or is interrupted
            quiet.enter_context(redirect_stdout(OfMainThread(sys.stdout)))
            self._connect(ray)
            self._quiet = quiet.pop_all()
        self._ray = ray
        self._on_node = strategies.NodeAffinitySchedulingStrategy
        ray.cloudpickle.register_pickle_by_value(agent)
        self._agents = ray.remote(agent.Agent)
        return self

    def _connect(self, ray: Any) -> None:
        handlers = {number: signal.getsignal(number) for number in SIGNALS}
        local: dict[str, Any] = {"include_dashboard": False, "object_store_memory": _STORE_BYTES}
        try:
            with unheard():
                ray.init(
                    address=self._address, log_to_driver=False, configure_logging=False,
                    **(local if self._address == LOCAL else {}),
                )  # fmt: skip
        except Exception as error:  # ConnectionError, RuntimeError for another version, ValueError, by Ray's version
            said = " ".join(str(error).split())
            raise UsageError(f"no Ray cluster can be used at '{self._address}': {said}") from None
        finally:
            for number, handler in handlers.items():  # Ray sets one of its own
                signal.signal(number, handler)

    def __exit__(self, *details: object) -> None:
        # shielded, since processes of a local cluster would stay behind
        with shielded(), self._quiet, unheard():
            self._ray.shutdown()

    def nodes(self) -> list[Node]:
        """The nodes that are alive, by address."""
        found = [
            Node(node["NodeID"], node["NodeManagerAddress"], dict(node["Resources"]))
            for node in self._ray.nodes()
            if node["Alive"]
        ]
        return sorted(found, key=lambda node: (node.address, node.id))

    def new_agent(self, node: Node, *, cpus: int, gpus: int) -> Any:
        """A handle of an agent that will be on that node, holding so many of its CPUs and GPUs, once these are free."""
        return self._agents.options(
            num_cpus=cpus,
            num_gpus=gpus,
            max_concurrency=4,  # one waits for lines, the others interrupt, read or end
            max_restarts=0,  # what an agent follows would be gone; the run is given to another one instead
            max_task_retries=0,
            scheduling_strategy=self._on_node(node_id=node.id, soft=False),
        ).remote()

    def wait_ready(self, handles: Collection[Any], *, limit: float) -> tuple[list[Any], list[Any]]:
        """Those agents that are there within so many seconds, and those that may come still; lost ones are neither."""
        asked = {handle.ready.remote(): handle for handle in handles}
        left, there = list(asked), []
        deadline = time.monotonic() + limit
        while left and time.monotonic() < deadline:
            done, left = self._ray.wait(left, num_returns=1, timeout=1.0)
            there += [asked[ref] for ref in done if self._answers(ref)]
        return there, [asked[ref] for ref in left]

    def call(self, handle: Any, method: str, *arguments: Any) -> Any:
        """What a method of an agent returns. Lost where the agent is there no more, or does not answer for a minute.

        The call is made again where its answer did not come through.
        """
        errors = self._ray.exceptions
        for _ in range(_TRIES):
            try:
                return self._ray.get(getattr(handle, method).remote(*arguments))
            except errors.ActorUnavailableError as error:
                why = error
                time.sleep(_PAUSE_S)
            except errors.RayError as error:
                raise Lost(_first_line(error)) from None
        raise Lost(_first_line(why))

    def tell(self, handle: Any, method: str, *arguments: Any) -> None:
        """Call a method of an agent, and wait for nothing."""
        with suppress(self._ray.exceptions.RayError):
            getattr(handle, method).remote(*arguments)

    def kill(self, handle: Any) -> None:
        """End an agent, or give up waiting for one; what it holds is free again."""
        with suppress(self._ray.exceptions.RayError, ValueError):
            self._ray.kill(handle)

    def _answers(self, ref: Any) -> bool:
        try:
            return bool(self._ray.get(ref))
        except self._ray.exceptions.RayError:
            return False


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0] if lines else type(error).__name__
