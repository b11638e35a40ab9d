"""No test sees the user's home, keys, state or terminal settings; real ssh servers are one fixture away."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from tests.sshd import Lab, running_lab

# The same examples in every run, and no bound on time: what fails here fails again, and a machine that stands still fails nothing.
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
# Others in every run, or those of --hypothesis-seed; what was found is kept in .hypothesis and tried first.
settings.register_profile("search", _UNHURRIED, print_blob=True)
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
)


# Files that take longest: begun first, so that no worker is left with one of them when the others have ended.
LONGEST = (
    "cli/test_examples.py",
    "docs/test_pages.py",
    "faults/test_quick.py",
    "usecases/test_life.py",
    "agent/test_crashloop.py",
    "docs/test_demo.py",
    "e2e/test_unreachable.py",
    "soak/test_soak.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files first, everything else in its order."""
    places = {Path(__file__).parent / name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path, len(places)))


@pytest.fixture(autouse=True)
def isolated(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty HOME with empty XDG directories, and an ssh_config that knows nobody; returns that home."""
    home = tmp_path_factory.mktemp("home")
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
