"""A Ray cluster on loopback for tests: a head without CPUs and nodes of one CPU each.

    python ray_nodes.py NODES

prints its address and the process ids of the nodes, and ends when its standard input closes.
"""

from __future__ import annotations

import json
import os
import sys

os.environ |= {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",  # or Ray takes the machine's address in its network
    "RAY_worker_niceness": "0",  # with the default of 15 a busy machine never gets to them
}

from ray.cluster_utils import Cluster  # noqa: E402 (Ray reads the environment when it is loaded)

MEMORY = {"object_store_memory": 80_000_000}


def main() -> None:
    """Start the nodes, print them, wait, and shut them down."""
    cluster = Cluster(
        initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False, **MEMORY}
    )
    nodes = [cluster.add_node(num_cpus=1, **MEMORY) for _ in range(int(sys.argv[1]))]
    pids = [node.all_processes["raylet"][0].process.pid for node in nodes]
    print(json.dumps({"address": cluster.address, "nodes": pids}), flush=True)
    sys.stdin.read()
    cluster.shutdown()


if __name__ == "__main__":
    main()
