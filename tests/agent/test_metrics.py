# SPDX-License-Identifier: Apache-2.0
"""Application metrics: valid lines, misuse of the file by a task, and metrics in a probe."""

import json
import os
import re
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from edgectl.agent.link import fast_json, protocol
from edgectl.agent.measure import metrics
from edgectl.agent.supervise import state_dir, task_dirs
from edgectl.gateway import task_reply
from tests.agent.conftest import AgentHost, both_runtimes, eventually, is_running
from tests.pace import patience

# -- lines --


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (b"fps 29.5\n", {"fps": 29.5}),
        (b"fps 1\nloss 3\nfps 2\n", {"fps": 2.0, "loss": 3.0}),
        (b"  fps \t 1 \r\n", {"fps": 1.0}),
        (b"fps 1\nfps 2", {"fps": 1.0}),  # incomplete line
        (b"fps 1\nfps", {"fps": 1.0}),
        (b"fps 1\nfps x\nfps nan\nfps -inf\nfps 1e999\nfps 1_0\nfps 0x10\nfps\nfps 2 3\nfps=4\n# fps 5\n\n\n", {"fps": 1.0}),
        (b"a.b:c/d-e_F0 -1e-3\n_x 0\n", {"_x": 0.0, "a.b:c/d-e_F0": -0.001}),
        (b"9x 1\n-x 1\n.x 1\n/x 1\nx! 1\nx,y 1\n\xc3\xa9 1\n\0 1\nx\0 1\n", {}),
        (b"%s 1\n%s 2\n" % (b"a" * 63, b"b" * 64), {"a" * 63: 1.0}),
        (b"", {}),
        (b"\n", {}),
        (b"fps 1", {}),
        (b"a 1e308\nb 1e309\nc 5e-324\n", {"a": 1e308, "c": 5e-324}),
        (b"\0" * 5000 + b"fps 1\nfps 2\n", {"fps": 2.0}),
    ],
)  # fmt: skip
def test_the_last_valid_whole_line_of_each_name_counts(text: bytes, found: dict[str, float]) -> None:
    assert metrics.parse_metrics(text) == found


def test_of_too_many_names_the_newest_count() -> None:
    lines = b"".join(b"m%02d %d\n" % (number % 40, number) for number in range(80))
    assert metrics.parse_metrics(lines) == {f"m{number % 40:02d}": number for number in range(48, 80)}
    assert metrics.parse_metrics(lines, 2) == {"m38": 78.0, "m39": 79.0}


def test_a_name_is_valid_as_its_pattern_states() -> None:
    longest = "a" * protocol.MAX_NAME_LENGTH
    for name in (longest, longest + "a", *map(chr, range(1, 256)), *(f"a{chr(code)}" for code in range(128))):
        found = metrics.parse_metrics(f"{name} 1\n".encode("latin-1"))
        assert bool(found) == bool(re.fullmatch(protocol.METRIC_NAME_PATTERN, name.strip(" \t\r\v\f"))), name


words = st.sampled_from(
    [b"fps", b"loss", b"1", b"-2.5", b"1e308", b"nan", b"x!", b"\0", b"\xff"]
) | st.binary(max_size=3)
texts = st.lists(words | st.sampled_from([b" ", b"\n", b" ", b"\n", b"\t", b"\r\n"]), max_size=80).map(
    b"".join
)


@given(texts)
@example(b"fps 1e308\nloss -1e308\n")
def test_the_manager_accepts_the_metrics_of_any_text(text: bytes) -> None:
    found = metrics.parse_metrics(text)
    sent = json.loads(fast_json.dumps(found))
    assert sent == found
    kept = task_reply._select_metrics(sent)
    assert kept == {name: value for name, value in sent.items() if abs(value) <= 1e100}
    assert metrics.parse_metrics(text + b"more") == metrics.parse_metrics(text) or not text.endswith(b"\n")
    for name in found:
        assert name.encode() in text


# -- files --


def put(folder: Path, text: bytes) -> Path:
    (folder / "metrics").write_bytes(text)
    return folder / "metrics"


def a_link(path: Path) -> None:
    path.with_name("other").write_bytes(b"fps 1\n")
    path.symlink_to("other")


@pytest.mark.parametrize(
    "make", [lambda path: None, a_link, os.mkfifo, Path.mkdir, lambda path: path.symlink_to("/dev/zero")]
)
def test_only_a_file_is_read_and_kept_small(tmp_path: Path, make: Callable[[Path], object]) -> None:
    make(tmp_path / "metrics")
    before = sorted((path.name, path.lstat().st_mode, path.lstat().st_size) for path in tmp_path.iterdir())
    assert metrics.read_metrics(str(tmp_path)) == {}
    assert metrics.limit_metrics_file(str(tmp_path))[0] > 0
    assert before == sorted(
        (path.name, path.lstat().st_mode, path.lstat().st_size) for path in tmp_path.iterdir()
    )


