# SPDX-License-Identifier: Apache-2.0
"""The history is imported while hosts are waited for, in a process that has not imported it yet."""

import subprocess
import sys
from pathlib import Path

PROGRAM = """
import sys, threading, time
from pathlib import Path
from edgectl.state.store_handle import StoreHandle
handle = StoreHandle()
assert "edgectl.state.store" not in sys.modules
handle.prepare()
began = [each for each in threading.enumerate() if each is not threading.main_thread()]
handle.prepare()
print(handle.use(Path(sys.argv[1]), print, lambda store: len(store.events(limit=1))))
for each in began:
    each.join()
before = threading.active_count()
handle.prepare()
print("edgectl.state.store" in sys.modules, len(began) <= 1, threading.active_count() == before)
"""


def test_the_history_is_imported_once_and_used_meanwhile(tmp_path: Path) -> None:
    command = [sys.executable, "-c", PROGRAM, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["0", "True", "True", "True"]
