# SPDX-License-Identifier: Apache-2.0
"""A ``.launch.py`` evaluated in a child process with bounded time and memory
([ADR 89](docs/adr/0089-run-python-launch-files-against-a-recorder.md)).
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

PYTHON_TIMEOUT_S = 20.0
_MAX_RECORD_BYTES = 2**24


def run_launch_program(
    path: str,
    arguments: Mapping[str, str],
    packages: Mapping[str, str],
    *,
    timeout_s: float = PYTHON_TIMEOUT_S,
) -> Mapping[str, Any]:
    """The record of a child process that evaluates the file ``path`` (an absolute path).

    It has the stand-ins of launch and launch_ros, at most 1 GiB of memory and ``timeout_s`` seconds. It is
    the user's own program and has the user's own rights.
    """
    root = Path(str(files("edgectl"))).parent
    request = {
        "file": path,
        "arguments": dict(arguments),
        "packages": dict(packages),
        "root": str(root),
        # The rule for the file itself is the caller's; this is for the files that it includes.
        "runs_exposed": os.environ.get("EDGECTL_INSECURE_FILES", "0") not in ("", "0"),
        "path": [part for part in os.environ.get("PYTHONPATH", "").split(os.pathsep) if part],
    }
    program = root / "edgectl" / "importers" / "standin" / "_edgectl_run.py"
    child = subprocess.Popen(
        [sys.executable, "-I", "-B", str(program)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        reply, _ = child.communicate(json.dumps(request).encode(), timeout=timeout_s)
    except subprocess.TimeoutExpired:
        return _describe_fault(
            path,
            f"the file did not end within {timeout_s:g} s",
            "remove what waits, or import with --group file",
        )
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
        child.wait()
        for stream in (child.stdin, child.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()
    try:
        record: Mapping[str, Any] = json.loads(reply[: _MAX_RECORD_BYTES + 1])
    except ValueError:
        how = "was ended: it took too long" if child.returncode == -signal.SIGXCPU else "ended by itself"
        return _describe_fault(
            path, f"the file {how} before it returned a description", "import with --group file"
        )
    return record


def _describe_fault(path: str, message: str, hint: str) -> Mapping[str, Any]:
    return {"fault": {"file": path, "line": 1, "message": message, "hint": hint}}


def show_given_path(value: Any, full: str, given: str) -> Any:  # noqa: ANN401 - any JSON
    """The record with the launch file named as the user did, where it states places."""
    if isinstance(value, Mapping):
        return {
            key: given
            if key == "file" and each == full and value.get("kind") != "include"
            else [given if place == full else place for place in each]
            if key == "place"
            else show_given_path(each, full, given)
            for key, each in value.items()
        }
    return [show_given_path(each, full, given) for each in value] if isinstance(value, list) else value
