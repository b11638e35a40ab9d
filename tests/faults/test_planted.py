# SPDX-License-Identifier: Apache-2.0
"""Mutation test of the oracle: bugs planted into the product must be caught.

Each mutation changes one line of a copy of the product; the named fault must then fail, and by the oracle's
verdict if the bug loses or doubles tasks. The same fault survives with the unchanged copy: it is part of the
matrix.
"""

import shutil
from pathlib import Path

import pytest

import edgectl
from tests.faults import fault_list
from tests.faults.fleet import EdgectlVariant
from tests.faults.namespace_host import find_missing_for_namespaces
from tests.faults.oracle import OracleVerdict
from tests.faults.registry import inject_once

PLANTS = [
    pytest.param(
        "task ignores SIGTERM",
        "loopback",
        "agent/supervise/stop.py",
        "    left = _find_remaining(record)\n",
        "    left = []\n",
        '        if _signal_until_gone(record, signals.parse_signal(name), scope, grace_s, note):\n            break\n    _signal_until_gone(record, signals.parse_signal("KILL"), "tree", _KILL_S, note)\n',
        "        _signal_until_gone(record, signals.parse_signal(name), scope, 0.0, note)\n",
        id="proof of stop skipped",
    ),
    pytest.param(
        "manager loses power after done",
        "loopback",
        "state/json_files.py",
        "        os.fsync(file.fileno())\n",
        "",
        "        sync_dir(path.parent)\n",
        "",
        id="fsync forgotten",
    ),
    pytest.param(
        "host rebooted, old pids reused",
        "namespace",
        "agent/supervise/liveness.py",
        "    if ended or not found.instance or not is_same_boot(found):\n",
        '    if found.status.get("state") in ("running", "ready"):\n        return True\n    if not found.instance:\n',
        "    if not above:\n        seen.update(",
        "    if False:\n        seen.update(",
        id="status file trusted",
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind", "file", "old", "new", "also_old", "also_new"), PLANTS)
def test_a_planted_bug_is_caught(
    tmp_path: Path, name: str, kind: str, file: str, old: str, new: str, also_old: str, also_new: str
) -> None:
    if kind == "namespace" and (why := find_missing_for_namespaces()):
        pytest.skip(f"{name}: not run: {why}")
    copy = tmp_path / "code" / "edgectl"
    shutil.copytree(Path(edgectl.__file__).parent, copy, ignore=shutil.ignore_patterns("__pycache__"))
    text = (copy / file).read_text()
    for before, after in ((old, new), (also_old, also_new)):
        assert before in text, f"{file} has changed: plant the bug anew"
        text = text.replace(before, after)
    (copy / file).write_text(text)
    (each,) = [fault for fault in fault_list.list_faults() if fault.name == name]
    found = inject_once(each, kind, 1, EdgectlVariant(code=copy.parent)).wrong
    # edgectl itself may see that a task runs twice, and ends with 4 before the oracle is asked.
    caught = found.lost or found.doubled if isinstance(found, OracleVerdict) else "DOUBLED" in found
    assert caught, f"not caught by the oracle: {found or 'survived'}"
