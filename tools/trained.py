"""Copy trained runs into the package, with their policies: `python -m tools.trained RESULTS RUN_ID…`.

`pneuma env render --player best:STUDY` plays them where none of the study's runs is stored. Their records
stay behind: published tables have what matters, and the policies may take 1 MB. A new version of an engine
gives runs other ids: train the conditions again, and replace them.
"""

from __future__ import annotations

import sys

from pneuma.engines.records import POLICY_FILE
from pneuma.store.row_builder import stored_row
from pneuma.store.store import ROW_FILE, Store
from pneuma.store.stored_runs import shipped_runs

KEPT_FILES = ("run.json", "provenance.json", POLICY_FILE, ROW_FILE)


def main() -> None:
    store = Store(sys.argv[1])
    for run_id in sys.argv[2:]:
        stored_row(store, run_id)  # makes one that is missing
        files = {file_name: store.read_file(run_id, file_name) for file_name in KEPT_FILES}
        shipped_runs().save_run(run_id, store.status(run_id), files)


if __name__ == "__main__":
    main()
