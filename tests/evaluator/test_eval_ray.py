"""Evaluations spread over a Ray cluster: the same to the last bit, also when a node dies."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from gpusimbench.evaluator.compute import cluster as cluster_module
from gpusimbench.evaluator.compute.cluster import Cluster
from gpusimbench.evaluator.compute.work import HERE, Work
from gpusimbench.evaluator.inputs.reader import Reader, read_all
from gpusimbench.evaluator.report.json import dump_json
from gpusimbench.evaluator.results.evaluate import evaluate
from gpusimbench.schemas.errors import GsbError, UsageError
from tests.conftest import Command, searched, wait_for

pytestmark = pytest.mark.alone

ray = pytest.importorskip("ray")

_NODE = {"num_cpus": 1, "object_store_memory": 80 << 20, "include_dashboard": False}


@pytest.fixture
def two_nodes(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A cluster of two nodes, processes of this machine; its `worker` is the one that holds no head."""
    from ray.cluster_utils import Cluster as Nodes

    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    here = Path(__file__).resolve()
    monkeypatch.setenv("PYTHONPATH", searched(here.parent, here.parents[2]))  # for the functions of this module
    nodes = Nodes(initialize_head=True, head_node_args=_NODE)
    nodes.worker = nodes.add_node(**_NODE)
    yield nodes
    ray.shutdown()
    nodes.shutdown()


def node_of(meeting: Path | None) -> str:
    """The node that computes this; where a folder is given, once another node computes as well."""
    node = str(ray.get_runtime_context().get_node_id())
    if meeting is not None:
        (meeting / node).touch()
        wait_for(lambda: len(list(meeting.iterdir())) > 1)
    return node


def fail(_: int) -> int:
    """A part with a defect."""
    raise ZeroDivisionError("of its own")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of processes and sockets that Ray leaves to the garbage collector
def test_a_node_dies(two_nodes: Any, small_set: list[Path], gsb_eval: Command, tmp_path: Path) -> None:
    """Give the document of a local evaluation, from two nodes, and from two of which one is killed in the middle."""
    files = [*small_set, small_set[0].parent / "missing.mcap"]
    expected = dump_json(evaluate(read_all(files, Reader(1.0), HERE), sample_time=1.0))
    done = gsb_eval(*files, "--sample-time", 1, "--json", "-", "--no-cache", "--ray", two_nodes.address)
    assert (done.returncode, done.stdout) == (3, expected), done.stderr

    (meeting := tmp_path / "meeting").mkdir()
    with Cluster(two_nodes.address) as cluster:
        assert len(set(cluster(node_of, [meeting] * 6))) == 2
        killed = []

        def killing(function: Callable[[Any], Any], items: Iterable[Any], /) -> Iterator[Any]:
            for result in cluster(function, items):
                if not killed:
                    two_nodes.remove_node(two_nodes.worker, allow_graceful=False)
                    killed.append(function)
                yield result

        found = evaluate(read_all(files, Reader(1.0), Work(killing)), sample_time=1.0, work=Work(killing))
        assert killed
        assert dump_json(found) == expected
        assert len(set(cluster(node_of, [None] * 3))) == 1
        with pytest.raises(ZeroDivisionError, match="of its own"):
            list(cluster(fail, [1]))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_nodes_of_another_version(two_nodes: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse results of other code, by the name of the node."""
    monkeypatch.setattr(cluster_module, "code_version", lambda: "another")
    with Cluster(two_nodes.address) as cluster, pytest.raises(GsbError, match="has another version of gpusimbench"):
        list(cluster(node_of, [None]))


def raylets() -> Iterator[psutil.Process]:
    """Processes of this machine that make it a node of a cluster, whoever started them: "auto" finds them all."""
    for process in psutil.process_iter(["cmdline"]):
        if (process.info["cmdline"] or [""])[0].endswith("/raylet"):
            yield process


def test_nobody_answers(small: Path, gsb_eval: Command) -> None:
    """Say in one line that there is no cluster at that address."""
    wait_for(lambda: not list(raylets()))  # one of an earlier test may not have ended yet
    done = gsb_eval(small, "--ray", "auto", "--no-cache", env={**os.environ, "RAY_ADDRESS": ""})
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("gsb-eval: no Ray cluster at auto: ")
    assert done.stderr.count("\n") == 1


def test_without_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    """Say what to install."""
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(UsageError, match=r"pip install 'gpusimbench\[ray\]'"):
        Cluster("local")


def test_documents_are_whole(small: Path, gsb_eval: Command, tmp_path: Path) -> None:
    """Print the document alone, and nothing of Ray's, also with a cluster that lives for one command."""
    environment = {**os.environ, "HOME": str(tmp_path), "RAY_ADDRESS": ""}
    done = gsb_eval(small, "--sample-time", 1, "--json", "-", "--ray", "local", "--no-cache", env=environment, code=0)
    assert not [line for line in done.stderr.splitlines() if "ray" in line.lower()]
    assert json.loads(done.stdout)["groups"]
