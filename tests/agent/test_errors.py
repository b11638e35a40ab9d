# SPDX-License-Identifier: Apache-2.0
"""What a host lacks is told as such, not as a bug."""

import errno
import json
import os
from pathlib import Path
from typing import Any

import pytest

from edgectl.agent.link import main
from edgectl.agent.supervise import state_dir
from tests.agent.conftest import a_spec


class RecordingChannel:
    """Keeps the reply."""

    def reply(self, payload: bytes) -> None:
        self.document: dict[str, Any] = json.loads(payload)


def test_a_host_without_free_processes_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> int:
        raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    monkeypatch.setattr(os, "fork", refuse)
    monkeypatch.setattr(state_dir, "BASES", [])
    request = {
        "op": "start", "fleet": "lab", "host": "edge1", "task": "slam", "instance": "i", "generation": 1,
        "spec": a_spec("sleep 1", runtime="process"),
    }  # fmt: skip
    channel = RecordingChannel()
    main.serve_request(json.dumps(request).encode(), channel, [str(tmp_path)])  # type: ignore[arg-type]
    error = channel.document["error"]
    assert error["message"] == "the host is out of processes"
    assert "TasksMax" in error["hint"]
