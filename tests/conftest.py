# SPDX-License-Identifier: Apache-2.0
"""Isolation from the user's home, keys, state and terminal settings; fixtures with real SSH servers.

Timeouts are scaled to the speed of the machine, SIGINT has its default action, the processes of failed tests are
ended, and the longest files are distributed test by test.
"""

import gc
import os
import signal
from collections.abc import Generator, Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from tests.etcd import EtcdCluster, running_etcd
from tests.leftovers import end_started_in
from tests.pace import pace
from tests.sshd import Lab, running_lab
from tests.workers import start_server

# The same examples in every run, without a deadline: a failure is repeatable, and a stalled machine causes none.
_UNHURRIED = settings(
    deadline=None,
    suppress_health_check=[
        HealthCheck.too_slow,
        HealthCheck.data_too_large,
        HealthCheck.filter_too_much,
        HealthCheck.function_scoped_fixture,
    ],
)
settings.register_profile("repeatable", _UNHURRIED, derandomize=True, database=None)
# Three times as many in make fuzz, others in every run, or those of --hypothesis-seed; what was found is kept in .hypothesis and tried first.
settings.register_profile("search", _UNHURRIED, print_blob=True, max_examples=300)
settings.load_profile("repeatable")

INHERITED = (
    "SSH_AUTH_SOCK",
    "SSH_ASKPASS",
    "NO_COLOR",
    "NO_UNICODE",
    "FORCE_COLOR",
    "CLICOLOR_FORCE",
    "GITHUB_ACTIONS",
    "CI",
    "COLUMNS",
    "PYTHONPATH",
    "PYTHONUNBUFFERED",
    "PYTHONDONTWRITEBYTECODE",
)
FAILED = pytest.StashKey[bool]()
_homes = count()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--whole", action="store_true", help="all of what some tests take a part of (make faults)"
    )


@pytest.fixture(scope="session")
def whole(pytestconfig: pytest.Config) -> bool:
    """Whether a test does all that it can, as in ``make faults``, or a telling part of it."""
    return bool(pytestconfig.getoption("--whole"))


def pytest_configure() -> None:
    """Restore SIGINT and measure the slowdown before workers start.

    A shell that starts a job in the background makes it ignore SIGINT, and child processes inherit that.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)
    pace()
    gc.disable()


def pytest_collection_finish() -> None:
    """Exempt all modules from garbage collection: collections over them would take a tenth of the CPU time."""
    gc.freeze()
    gc.enable()


# The files that take longest start first, and their tests are distributed one by one. The tests of any other file
# stay on one worker, because of the module's fixtures.
LONGEST = (
    "cli/test_examples.py",
    "docs/test_pages.py",
    "agent/test_crashloop.py",
    "docs/test_demo.py",
    "test_suite.py",
    "docs/test_contributing.py",
    "experiments/lab/test_short.py",
    "faults/test_quick.py",
    "usecases/test_recovery.py",
    "usecases/test_random_events.py",
    "usecases/test_interrupted_commands.py",
    "faults/test_planted.py",
    "e2e/test_unreachable.py",
    "e2e/test_secrets.py",
    "experiments/test_real_hosts.py",
    "experiments/test_runner.py",
    "experiments/lab/test_hosts.py",
    "experiments/lab/test_patrol.py",
    "experiments/lab/test_model.py",
    "e2e/test_local.py",
    "e2e/test_handoff.py",
    "e2e/test_command.py",
    "e2e/test_watch.py",
    "experiments/test_report.py",
    "agent/test_heartbeat.py",
    "cli/test_apply.py",
    "cli/test_history_commands.py",
    "cli/test_watch.py",
    "cli/test_quiet.py",
    "cli/test_files.py",
    "config/test_fuzz.py",
    "formats/test_round_trip.py",
    "scheduler/test_properties.py",
    "soak/test_soak.py",
)
HERE = Path(__file__).parent


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes(config: pytest.Config, specs: Sequence[Any]) -> None:
    """Fork the workers from one process: only that has to import all test modules."""
    if len(specs) > 1:
        command = start_server(config.invocation_params.args)
        for spec in specs:
            spec.python = command


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Distribute whole files, except for the longest."""
    from xdist.scheduler import LoadFileScheduling

    class ByFile(LoadFileScheduling):  # type: ignore[misc]
        def _split_scope(self, nodeid: str) -> str:
            file = super()._split_scope(nodeid)
            return nodeid if file.removeprefix("tests/") in LONGEST else file

    return ByFile(config, log) if config.getvalue("dist") == "loadfile" else None


