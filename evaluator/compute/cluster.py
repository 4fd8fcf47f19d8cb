"""A mapper that sends parts of an evaluation to the nodes of a Ray cluster."""

from __future__ import annotations

import os
import socket
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, redirect_stdout
from pathlib import Path
from typing import Any, TypeVar

from gpusimbench.evaluator.compute.cache import code_version
from gpusimbench.schemas.commands.output import OfMainThread, unheard
from gpusimbench.schemas.errors import GsbError, UsageError

LOCAL = "local"
"""The address of a cluster that is started on this machine for one command."""

_RETRIES = 5
_AHEAD = 4  # parts that are on their way for each core of the cluster: enough to keep it busy, few enough to hold
_STORE_BYTES = 512 << 20  # of shared memory; parts and results are far smaller

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class Cluster:
    """A connection to a cluster; as a mapper it gives the very results that this process would have computed.

    A part whose node dies, or whose result was lost with a node, is computed again on another.
    """

    def __init__(self, address: str) -> None:
        """Connect; UsageError without the package, GsbError where nobody answers.

        address  "local", "auto" for the cluster that this machine is a node of, host:port, or ray://host:port
        """
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # no GPU is asked for, none is hidden
        try:
            import ray
        except ImportError:
            raise UsageError("--ray needs the package ray: pip install 'gpusimbench[ray]'") from None
        options: dict[str, Any] = {"object_store_memory": _STORE_BYTES} if address == LOCAL else {}
        try:
            with unheard():
                ray.init(address, log_to_driver=False, configure_logging=False, **options)
        except (ConnectionError, ValueError, RuntimeError, OSError) as error:
            raise GsbError(f"no Ray cluster at {address}: {str(error).splitlines()[0]}") from None
        self._ray = ray
        self._quiet = ExitStack()
        self._quiet.enter_context(redirect_stdout(OfMainThread(sys.stdout)))
        self._task = ray.remote(_part).options(num_cpus=1, max_retries=_RETRIES)
        self._cores = max(1, int(ray.cluster_resources().get("CPU", 1)))

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *details: object) -> None:
        with self._quiet, unheard():
            self._ray.shutdown()

    def __call__(self, function: Callable[[_Item], _Result], items: Iterable[_Item], /) -> Iterator[_Result]:
        """The function's results in the order of the items; GsbError where a part cannot be had."""
        shared = self._ray.put(function)
        waiting: deque[Any] = deque()
        for item in items:
            waiting.append(self._task.remote(shared, item, Path.cwd(), code_version()))
            if len(waiting) >= _AHEAD * self._cores:
                yield self._get(waiting.popleft())
        while waiting:
            yield self._get(waiting.popleft())

    def _get(self, reference: Any) -> Any:
        from ray.exceptions import RayError, RayTaskError

        try:
            found, why_not = self._ray.get(reference)
        except RayTaskError:
            raise
        except RayError as error:
            raise GsbError(
                f"the cluster lost a part of the evaluation {_RETRIES} times: {str(error).splitlines()[0]}"
            ) from None
        if why_not:
            raise GsbError(why_not)
        return found


def _part(function: Callable[[Any], Any], item: Any, folder: Path, version: str) -> tuple[Any, str]:
    """One part, on a node: its result, or why this node must not compute it."""
    if code_version() != version:
        return None, (
            f"the node {socket.gethostname()} has another version of gpusimbench, or of a package that it computes "
            "with; install the same on all nodes"
        )
    os.environ["NUMBA_NUM_THREADS"] = "1"  # a part has one core; read when numba is first imported
    try:
        os.chdir(folder)  # paths are those of the command
    except OSError:
        os.chdir("/")  # a node without that folder has none of the files that are named from there
    return function(item), ""
