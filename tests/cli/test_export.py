"""Metrics as a page, as a file, and over HTTP from real probes."""

import contextlib
import gzip
import os
import re
import signal
import stat
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from edgectl.cli.serve import address_of
from edgectl.errors import UsageError
from edgectl.export.metrics import METRICS
from tests.cli.conftest import Run


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    return tmp_path / "state"


@contextlib.contextmanager
def serving(site: Path, *words: str) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """``export prometheus --listen`` on a free port of this machine, and where it serves."""
    command = [sys.executable, "-m", "edgectl", "export", "prometheus", "--listen", "127.0.0.1:0", *words]
    process = subprocess.Popen(command, cwd=site, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stderr is not None
    try:
        said = process.stderr.readline()
        found = re.search(r"http://127\.0\.0\.1:[0-9]+/metrics", said)
        assert found, said
        yield found[0], process
    finally:
        process.kill()
        process.communicate()


def get(url: str, **headers: str) -> bytes:
    with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=60) as answer:
        return bytes(answer.read())


def test_a_real_scrape_and_several_at_once_are_one_probe(site: Path, state: Path) -> None:
    with serving(site, "--every", "10m", "--timeout", "50s") as (url, process):
        with ThreadPoolExecutor(6) as pool:
            pages = set(pool.map(get, [url] * 6))
        assert len(pages) == 1, "one probe, one page"
        page = pages.pop().decode()
        assert gzip.decompress(get(url, **{"Accept-Encoding": "gzip"})).decode() == page
        up = {
            sample.labels["host"]: sample.value
            for family in text_string_to_metric_families(page)
            for sample in family.samples
            if sample.name == "edgectl_host_up"
        }
        assert up == dict.fromkeys(("edge1", "edge2", "edge3", "robot1", "robot2", "robot3"), 1.0)
        assert "# EOF" in get(url, Accept="application/openmetrics-text; version=1.0.0").decode()
        with pytest.raises(urllib.error.HTTPError, match="404"):
            get(url.removesuffix("/metrics") + "/etc/passwd")
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 0
        assert process.communicate() == ("", "")


def test_each_scrape_probes_where_nothing_is_kept_and_ctrl_c_ends_it(site: Path, state: Path) -> None:
    with serving(site, "--every", "0s", "--timeout", "50s") as (url, process):
        seen = [re.findall(rb"^edgectl_last_probe_timestamp_seconds (.*)$", get(url), re.MULTILINE) for _ in range(2)]
        assert seen[0] != seen[1]
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0


def test_a_failure_costs_the_scrape_not_the_server(site: Path, state: Path) -> None:
    with serving(site, "--every", "0s", "--timeout", "50s") as (url, process):
        fleet = next((state / "fleets").iterdir())
        (fleet / "memory.json").write_text('{"format_version": 99}')
        with pytest.raises(urllib.error.HTTPError, match="503: no metrics"):
            get(url)
        (fleet / "memory.json").unlink()
        assert b"edgectl_host_up" in get(url)
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 0
        assert "newer edgectl" in process.communicate()[1]


def test_the_textfile_is_replaced_whole_and_readable_for_others(site: Path, state: Path, run: Run) -> None:
    target = site / "edgectl.prom"
    target.write_text("old")
    before = os.umask(0o077)
    try:
        assert run("export", "prometheus", "--textfile", str(target), "--timeout", "50s") == (0, "", "")
    finally:
        os.umask(before)
    page = target.read_text()
    assert stat.S_IMODE(target.stat().st_mode) == 0o644
    assert [line.split()[2] for line in page.splitlines() if line.startswith("# TYPE")] == [metric.name for metric in METRICS]
    assert [path.name for path in site.iterdir() if "edgectl.prom" in path.name] == ["edgectl.prom"]


def test_what_cannot_be_written_or_bound_is_said(site: Path, state: Path, run: Run) -> None:
    ended = run("export", "prometheus", "--textfile", "missing/edgectl.prom", "--timeout", "50s")
    assert (ended.code, ended.out) == (1, "")
    assert "cannot write missing/edgectl.prom" in ended.err
    ended = run("export", "prometheus", "--listen", "192.0.2.1:0")
    assert ended.code == 1
    assert "cannot listen on 192.0.2.1:0" in ended.err
    assert run("export", "prometheus", "--listen", "1", "--textfile", "x").code == 64


def test_a_silent_host_shows_in_the_page_and_in_the_exit_code(site: Path, state: Path, run: Run) -> None:
    inventory = site / "inventories" / "local.yaml"
    text = inventory.read_text().replace(
        "  edge3: {host: 127.0.1.13,", "  edge3: {host: 127.0.1.13, connection: ssh, port: 1, user: nobody,"
    )
    inventory.write_text(text)
    ended = run("export", "prometheus", "--timeout", "50s")
    assert ended.code == 4
    assert 'edgectl_host_up{host="edge3",role="edge"} 0.0' in ended.out
    assert run("export", "prometheus", "--timeout", "50s", "--allow-unreachable").code == 0


@pytest.mark.parametrize(
    ("text", "address"),
    [("9815", ("127.0.0.1", 9815)), (":9815", ("127.0.0.1", 9815)), ("0.0.0.0:1", ("0.0.0.0", 1)), ("[::1]:2", ("::1", 2))],
)
def test_addresses(text: str, address: tuple[str, int]) -> None:
    assert address_of(text) == address


@pytest.mark.parametrize("text", ["", "host", "host:", "host:x", "host:65536", "host:-1", "1:²"])
def test_no_addresses(text: str) -> None:
    with pytest.raises(UsageError, match="cannot read the address"):
        address_of(text)


@pytest.mark.parametrize(("words", "package", "name"), [(("export", "prometheus"), "prometheus_client", "metrics")])
def test_a_missing_extra_is_named_with_what_installs_it(site: Path, state: Path, words: tuple[str, ...], package: str, name: str) -> None:
    code = f"import sys; sys.modules[{package!r}] = None; from edgectl.cli.main import main; sys.exit(main({list(words)!r}))"
    done = subprocess.run([sys.executable, "-c", code], cwd=site, capture_output=True, text=True, check=False)
    assert done.returncode == 64
    assert done.stdout == ""
    assert done.stderr.startswith(f"error: this needs {package}, which is not installed\nhint: ")
    assert f'"edgectl[{name}]"' in done.stderr
    assert done.stderr.count("\n") == 2
