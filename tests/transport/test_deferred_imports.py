# SPDX-License-Identifier: Apache-2.0
"""Packages without the modules that they import for nothing: each test in a process that has imported nothing yet."""

import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from edgectl.transport.deferred_imports import DEFERRED_MODULES

DEFER = "import sys\nfrom edgectl.transport.deferred_imports import import_deferred\n"
IMPORT_SSH = DEFER + "import_deferred('paramiko')\nimport edgectl.transport.ssh\n"
IMPORT_FABRIC = IMPORT_SSH + "import_deferred('fabric')\nimport fabric\n"
# What the modules that are deferred import themselves.
BEHIND = {"asyncio", "ssl", "email", "unittest"}


def run_python(source: str, directory: Path | None = None) -> str:
    command = [sys.executable, "-c", source]
    return subprocess.run(command, cwd=directory, capture_output=True, text=True, check=True).stdout


def list_modules(source: str) -> set[str]:
    return set(run_python(source + "\nprint(*sys.modules)").split())


def test_ssh_to_a_host_needs_neither_fabric_nor_invoke() -> None:
    found = list_modules(IMPORT_SSH)
    assert "paramiko.transport" in found
    assert not found & {"fabric", "decorator", *DEFERRED_MODULES["paramiko"], *BEHIND}


def test_nothing_deferred_is_imported_with_fabric() -> None:
    found = list_modules(IMPORT_FABRIC)
    assert {"fabric", "paramiko", "invoke.context"} <= found
    assert not found & {*DEFERRED_MODULES["fabric"], *BEHIND}


@pytest.mark.parametrize("name", DEFERRED_MODULES)
def test_plain_imports_would_import_all_of_it(name: str) -> None:
    """Else there is nothing left to defer."""
    assert set(DEFERRED_MODULES[name]) <= list_modules(f"import sys, {name}")


def test_typer_starts_without_what_only_mistakes_need() -> None:
    found = list_modules(DEFER + "import_deferred('typer.main')")
    assert "typer.main" in found
    assert not found & set(DEFERRED_MODULES["typer.main"])


def test_what_was_deferred_works_when_it_is_used(tmp_path: Path) -> None:
    (tmp_path / "settings.yaml").write_text("run: {echo: true}\n")
    said = run_python(
        IMPORT_FABRIC
        + """
import invoke, paramiko
context = invoke.MockContext(run=invoke.Result("answer"))
print(context.run("question").stdout, context.run.call_count)
config = fabric.Config(runtime_path="settings.yaml", lazy=True)
config.load_runtime()
print(config.run.echo, paramiko.__version__)
import importlib.metadata, unittest.mock
print(unittest.mock.Mock.__module__, importlib.metadata.version("paramiko"))
""",
        tmp_path,
    )
    wanted = version("paramiko")
    assert said.split() == ["answer", "1", "True", wanted, "unittest.mock", wanted]


def test_what_paramiko_and_typer_deferred_works_when_it_is_used() -> None:
    said = run_python(
        IMPORT_SSH
        + """
import_deferred('typer.main')
import io, paramiko, typer.core, typer.main
config = paramiko.SSHConfig.from_text('Match exec true\\n  User yes\\nMatch exec false\\n  User no\\n')
print(config.lookup('edge1')['user'], typer.core.get_close_matches('prob', ['plan', 'probe'])[0])
print(typer.main.platform.system(), 'difflib' in sys.modules, 'invoke' in sys.modules, 'platform' in sys.modules)
"""
    )
    assert said.split() == ["yes", "probe", "Linux", "True", "True", "True"]


def test_imports_of_many_threads_at_once_are_whole() -> None:
    """Each jump host has a thread of its own."""
    said = run_python(
        IMPORT_SSH
        + """
from concurrent.futures import ThreadPoolExecutor
sys.setswitchinterval(1e-6)
def use(_):
    import_deferred('fabric')
    import fabric
    return fabric.Connection('edge1', config=fabric.Config(lazy=True)).host
with ThreadPoolExecutor(8) as pool:
    print(*set(pool.map(use, range(16))), 'unittest.mock' in sys.modules)
"""
    )
    assert said.split() == ["edge1", "False"]


def test_a_module_that_needs_more_than_calls_is_imported_with_all(tmp_path: Path) -> None:
    """As a later version of invoke may be: it makes a class of what is deferred, and reads a constant."""
    (tmp_path / "later.py").write_text(
        "from unittest.mock import Mock, sentinel\n"
        "from importlib.metadata import version\n"
        "class Context(Mock): pass\n"
        "answer = sentinel.answer\n"
        "number = version('paramiko')\n"
    )
    said = run_python(
        "from edgectl.transport import deferred_imports\n"
        "deferred_imports.DEFERRED_MODULES['later'] = deferred_imports.DEFERRED_MODULES['fabric']\n"
        "later = deferred_imports.import_deferred('later')\n"
        "print(later.Context()().return_value is not None, later.answer, later.number)\n",
        tmp_path,
    )
    assert said.split() == ["True", "sentinel.answer", version("paramiko")]


def test_a_version_that_no_directory_names_is_read_as_always(tmp_path: Path) -> None:
    (tmp_path / "asks.py").write_text("from importlib import metadata\nnumber = metadata.version('pyyaml')\n")
    said = run_python(
        "from edgectl.transport import deferred_imports\n"
        "deferred_imports.DEFERRED_MODULES['asks'] = ('importlib.metadata',)\n"
        "print(deferred_imports.import_deferred('asks').number)\n",
        tmp_path,
    )
    assert said.strip() == version("pyyaml")
