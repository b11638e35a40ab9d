# SPDX-License-Identifier: Apache-2.0
"""-o lists the formats that a command supports; --version; the fingerprint shown by trust."""

import pytest

from edgectl import __version__
from edgectl.model.resource import TERMS
from edgectl.transport.trust import get_public_key_path
from tests.cli.conftest import Run


@pytest.mark.parametrize(
    "words", [("plan", "-o", "html"), ("plan", "-o", "github"), ("plan", "--output=github")]
)
def test_a_form_that_a_command_has_not_is_refused_with_those_it_has(run: Run, words: tuple[str, ...]) -> None:
    said = run(*words)
    assert (said.code, said.out) == (64, "")
    assert said.err == (
        f'error: output format "{words[-1].removeprefix("--output=")}" is not supported here\n'
        "hint: use -o table, wide, json, jsonl, yaml, csv, name, markdown or gitlab\n"
    )


def test_the_environment_may_ask_for_more_than_a_command_has(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EDGECTL_OUTPUT", "wide")
    assert run("version").code == 0
    monkeypatch.setenv("EDGECTL_OUTPUT", "name")
    assert run("version").err == (
        'error: output format "name" is not supported here\nhint: use -o table, json, jsonl, yaml or csv\n'
    )


def test_version(run: Run) -> None:
    assert run("--version") == (0, f"edgectl {__version__}\n", "")


@pytest.mark.parametrize(
    ("kind", "file"),
    [
        ("ssh-ed25519", "ed25519"),
        ("ecdsa-sha2-nistp256", "ecdsa"),
        ("rsa-sha2-512", "rsa"),
        ("ssh-dss", "dsa"),
        ("new", "*"),
    ],
)
def test_the_file_of_a_host_key(kind: str, file: str) -> None:
    assert get_public_key_path(kind) == f"/etc/ssh/ssh_host_{file}_key.pub"


def test_a_semicolon_in_a_value_does_not_cut_the_message(run: Run) -> None:
    assert run(
        "plan", "-i", "inventories/local.yaml", "-t", "tasks/demo.yaml", "--weights", "cpu=1; rm"
    ).err == (
        "error: --weights: weight cpu must be a number, got '1; rm'\n"
        f"hint: write one of {', '.join(TERMS)}, all, resources, or weights such as cpu=.5,network=.5\n"
    )
