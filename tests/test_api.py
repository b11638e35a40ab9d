"""The Python interface: its page, its promise, and that it decides as the command line does."""

import inspect
import json
import logging
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl import api
from edgectl.api import EdgectlError, Fleet, InputError, PolicyName, UsageError, Weights, load_snapshot
from edgectl.formats.kinds import PLAN_KIND
from edgectl.model.plan import Plan
from edgectl.scaffold.write import write_scaffold
from tests.cli.inprocess import edgectl
from tests.docs.blocks import environment, make_tasks_idle, stopped
from tests.views.fixtures import ROOT, SNAPSHOT

PAGE = ROOT / "docs" / "api.md"


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scaffold as the current folder, with a state directory of its own."""
    write_scaffold(tmp_path / "site")
    make_tasks_idle(tmp_path / "site")
    monkeypatch.chdir(tmp_path / "site")
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    return tmp_path / "site"


def test_the_examples_of_the_page_run(site: Path) -> None:
    """In a process of their own, one after the other; then the command line finds nothing to do."""
    program = "\n".join(re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL))
    env = environment(site.parent / "state")
    with stopped(env, site):
        ran = subprocess.run(
            [sys.executable, "-W", "error", "-c", program],
            env=env,
            cwd=site,
            capture_output=True,
            text=True,
            check=False,
        )
        assert ran.returncode == 0, ran.stderr
        assert "not confirmed" not in ran.stdout
        assert len(re.findall(r" done$", ran.stdout, re.MULTILINE)) == 10, ran.stdout
        assert re.search(r"^no-such-inventory.yaml: .* / .* / 64$", ran.stdout, re.MULTILINE)
        after = json.loads(edgectl(["plan", "-o", "json"], site, env).out)
        assert {row["action"] for row in after["decisions"]} == {"keep"}


@pytest.mark.parametrize(
    ("words", "change"),
    [
        ([], {}),
        (["--weights", "network=1"], {"weights": Weights(cpu=0.0, memory=0.0, network=1.0, task=0.0)}),
        (["--policy", "paper"], {"name": PolicyName.PAPER}),
        (["--without", "edge3"], {"without": frozenset({"edge3"})}),
        (["--best-effort", "--rebalance"], {"best_effort": True, "rebalance": True}),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_it_decides_as_the_command_line_does(site: Path, words: list[str], change: dict[str, object]) -> None:
    said = edgectl(
        ["plan", "--snapshot", str(SNAPSHOT), "-o", "json", *words], site, environment(site.parent / "state")
    )
    fleet = Fleet.load("inventories/local.yaml", "tasks/demo.yaml", warn=lambda _: None)
    made = fleet.plan(replace(fleet.policy, **change) if change else None, snapshot=load_snapshot(SNAPSHOT))  # type: ignore[arg-type]
    assert said.code == 0, said.err
    document = json.loads(said.out)
    encoded = json.loads(json.dumps(PLAN_KIND.encode(made)))
    assert len(encoded["decisions"]) == 10
    assert [show_decision(row) for row in encoded["decisions"]] == [
        show_decision(row) for row in document["decisions"]
    ]
    assert encoded["weights"] == pytest.approx(document["weights"])


def show_decision(row: dict[str, object]) -> tuple[object, ...]:
    return row["task"], row["host"], row["action"], row["reason"], pytest.approx(row["total"], abs=1e-5)


def test_a_declined_plan_changes_nothing(site: Path) -> None:
    seen: list[Plan] = []

    def decline(plan: Plan) -> bool:
        seen.append(plan)
        return False

    fleet = Fleet.load("inventories/local.yaml", "tasks/demo.yaml")
    done = fleet.apply(confirm=decline, attended=True)
    assert (done.declined, done.results, len(seen)) == (True, None, 1)
    assert {task for host in fleet.probe().hosts.values() for task in host.tasks} == set()


@pytest.mark.parametrize(
    "wrong",
    [
        lambda fleet: fleet.plan(replace(fleet.policy, weights=Weights(cpu=-1.0))),
        lambda fleet: fleet.plan(replace(fleet.policy, without=frozenset({"edge9"}))),
        lambda fleet: fleet.plan(replace(fleet.policy, optimal=True, rebalance=True)),
        lambda fleet: fleet.watch(every=0),
        lambda _: Fleet.load("inventories/local.yaml", "no/such/tasks.yaml"),
        lambda _: load_snapshot("no/such/snapshot.json"),
    ],
)
def test_wrong_calls_raise_errors_of_the_tree(site: Path, wrong: Callable[[Fleet], object]) -> None:
    del site
    fleet = Fleet.load("inventories/local.yaml", "tasks/demo.yaml")
    with pytest.raises(EdgectlError) as raised:
        wrong(fleet)
    assert raised.value.exit_code == 64
    assert raised.value.hint or isinstance(raised.value, InputError)


def test_files_that_others_may_write_are_refused(site: Path) -> None:
    (site / "tasks" / "demo.yaml").chmod(0o666)
    with pytest.raises(EdgectlError, match="every user may change it"):
        Fleet.load()


def test_no_file_to_choose(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError):
        Fleet.load()


def test_warnings_go_to_the_logger(site: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = site / "inventories" / "local.yaml"
    file.write_text(re.sub(r"^fleet: .*\n", "", file.read_text(), flags=re.MULTILINE))
    with caplog.at_level(logging.WARNING, logger="edgectl"):
        Fleet.load()
    assert "EC103" in caplog.text


def test_the_page_names_what_there_is() -> None:
    """The promise: a name that goes, or a parameter, is noticed here."""
    table = PAGE.read_text().partition("## What there is")[2].partition("## Promise")[0]
    named = {
        name
        for row in re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)
        for name in re.findall(r"`(\w+)", row)
    }
    assert named == set(api.__all__)
    for call in re.findall(r"`(\w+)\(([^)]*)\)`", table.partition("| `load_snapshot")[0]):
        stated = [word.strip().rstrip("=") for word in call[1].split(",")]
        parameters = [
            name for name in inspect.signature(getattr(Fleet, call[0])).parameters if name != "self"
        ]
        assert stated == parameters, call[0]
