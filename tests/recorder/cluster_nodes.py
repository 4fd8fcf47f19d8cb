"""A cluster of two nodes on this machine, in a process of its own: ``python -m tests.recorder.cluster_nodes``.

Its first line says the address. A line on standard input kills the node that is not the head, and is answered by
another line; at the end of standard input all nodes end.
"""

from __future__ import annotations

import sys
from typing import Any

from ray.cluster_utils import Cluster

_NODE = {"num_cpus": 1, "object_store_memory": 80 << 20}


def main() -> None:
    """Follow standard input."""
    cluster: Any = Cluster(initialize_head=True, head_node_args={**_NODE, "include_dashboard": False})
    try:
        node = cluster.add_node(**_NODE)
        print(f"at {cluster.address}", flush=True)
        for _ in sys.stdin:
            cluster.remove_node(node, allow_graceful=False)
            print(f"at {cluster.address}", flush=True)
    finally:
        cluster.shutdown()


if __name__ == "__main__":
    main()