@pytest.mark.parametrize(
    "make", [lambda path: None, a_link, os.mkfifo, lambda path: path.write_bytes(b"old 1\n")]
)
def test_a_new_file_is_empty_and_private(tmp_path: Path, make: Callable[[Path], object]) -> None:
    make(tmp_path / "metrics")
    metrics.reset_metrics_file(str(tmp_path))
    found = (tmp_path / "metrics").lstat()
    assert (stat.S_ISREG(found.st_mode), stat.S_IMODE(found.st_mode), found.st_size) == (True, 0o600, 0)


def test_where_there_can_be_no_file_there_are_no_metrics(tmp_path: Path) -> None:
    (tmp_path / "metrics" / "mine").mkdir(parents=True)
    metrics.reset_metrics_file(str(tmp_path))
    metrics.reset_metrics_file(str(tmp_path / "gone"))
    assert metrics.read_metrics(str(tmp_path)) == metrics.read_metrics(str(tmp_path / "gone")) == {}


def test_only_the_end_of_a_long_file_is_read(tmp_path: Path) -> None:
    put(tmp_path, b"early 1\n" + b"x" * metrics.MAX_READ_BYTES + b"y 2\nfps 3\n")
    assert metrics.read_metrics(str(tmp_path)) == {"fps": 3.0}
    put(tmp_path, b"early 1\n" + b"fps 2\n" * metrics.MAX_LINES)
    assert metrics.read_metrics(str(tmp_path)) == {"fps": 2.0}
    put(tmp_path, b"early 1\n" + b"fps 2\n" * (metrics.MAX_LINES - 1))
    assert metrics.read_metrics(str(tmp_path)) == {"early": 1.0, "fps": 2.0}


def test_a_file_that_is_too_large_is_cut_to_what_counts(tmp_path: Path) -> None:
    path = put(tmp_path, b"x" * metrics.MAX_FILE_BYTES)
    with path.open("ab", buffering=0) as task:
        metrics.limit_metrics_file(str(tmp_path))
        assert path.stat().st_size == metrics.MAX_FILE_BYTES, "not too large yet"
        task.write(b"\nfps 0.1\nloss -1e300\nfps 7.25\nfps 8")
        patience = metrics.limit_metrics_file(str(tmp_path))
        assert path.read_bytes() == b"fps 7.25\nloss -1e+300\n"
        assert metrics.limit_metrics_file(str(tmp_path)) > patience, "checked sooner while it is too large"
        task.write(b"fps 9\n")
    assert metrics.read_metrics(str(tmp_path)) == {"fps": 9.0, "loss": -1e300}


def test_a_writer_that_does_not_append_leaves_a_hole_that_takes_no_room(tmp_path: Path) -> None:
    path = put(tmp_path, b"")
    with path.open("wb", buffering=0) as task:
        task.write(b"x" * (metrics.MAX_FILE_BYTES + 1) + b"\nfps 1\n")
        metrics.limit_metrics_file(str(tmp_path))
        assert path.stat().st_size < 100
        task.write(b"\nloss 2\nfps 3\n")
    assert path.stat().st_blocks * 512 < metrics.MAX_FILE_BYTES < path.stat().st_size
    assert metrics.read_metrics(str(tmp_path)) == {"fps": 3.0, "loss": 2.0}
    metrics.limit_metrics_file(str(tmp_path))
    assert metrics.read_metrics(str(tmp_path)) == {"fps": 3.0, "loss": 2.0}


