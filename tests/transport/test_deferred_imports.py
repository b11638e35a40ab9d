# SPDX-License-Identifier: Apache-2.0
"""Fabric without the modules that it imports for nothing: each test in a process that has imported nothing yet."""

import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

from edgectl.transport.deferred_imports import DEFERRED_MODULES

IMPORT_SSH = """
import sys
from edgectl.transport.deferred_imports import import_deferred
import_deferred("edgectl.transport.ssh")
"""


def run_python(source: str, directory: Path | None = None) -> str:
    command = [sys.executable, "-c", source]
    return subprocess.run(command, cwd=directory, capture_output=True, text=True, check=True).stdout


def list_modules(source: str) -> set[str]:
    return set(run_python(source + "\nprint(*sys.modules)").split())


def test_nothing_deferred_is_imported_with_fabric() -> None:
    found = list_modules(IMPORT_SSH)
    assert {"fabric", "paramiko", "invoke.context"} <= found
    assert not found & {*DEFERRED_MODULES, "asyncio", "ssl", "email", "unittest"}


def test_plain_imports_would_import_all_of_it() -> None:
    """Else there is nothing left to defer."""
    found = list_modules("import sys, edgectl.transport.ssh")
    assert {*DEFERRED_MODULES, "asyncio", "ssl", "email", "unittest"} <= found


def test_what_was_deferred_works_when_it_is_used(tmp_path: Path) -> None:
    (tmp_path / "settings.yaml").write_text("run: {echo: true}\n")
    said = run_python(
        IMPORT_SSH
        + """
import fabric, invoke, paramiko
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
        "from edgectl.transport.deferred_imports import import_deferred\n"
        "later = import_deferred('later')\n"
        "print(later.Context()().return_value is not None, later.answer, later.number)\n",
        tmp_path,
    )
    assert said.split() == ["True", "sentinel.answer", version("paramiko")]


def test_a_version_that_no_directory_names_is_read_as_always(tmp_path: Path) -> None:
    (tmp_path / "asks.py").write_text("from importlib import metadata\nnumber = metadata.version('pyyaml')\n")
    said = run_python(
        "import sys\nfrom edgectl.transport.deferred_imports import import_deferred\n"
        "print(import_deferred('asks').number)\n",
        tmp_path,
    )
    assert said.strip() == version("pyyaml")
