# SPDX-License-Identifier: Apache-2.0
"""``coordination`` of an inventory: addresses, files for TLS, and mistakes with their places."""

from pathlib import Path

import jsonschema
import pytest
import yaml

from edgectl.config.inventory_file import build_inventory_schema
from edgectl.config.load import load_inventory
from edgectl.errors import InputError
from edgectl.model.inventory import Coordination

REST = "version: 1\nfleet: lab\nedges: {e1: {host: h}}\n"


def read(tmp_path: Path, text: str) -> Coordination | None:
    path = tmp_path / "inventory.yaml"
    path.write_text(REST + text)
    return load_inventory(path).coordination


def fits_schema(text: str) -> bool:
    return bool(
        jsonschema.Draft202012Validator(build_inventory_schema()).is_valid(yaml.safe_load(REST + text))
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", None),
        ("coordination: etcd://10.0.0.5", Coordination(endpoints=(("10.0.0.5", 2379),))),
        (
            "coordination: etcds://a:1,b.lab:65535,[::1]:3",
            Coordination(endpoints=(("a", 1), ("b.lab", 65535), ("::1", 3)), tls=True),
        ),
        (
            "coordination: {address: etcds://a, ca: ca.pem, cert: c.pem, key: k.pem, user: u, password_command: [cat, p]}",
            Coordination(
                endpoints=(("a", 2379),),
                tls=True,
                ca="ca.pem",
                cert="c.pem",
                key="k.pem",
                user="u",
                password_command=("cat", "p"),
            ),
        ),
    ],
)
def test_what_is_valid(tmp_path: Path, text: str, expected: Coordination | None) -> None:
    assert read(tmp_path, text) == expected
    assert fits_schema(text)


def test_a_fleet_that_is_named_by_the_path_of_its_file_cannot_be_coordinated(tmp_path: Path) -> None:
    """Every machine would have a fleet of its own in etcd."""
    path = tmp_path / "inventory.yaml"
    path.write_text(text := "version: 1\nedges: {e1: {host: h}}\ncoordination: etcd://a\n")
    with pytest.raises(InputError, match=r"inventory.yaml:3:1: coordination needs fleet") as told:
        load_inventory(path)
    assert told.value.problems[0].hint.startswith("add fleet: ")
    schema = jsonschema.Draft202012Validator(build_inventory_schema())
    assert not schema.is_valid(yaml.safe_load(text))


@pytest.mark.parametrize(
    ("value", "column", "message", "hint"),
    [
        ("http://a:1", 15, "must be an address of etcd", "etcd://10.0.0.5:2379"),
        ("etcd://", 15, "no address of etcd: ''", "etcd://10.0.0.5:2379"),
        ("etcd://a:2379/path", 15, "no address of etcd: 'a:2379/path'", "etcd://"),
        ("etcd://a:0", 15, "no address of etcd: 'a:0'", "etcd://"),
        ("etcd://a:99999", 15, "no address of etcd", "etcd://"),
        ("etcd://a,b,a:2379", 15, "an address twice", "remove one"),
        ("etcd://" + ",".join("abcdefghij"), 15, "more than 9", "three or five"),
        ("etcd://root:secret@a:2379", 15, "contains a user or a password", "password_command"),
        ("[etcd://a]", 15, "must be a string", ""),
        ("{ca: x}", 15, "needs address", "add address"),
        ("{address: etcd://a, ca: x}", 35, "ca counts only with TLS", "etcds://"),
        ("{address: etcds://a, cert: x}", 36, "cert needs key", "add key"),
        ("{address: etcds://a, user: x}", 36, "user needs password_command", "add password_command"),
        ("{address: etcds://a, password: x}", 36, "plaintext passwords", "password_command"),
    ],
)
def test_mistakes(tmp_path: Path, value: str, column: int, message: str, hint: str) -> None:
    with pytest.raises(InputError) as told:
        read(tmp_path, f"coordination: {value}\n")
    first = told.value.problems[0]
    assert (first.line, first.column) == (4, column)
    assert message in first.message
    assert hint in first.hint
    assert "secret" not in first.message + first.source