def pytest_unconfigure(config: pytest.Config) -> None:
    """End what an interrupted session left running: its workers had no time to clean up."""
    if not hasattr(config, "workerinput") and not config.getoption("collectonly"):
        factory: pytest.TempPathFactory = vars(config)["_tmp_path_factory"]
        end_started_in([factory.getbasetemp()])


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Move the longest files to the front, mark them as slow, and scale all timeouts."""
    places = {HERE / name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path, len(places)))
    for item in items:
        if item.path in places:
            item.add_marker(pytest.mark.slow)
    if pace() > 1.0 and any(config.pluginmanager.hasplugin(name) for name in ("timeout", "pytest_timeout")):
        for item in items:
            marker = item.get_closest_marker("timeout")
            limit = float(marker.args[0] if marker else config.getini("timeout"))
            item.add_marker(pytest.mark.timeout(limit * pace()), append=False)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """End the processes of a failed test: they could make other tests fail."""
    report = yield
    item.stash[FAILED] = report.failed or item.stash.get(FAILED, False)
    if report.when == "teardown" and item.stash[FAILED]:
        end_started_in(
            [
                Path(found)
                for name in ("isolated", "tmp_path")
                if (found := getattr(item, "funcargs", {}).get(name))
            ]
        )
    return report


@pytest.fixture(autouse=True)
def isolated(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty HOME with empty XDG directories, and an ssh_config that knows nobody; returns that home."""
    # mktemp would read the names of all homes of the session to find the next number.
    home = tmp_path_factory.getbasetemp() / f"home{next(_homes)}"
    home.mkdir(mode=0o700)
    for name in [*INHERITED, *(name for name in os.environ if name.startswith("EDGECTL_"))]:
        monkeypatch.delenv(name, raising=False)
    config = home / "ssh_config"
    config.write_text(
        f"UserKnownHostsFile {home}/known_hosts\nGlobalKnownHostsFile none\nIdentityFile none\nIdentityAgent none\n"
    )
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("EDGECTL_SSH_CONFIG", str(config))
    for kind in ("STATE", "CONFIG", "CACHE", "DATA"):
        monkeypatch.setenv(f"XDG_{kind}_HOME", str(home / kind.lower()))
    return home


@pytest.fixture(autouse=True, scope="session")
def short_up_time() -> Iterator[None]:
    """Tasks without a ready check count as ready after 0.3 s, so that an apply in this process returns soon."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("edgectl.executor.action_phases.DEFAULT_UP_S", 0.3)
        yield


@pytest.fixture(scope="session")
def etcd(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EtcdCluster]:
    """A real etcd of one member; tests use different fleets."""
    with running_etcd(tmp_path_factory.mktemp("etcd")) as cluster:
        yield cluster


@pytest.fixture(scope="module")
def module_lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    """Three real ssh servers (edge1, edge2, robot1) that serve one test module."""
    with running_lab(tmp_path_factory.mktemp("lab"), ["edge1", "edge2", "robot1"]) as lab:
        yield lab


@pytest.fixture
def lab(module_lab: Lab, monkeypatch: pytest.MonkeyPatch) -> Lab:
    """The module's ssh servers, with fresh known_hosts and ssh_config, and the environment set so that they are found."""
    module_lab.write_files()
    for name, value in module_lab.environment.items():
        monkeypatch.setenv(name, value)
    return module_lab
