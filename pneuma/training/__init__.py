"""Training: from a plan to finished runs (execute, executors, worker), with its progress."""
