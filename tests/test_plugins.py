# SPDX-License-Identifier: Apache-2.0
"""Plugins of other packages: the worked package, installed beside edgectl, and packages that are broken."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import NamedTuple

import pytest

from edgectl.config.load import load_inventory_and_tasks
from edgectl.errors import PluginError, UsageError
from edgectl.model.policy import WEIGHT_PRESETS, Policy
from edgectl.plugins import PluginGroup, load_plugin, load_plugins
from edgectl.scaffold.write import write_scaffold
from edgectl.transport.fake import FakeTransport
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan import make_plan
from tests.builders import a_sample, a_snapshot
from tests.docs.blocks import environment, make_tasks_idle
from tests.views.fixtures import ROOT

EXAMPLE = ROOT / "docs" / "examples" / "plugin"


def install(package: Path, site: Path) -> None:
    """Unpack a package as an installer does: its module, its name, its entry points. No index is asked."""
    project = tomllib.loads((package / "pyproject.toml").read_text())["project"]
    module = project["name"].replace("-", "_")
    (site / module).mkdir(parents=True)
    (site / module / "__init__.py").write_bytes((package / module / "__init__.py").read_bytes())
    write_metadata(site, project["name"], project["version"], project["entry-points"])


def write_metadata(site: Path, name: str, version: str, points: dict[str, dict[str, str]]) -> None:
    info = site / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    info.joinpath("METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    lines = [
        line
        for group, each in points.items()
        for line in (f"[{group}]", *(f"{k} = {v}" for k, v in each.items()))
    ]
    info.joinpath("entry_points.txt").write_text("\n".join(lines) + "\n")


class Ran(NamedTuple):
    code: int
    out: str
    err: str


def run(words: list[str], site: Path, packages: Path) -> Ran:
    env = {**environment(site.parent / "state"), "PYTHONPATH": str(packages)}
    done = subprocess.run(
        ["edgectl", *words],
        cwd=site,
        env=env,
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        check=False,
    )
    return Ran(done.returncode, done.stdout, done.stderr)


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """Three hosts of this machine, two of them by the transport of the example; its notifier is told of all events."""
    site = tmp_path / "fleet"
    write_scaffold(site)
    make_tasks_idle(site)
    file = site / "inventories" / "local.yaml"
    text = file.read_text()
    hook = (
        f"on_event:\n- {{notifier: file, options: {{path: {tmp_path / 'events'}}}, kinds: all, every: 0}}\n"
    )
    file.write_text(text.replace("\nedges:", f"\n{hook}edges:"))
    for name in ("edge3", "edge1"):
        text = file.read_text()
        assert f"{name}: {{" in text
        file.write_text(text.replace(f"{name}: {{", f"{name}: {{transport: loud-local, "))
    return site


def test_the_worked_package(site: Path, tmp_path: Path) -> None:
    packages = tmp_path / "packages"
    install(EXAMPLE, packages)
    probed = run(["probe", "-o", "json"], site, packages)
    assert probed.code == 0, probed.err
    assert sorted({line for line in probed.err.splitlines() if line.startswith("loud-local")}) == [
        "loud-local: edge1",
        "loud-local: edge3",
    ]
    assert {host["status"] for host in json.loads(probed.out)["hosts"].values()} == {"ok"}
    found = json.loads(run(["doctor", "edge1", "edge2", "-o", "json"], site, packages).out)["items"]
    assert sorted(item["host"] for item in found if item["check"] == "lab memory") == ["edge1", "edge2"]
    tried = run(["events", "test", "--kind", "task-failed"], site, packages)
    assert tried.code == 0, tried.out + tried.err
    (line,) = [
        line for line in (tmp_path / "events").read_text().splitlines() if "a test of on_event" in line
    ]
    assert json.loads(line)["kind"] == "task-failed"


def test_the_term_and_the_policy_of_the_worked_package(site: Path, tmp_path: Path) -> None:
    """A plan names plugin and version, and is the same bytes without them: the ratings are in the snapshot."""
    packages, empty = tmp_path / "packages", tmp_path / "empty"
    install(EXAMPLE, packages)
    empty.mkdir()
    edge = "edge2: {"
    inventory = site / "inventories" / "local.yaml"
    text = inventory.read_text().replace("transport: loud-local, ", "")
    assert edge in text
    inventory.write_text(text.replace(edge, edge + "labels: {sun: 'yes'}, "))
    tasks = site / "tasks" / "demo.yaml"
    stated = tasks.read_text()
    tasks.write_text(stated.replace("weights: all\n", "terms: [lab-shade]\nweights: rating\n", 1))
    probed = run(["probe", "--out", "now.json"], site, packages)
    assert probed.code == 0, probed.err
    saved = run(["plan", "--snapshot", "now.json", "--out", "next.plan", "-o", "wide"], site, packages)
    assert saved.code == 0, saved.err
    assert "RATING" in saved.out
    plan = json.loads((site / "next.plan").read_text())
    assert plan["options"]["terms"] == ["lab-shade"]
    assert plan["snapshot"]["ratings"]["lab-shade"]["package"] == "edgectl-lab-plugin 0.1.0"
    placed = {each["task"]: each["host"] for each in plan["decisions"]}
    assert {task for task, host in placed.items() if host == "edge2"} == {"slam-robot2"}, (
        "its file pins it there"
    )
    (site / "rated.json").write_text(json.dumps({"format_version": 2, **plan["snapshot"]}))
    for where in (packages, empty):
        again = run(["plan", "--snapshot", "rated.json", "-o", "json"], site, where)
        assert (again.code, json.loads(again.out)["decisions"]) == (0, plan["decisions"]), again.err
    refused = run(["plan", "--snapshot", "now.json"], site, empty)
    assert refused.code == 64
    assert refused.err.startswith("error: unknown term lab-shade: no installed package has it\n")
    assert "a snapshot or a plan that was made with it holds its ratings" in refused.err
    tasks.write_text(stated)
    fewest = run(["plan", "--snapshot", "now.json", "--policy", "lab-fewest", "-o", "json"], site, packages)
    assert json.loads(fewest.out)["options"]["terms"] == ["lab-fewest"]
    unknown = run(["plan", "--snapshot", "now.json", "--policy", "lab-fewst"], site, packages)
    assert (unknown.code, unknown.err) == (
        64,
        "error: unknown policy 'lab-fewst'\nhint: did you mean lab-fewest?\n",
    )


@pytest.mark.parametrize(
    ("body", "why"),
    [
        (
            "return {'slam-robot1': {'edge1': 1.5}}",
            "ValueError: the rating of edge1 for slam-robot1 must be a number",
        ),
        (
            "return {'slam-robot1': {'edge9': 0.5}}",
            "ValueError: it rates 'edge9', which is neither a task nor a host",
        ),
        ("return [1]", "AttributeError"),
        ("return 1 / 0", "ZeroDivisionError: division by zero"),
    ],
)
def test_a_term_that_fails_is_named_and_nothing_is_planned(
    body: str, why: str, site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "bad_term.py").write_text(f"def rate(inventory, tasks, snapshot):\n    {body}\n")
    write_metadata(tmp_path, "bad-term", "3.1", {"edgectl.terms": {"odd": "bad_term:rate"}})
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "bad_term", raising=False)
    inventory, tasks, _ = load_inventory_and_tasks(
        site / "inventories" / "local.yaml", site / "tasks" / "demo.yaml"
    )
    fleet = Fleet(inventory=inventory, tasks=tasks, transport=FakeTransport({}), state=tmp_path)
    policy = Policy(terms=("odd",), weights=WEIGHT_PRESETS["rating"])
    with pytest.raises(PluginError, match=rf"^term odd of bad-term 3.1 failed: {why}"):
        make_plan(fleet, policy, snapshot=a_snapshot(edge1=a_sample()))


def test_what_is_not_installed_is_named(site: Path, tmp_path: Path) -> None:
    (tmp_path / "packages").mkdir()
    probed = run(["probe"], site, tmp_path / "packages")
    assert "unknown transport loud-local: no installed package has it" in probed.out + probed.err
    tried = run(["events", "test"], site, tmp_path / "packages")
    assert (tried.code, "unknown notifier file" in tried.out) == (1, True)


def test_a_broken_package_is_named_and_others_go_on(site: Path, tmp_path: Path) -> None:
    packages = tmp_path / "packages"
    install(EXAMPLE, packages)
    packages.joinpath("bad_lab.py").write_text(
        "def no_transport():\n    raise RuntimeError('no serial line')\n"
        "def no_check(inventory, answers, snapshot):\n    return 1 / 0\n"
        "def no_findings(inventory, answers, snapshot):\n    return ['all is well']\n"
    )
    points = {
        "edgectl.checks": {"divide": "bad_lab:no_check", "words": "bad_lab:no_findings"},
        "edgectl.transports": {"serial": "bad_lab:no_transport"},
    }
    write_metadata(packages, "bad-lab", "2.0", points)
    file = site / "inventories" / "local.yaml"
    file.write_text(file.read_text().replace("edge2: {", "edge2: {transport: serial, "))
    probed = run(["probe"], site, packages)
    assert "transport serial of bad-lab 2.0 failed: RuntimeError: no serial line" in probed.out + probed.err
    assert "Traceback" not in probed.err
    said = run(["doctor", "edge1", "-o", "json"], site, packages)
    assert said.code == 1, said.err
    found = {
        item["message"]: item["level"] for item in json.loads(said.out)["items"] if item["check"] != "ok"
    }
    assert found["check divide of bad-lab 2.0 failed: ZeroDivisionError: division by zero"] == "failed"
    assert any(message.startswith("check words of bad-lab 2.0 failed: TypeError") for message in found)
    assert any("maps" in message for message in found), "the check of the other package ran"


def test_names_in_two_packages_and_modules_that_are_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("zeta", "alpha"):
        write_metadata(tmp_path, name, "1.0", {"edgectl.transports": {"twice": "json:loads"}})
    write_metadata(
        tmp_path,
        "gone",
        "0.1",
        {"edgectl.checks": {"x": "no_such_module:f"}, "edgectl.notifiers": {"y": "os:name"}},
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(PluginError, match=r"transport twice is in two packages: alpha 1.0 and zeta 1.0"):
        load_plugin(PluginGroup.TRANSPORTS, "twice")
    with pytest.raises(PluginError, match=r"check x of gone 0.1 failed: ModuleNotFoundError"):
        load_plugins(PluginGroup.CHECKS)
    with pytest.raises(PluginError, match=r"notifier y of gone 0.1: os:name is not callable"):
        load_plugin(PluginGroup.NOTIFIERS, "y")
    with pytest.raises(UsageError) as raised:
        load_plugin(PluginGroup.TRANSPORTS, "none")
    assert raised.value.hint == "installed: twice"


def test_nothing_of_it_is_imported_where_nothing_names_it(site: Path) -> None:
    """Entry points cost 15 ms: a plan of plain hosts does not look for any."""
    program = (
        "import sys; from edgectl.cli.main import main; code = main(['validate', '-i', 'plain.yaml']); "
        "sys.exit(code or 3 * ('importlib.metadata' in sys.modules or 'edgectl.plugins' in sys.modules))"
    )
    text = (site / "inventories" / "local.yaml").read_text().replace("transport: loud-local, ", "")
    (site / "plain.yaml").write_text(text)
    env = {**os.environ, "EDGECTL_STATE_DIR": str(site.parent / "state")}
    assert subprocess.run([sys.executable, "-c", program], cwd=site, env=env, check=False).returncode == 0
