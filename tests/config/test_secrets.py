# SPDX-License-Identifier: Apache-2.0
"""Secrets in the files: hidden as soon as they are read, and never part of an error message."""

import random
from pathlib import Path

import pytest

from edgectl.config.load import load_inventory_and_tasks
from edgectl.errors import InputError
from edgectl.model.inventory import Inventory
from edgectl.model.secret import Secret
from edgectl.model.task import Task
from tests.config.broken_files import INVENTORY, TASKS

PLAIN = 'env: {ROBOT: "{robot}"}'


def load_task(directory: Path, tasks: str, inventory: str = INVENTORY) -> tuple[Inventory, Task]:
    (directory / "i.yaml").write_text(inventory)
    (directory / "t.yaml").write_text(tasks)
    fleet, found, _ = load_inventory_and_tasks(directory / "i.yaml", directory / "t.yaml")
    return fleet, found.tasks["navigation-robot1"]


def replace_env(text: str) -> str:
    assert PLAIN in TASKS
    return TASKS.replace(PLAIN, text)


def secret_entry(value: str) -> str:
    return replace_env(f"env: {{TOKEN: {{value: {value}, secret: true}}}}")


def test_a_secret_is_hidden_and_filled_in(tmp_path: Path) -> None:
    _, task = load_task(tmp_path, secret_entry('"canary-{robot}"'))
    token = task.env["TOKEN"]
    assert isinstance(token, Secret)
    assert token.reveal() == "canary-robot1"
    assert "canary" not in f"{task!r} {task.env} {token!r} {token}"


def test_a_value_that_is_not_secret_is_a_text(tmp_path: Path) -> None:
    _, task = load_task(tmp_path, replace_env("env: {TOKEN: {value: plain, secret: false}}"))
    assert task.env == {"TOKEN": "plain"}
    assert not isinstance(task.env["TOKEN"], Secret)


def test_names_that_only_sound_like_secrets_are_left_alone(tmp_path: Path) -> None:
    env = {
        "TOKEN_LIFETIME": "60",
        "SECRETARY": "x",
        "PASSWORD_FILE": "/run/p",
        "COMPASS": "n",
        "MY_TOKEN": "",
        "KEYBOARD": "de",
    }
    written = ", ".join(f'{name}: "{value}"' for name, value in env.items())
    assert load_task(tmp_path, replace_env(f"env: {{{written}}}"))[1].env == env


@pytest.mark.parametrize("fix", ["{value: plain, secret: true}", "{value: plain, secret: false}"])
def test_the_hint_for_a_secret_in_clear_mends_it(fix: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as raised:
        load_task(tmp_path, replace_env("env: {TOKEN: plain}"))
    (problem,) = raised.value.problems
    assert (problem.code, problem.source) == ("EC018", "")
    assert "TOKEN: {value: .., secret: true} (secret: false if it is none)" in problem.hint
    assert load_task(tmp_path, replace_env(f"env: {{TOKEN: {fix}}}"))[1].env


def test_no_digest_depends_on_a_value(tmp_path: Path) -> None:
    one, other = load_task(tmp_path, secret_entry("one"))[1], load_task(tmp_path, secret_entry("other"))[1]
    assert (one.spec_hash, one.spec_fields) == (other.spec_hash, other.spec_fields)
    assert one.spec_fields["env"] != load_task(tmp_path, TASKS)[1].spec_fields["env"]


def test_secrets_and_commands_of_hosts(tmp_path: Path) -> None:
    text = INVENTORY.replace(
        'env: {ROS_DOMAIN_ID: "7"}', "env: {KEY: {value: canary, secret: true}}, env_command: [vault, read]"
    )
    fleet, _ = load_task(tmp_path, TASKS, text)
    host = fleet.hosts["edge1"]
    assert host.env["KEY"] == "***"
    assert host.env_command == ("vault", "read")
    _, other = load_task(tmp_path, replace_env("env_command: [vault, read, slam]"))
    assert other.env_command == ("vault", "read", "slam")
    assert other.spec_fields["env_command"]


@pytest.mark.parametrize(
    ("env", "place", "message"),
    [
        (
            "env: {TOKEN: {value: 4711canary4711, secret: yes}}",
            (14, 50),
            "must be true or false, not a string",
        ),
        ("env: {TOKEN: {value: 47114711, secret: true}}", (14, 26), "must be a string without NUL"),
        ('env: {TOKEN: {value: "canary\\0", secret: true}}', (14, 26), "must be a string without NUL"),
        ("env: {TOKEN: {value: canary}}", (14, 18), "an environment variable needs secret"),
        ("env: {TOKEN: {secret: true}}", (14, 18), "an environment variable needs value"),
        ("env: {TOKEN: {value: canary, secrte: true}}", (14, 18), "unknown key in an environment variable"),
        ("env: {TOKEN: {value canary, secret: true}}", (14, 18), "unknown key in an environment variable"),
        ("env: {TOKEN: {value: *canary, secret: true}}", (14, 26), "cannot be read; the text is hidden"),
        (
            "env:\n      TOKEN:\n        value: @canary\n        secret: true",
            (16, 16),
            "cannot be read; the text is hidden",
        ),
        (
            "env:\n      TOKEN:\n        value: x\n      canary\n        secret: true",
            (17, 7),
            "cannot be read; the text is hidden",
        ),
        (
            "env:\n      TOKEN:\n        value: [47114711]\n        secret: true",
            (16, 16),
            "must be a string without NUL",
        ),
        ("env: {TOKEN: {value: canary, secret: true}", (14, 10), "cannot be read; the text is hidden"),
        ("env: {DB_PASSWORD: canary}", (14, 11), "DB_PASSWORD looks like a secret in plain text"),
        ('env: {api_key: "canary"}', (14, 11), "api_key looks like a secret"),
        ("env:\n      GITHUB_TOKEN: 4711", (15, 7), "GITHUB_TOKEN looks like a secret"),
        ("env_command: vault read-env", (14, 18), "must be a list of arguments, not a string"),
        ("env_command: []", (14, 18), "must name a program"),
    ],
)
def test_mistakes_have_a_place_and_show_no_secret(
    env: str, place: tuple[int, int], message: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError) as raised:
        load_task(tmp_path, replace_env(env))
    texts = [f"{p.message} {p.hint} {p.source}" for p in raised.value.problems]
    assert not any("canary" in text or "4711" in text for text in texts), texts
    found = [p for p in raised.value.problems if message in p.message]
    assert found, texts
    assert (found[0].line, found[0].column) == place
    assert found[0].hint


SOUND = (
    "env: {TOKEN: {value: canary4711, secret: true}}",
    "env:\n      TOKEN:\n        value: canary4711\n        secret: true",
)
STRAY = [*"{}[]:,@*&!\"'|>#%?\t\n\0", "- ", ": "]


def test_no_damage_makes_an_error_show_a_secret(tmp_path: Path) -> None:
    """One stray character anywhere in the entry, 500 times."""
    chance = random.Random(1)
    for _ in range(500):
        text = replace_env(chance.choice(SOUND))
        at = chance.randint(text.index("TOKEN"), text.index("secret: true") + 12)
        try:
            load_task(tmp_path, text[:at] + chance.choice(STRAY) + text[at + chance.randint(0, 1) :])
        except InputError as error:
            shown = [f"{problem.message} {problem.hint} {problem.source}" for problem in error.problems]
            assert not any("4711" in line for line in shown), shown