def test_very_many_tasks_share_the_room_of_a_reply(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(state_dir, "BASES", [str(tmp_path / "state")])
    lines = b"".join(
        b"%s%02d -1.2345678901234567e-300\n" % (b"m" * 61, number)
        for number in range(protocol.MAX_TASK_METRICS)
    )
    entries: dict[str, dict[str, object]] = {
        f"t{number}": {"managed": True, "instance": "i"} for number in range(200)
    }
    for name in entries:
        put(Path(task_dirs.make_task_dir("edge1", name)), lines)
    found = metrics.read_tasks_metrics("edge1", {**entries, "stray": {"managed": False, "instance": ""}})
    assert {len(values) for values in found.values()} == {protocol.MAX_HOST_METRICS // 200}
    assert len(found) == 200
    assert len(fast_json.dumps(found)) < 256 << 10
    assert {
        len(values) for values in metrics.read_tasks_metrics("edge1", {"t1": entries["t1"]}).values()
    } == {protocol.MAX_TASK_METRICS}


def test_the_python_example_of_the_docs_works(tmp_path: Path) -> None:
    page = Path(__file__).parents[2] / "docs" / "concepts" / "app-metrics.md"
    (program,) = re.findall(r"^```python\n(import os\n.*?)^```$", page.read_text(), re.MULTILINE | re.DOTALL)
    for env in ({**os.environ, "EDGECTL_METRICS": metrics.get_metrics_path(str(tmp_path))}, dict(os.environ)):
        subprocess.run([sys.executable, "-c", program], env=env, check=True, timeout=patience(60))
    assert metrics.read_metrics(str(tmp_path)) == {"fps": 29.97}


# -- tasks --


def probed(host: AgentHost, task: str) -> dict[str, Any]:
    found: dict[str, Any] = host.ask("probe", window_s=0.05)["tasks"][task]
    return found


def until_metrics(host: AgentHost, task: str, values: dict[str, float]) -> dict[str, Any]:
    """The entry of the task once it has exactly these metrics."""
    return eventually(
        lambda: entry if (entry := probed(host, task)).get("metrics") == values else None, seconds=60
    )


@both_runtimes
def test_metrics_of_a_task_and_of_a_completed_job(host: AgentHost, tmp_path: Path) -> None:
    command = f'umask 000; echo "fps 29.5" >>"$EDGECTL_METRICS"; until [ -e {tmp_path}/go ]; do sleep 0.05; done; echo "fps 31" >>"$EDGECTL_METRICS"'
    host.start("slam", command, kind="job")
    assert until_metrics(host, "slam", {"fps": 29.5})["state"] == "running"
    path = host.folder("slam") / "metrics"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    (tmp_path / "go").touch()
    host.until("slam", "completed")
    assert probed(host, "slam")["metrics"] == {"fps": 31.0}
    host.start("slam", "exec sleep 600", instance="i2", generation=2)
    assert "metrics" not in probed(host, "slam")
    assert path.read_bytes() == b""
    host.stop("slam")


def test_a_restarted_process_begins_without_metrics(host: AgentHost, tmp_path: Path) -> None:
    first = (
        f'[ -e {tmp_path}/first ] || {{ touch {tmp_path}/first; echo "n 1" >>"$EDGECTL_METRICS"; exit 1; }}'
    )
    second = (
        f'until [ -e {tmp_path}/go ]; do sleep 0.05; done; echo "m 2" >>"$EDGECTL_METRICS"; exec sleep 600'
    )
    host.start("slam", f"{first}; {second}", restart="on-failure")
    eventually(lambda: (entry := host.entry("slam")) and entry["restarts"] == 1, seconds=60)
    assert "metrics" not in probed(host, "slam")
    (tmp_path / "go").touch()
    until_metrics(host, "slam", {"m": 2.0})
    host.stop("slam")


SPAM = """
import os, sys, time
file, number = os.open(os.environ["EDGECTL_METRICS"], os.O_WRONLY | os.O_APPEND), 0
while not os.path.exists(sys.argv[1]):
    number += 1
    os.write(file, b"fps %d\\n" % number * 5000)
    time.sleep(0.003)
os.write(file, b"fps -1\\n")
"""


def until_cut(path: Path) -> None:
    """Wait until the file is smaller than at the previous look."""
    sizes = [0, 0]

    def is_smaller() -> bool:
        sizes.append(path.stat().st_size)
        return sizes[-1] < sizes[-2]

    eventually(is_smaller, seconds=60)


def test_a_task_that_writes_without_end_keeps_its_values_and_a_small_file(
    host: AgentHost, tmp_path: Path
) -> None:
    """At 10 MB/s the file is cut repeatedly and small at the end; the newest values are known all the time."""
    (tmp_path / "spam.py").write_text(SPAM)
    host.start("spam", f"exec {sys.executable} -S {tmp_path}/spam.py {tmp_path}/enough", kind="job")
    path, seen = host.folder("spam") / "metrics", 0.0
    for _ in range(3):
        until_cut(path)
        values = eventually(lambda: probed(host, "spam").get("metrics"))
        assert set(values) == {"fps"}
        assert values["fps"] > seen
        seen = values["fps"]
    (tmp_path / "enough").touch()
    host.until("spam", "completed")
    eventually(lambda: not is_running(host.supervisor("spam")))
    assert path.stat().st_blocks * 512 <= metrics.MAX_FILE_BYTES
    assert probed(host, "spam")["metrics"] == {"fps": -1.0}


def test_a_link_or_pipe_in_place_of_the_file_is_ignored(host: AgentHost, tmp_path: Path) -> None:
    (tmp_path / "other").write_text("fps 1\n")
    host.start("slam", f'cd "$(dirname "$EDGECTL_METRICS")"; rm metrics; ln -s {tmp_path}/other metrics; touch linked; mkfifo p; '
               f'until [ -e {tmp_path}/go ]; do sleep 0.05; done; mv -T p metrics; touch piped; exec sleep 600')  # fmt: skip
    eventually((host.folder("slam") / "linked").exists)
    assert "metrics" not in probed(host, "slam")
    (tmp_path / "go").touch()
    eventually((host.folder("slam") / "piped").exists)
    assert "metrics" not in probed(host, "slam")
    assert host.stop("slam")["state"] == "stopped"
    assert (tmp_path / "other").read_text() == "fps 1\n"
