# SPDX-License-Identifier: Apache-2.0
"""Packages without the modules that they import for nothing: each test in a process that has imported nothing yet."""

import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from edgectl.deferred_imports import DEFERRED_MODULES

DEFER = "import sys\nfrom edgectl.deferred_imports import import_deferred\n"
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


@pytest.mark.parametrize("name", DEFERRED_MODULES)
def test_nothing_deferred_is_imported(name: str) -> None:
    """Nothing that a package does while it is imported uses what is deferred: a version that does would import all."""
    before = "import_deferred('paramiko')\n" if name == "fabric" else ""
    found = list_modules(f"{DEFER}{before}import_deferred('{name}')")
    assert name in found
    assert not found & set(DEFERRED_MODULES[name])


def test_files_are_read_by_the_parser_in_c_alone() -> None:
    found = list_modules(DEFER + "from edgectl.config.yaml_parser import parse_yaml")
    assert "yaml._yaml" in found
    assert not found & set(DEFERRED_MODULES["yaml"])


def test_yaml_works_whole_where_a_plugin_uses_it() -> None:
    said = run_python(
        """
from edgectl.config.yaml_library import yaml
class Loader(yaml.SafeLoader):
    pass
Loader.add_constructor("!double", lambda loader, node: 2 * int(node.value))
yaml.add_constructor("!triple", lambda loader, node: 3 * int(node.value), Loader=Loader)
print(yaml.load("[!double 4, !triple 4]", Loader=Loader), yaml.safe_load("a: 1"), issubclass(Loader, yaml.SafeLoader))
print(yaml.safe_dump({"a": [1]}, default_flow_style=True).strip(), yaml.load("b: 2", Loader=yaml.CSafeLoader))
print(yaml.loader.SafeLoader is Loader.__mro__[1], isinstance(Loader("x"), yaml.SafeLoader), yaml.reader.Reader.__name__)
try:
    yaml.safe_load("a: [")
except yaml.YAMLError as error:
    print(type(error).__name__)
import yaml.loader, yaml.constructor
print(yaml.loader.Loader.__name__, yaml.constructor.SafeConstructor in Loader.__mro__)
"""
    )
    assert said.splitlines() == [
        "[8, 12] {'a': 1} True",
        "{a: [1]} {'b': 2}",
        "True True Reader",
        "ParserError",
        "Loader True",
    ]


def test_paramiko_works_whole_where_a_plugin_uses_it() -> None:
    said = run_python(
        IMPORT_SSH
        + """
import io, paramiko
from cryptography.hazmat.primitives import serialization
class Server(paramiko.ServerInterface):
    pass
print(Server().check_channel_request("session", 1), issubclass(Server, paramiko.ServerInterface), isinstance(3, paramiko.AgentKey))
print(paramiko.SFTPClient.from_transport.__name__, paramiko.SFTPAttributes().st_size, paramiko.SFTP_OK)
key = paramiko.RSAKey.generate(2048)
text = io.StringIO()
key.write_private_key(text)
print(serialization.load_ssh_private_key.__name__ if hasattr(serialization.load_ssh_private_key, "__name__") else "deferred")
print(paramiko.RSAKey.from_private_key(io.StringIO(text.getvalue())) == key)
import paramiko.server, paramiko.sftp_client
print(paramiko.server.ServerInterface is Server.__mro__[1], paramiko.sftp_client.SFTPClient.__name__)
"""
    )
    assert said.splitlines() == [
        "1 True False",
        "from_transport None 0",
        "deferred",
        "True",
        "True SFTPClient",
    ]


@pytest.mark.parametrize(
    "use",
    [
        "from unittest.mock import Mock\nprint(Mock + 1)",
        "from unittest.mock import *\nMagicMock",
        "import unittest.mock\nunittest.mock.__file__",
    ],
)
def test_what_is_imported_again_is_as_new(tmp_path: Path, use: str) -> None:
    """A package that fails with stand-ins is imported from its beginning: nothing of it keeps one."""
    (tmp_path / "later").mkdir()
    (tmp_path / "later" / "first.py").write_text("from unittest.mock import sentinel\n")
    body = "from later.first import sentinel\n" + use.replace("print(Mock + 1)", "Mock | int")
    (tmp_path / "later" / "__init__.py").write_text(body + "\n")
    said = run_python(
        "from edgectl import deferred_imports\n"
        "deferred_imports.DEFERRED_MODULES['later'] = ('unittest.mock',)\n"
        "later = deferred_imports.import_deferred('later')\n"
        "import unittest.mock\n"
        "print(later.sentinel is unittest.mock.sentinel, later.first.sentinel is unittest.mock.sentinel)\n",
        tmp_path,
    )
    assert said.split() == ["True", "True"]


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
        "from edgectl import deferred_imports\n"
        "deferred_imports.DEFERRED_MODULES['later'] = deferred_imports.DEFERRED_MODULES['fabric']\n"
        "later = deferred_imports.import_deferred('later')\n"
        "print(later.Context()().return_value is not None, later.answer, later.number)\n",
        tmp_path,
    )
    assert said.split() == ["True", "sentinel.answer", version("paramiko")]


def test_a_version_that_no_directory_names_is_read_as_always(tmp_path: Path) -> None:
    (tmp_path / "asks.py").write_text("from importlib import metadata\nnumber = metadata.version('pyyaml')\n")
    said = run_python(
        "from edgectl import deferred_imports\n"
        "deferred_imports.DEFERRED_MODULES['asks'] = ('importlib.metadata',)\n"
        "print(deferred_imports.import_deferred('asks').number)\n",
        tmp_path,
    )
    assert said.strip() == version("pyyaml")
