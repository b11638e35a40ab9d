# SPDX-License-Identifier: Apache-2.0
"""Files of other engines: their own schemas accept them, and they say what the plan says."""

import json
import shlex
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml
from jsonschema import Draft201909Validator, Draft202012Validator
from referencing import Registry, Resource
from referencing.jsonschema import DRAFT202012

from edgectl.config.load import load_inventory_and_tasks
from edgectl.errors import UsageError
from edgectl.export.bluechi import PLACEMENTS_FILE, build_bluechi_units, quote_argument
from edgectl.export.compose import build_compose_files
from edgectl.export.engine_task import EngineFiles, EngineTask, select_probe
from edgectl.export.kubernetes import build_manifests
from edgectl.export.nomad import build_nomad_jobs
from edgectl.model.check import Check
from edgectl.model.manager_state import ManagerState
from edgectl.transport.fake import FakeTransport
from edgectl.usecases.engine_export import list_engine_tasks, list_left_out, plan_for_engine
from edgectl.usecases.fleet import Fleet
from edgectl.views.encoder import encode_yaml, round_numbers
from tests.builders import a_link, a_sample, a_snapshot
from tests.export.test_systemd import AWKWARD, verify_units
from tests.pace import patience

SCHEMAS = Path(__file__).parents[2] / ".venv" / "share" / "schemas"
INVENTORY = """
version: 1
fleet: lab
defaults: {env: {ROS_DOMAIN_ID: "7"}, prelude: source /opt/ros/jazzy/setup.bash}
edges:
  zeta: {host: 10.0.0.3}
  mid: {host: 10.0.0.2}
  alpha: {host: 10.0.0.1, env: {TOKEN: {value: hush-hush, secret: true}}}
robots:
  robot1: {host: 10.0.1.1, probe: false}
"""
TASKS = """
version: 1
tasks:
  slam:
    image:
      {name: "registry.lab:5000/slam:2", gpus: 1, devices: [/dev/video0], volumes: ["/srv/maps:/maps:ro"], user: "1000:1000"}
    command: AWKWARD
    robot: robot1
    demand: {cpu: 1.5, memory: 900Mi, throughput: 1MB/s}
    limits: {cpu: 2, memory: 1Gi}
    ready: {command: test -f /tmp/ready, timeout: 3s}
    alive: {command: test -f /tmp/alive, after: 12s}
    on_unhealthy: restart
    stop: {signal: INT, grace: 7s}
    workdir: /maps
    hosts: {only: [zeta]}
    handoff: {order: start-first}
  nav_stack.2:
    command: nav
    image: nav:1
    needs: [slam]
    demand: {cpu: 10%, memory: 5%}
    hosts: {only: [zeta]}
    restart: always
  survey:
    command: survey --once
    image: survey:1
    kind: job
    needs: [{task: slam, until: running}]
    demand: {cpu: 0, memory: 0}
    hosts: {only: [alpha]}
    restart: never
  nowhere:
    command: x
    image: x:1
    demand: {cpu: 99, memory: 0}
""".replace("AWKWARD", json.dumps(f"echo $HOME $(date) {AWKWARD} && run"))
COMMAND = f"echo $HOME $(date) {AWKWARD} && run"


@pytest.fixture
def placed(tmp_path: Path) -> list[EngineTask]:
    return make_tasks(tmp_path)


def make_tasks(tmp_path: Path, text: str = TASKS, image: str | None = None) -> list[EngineTask]:
    """The tasks of a file where a plan puts them."""
    (tmp_path / "inventory.yaml").write_text(INVENTORY)
    (tmp_path / "tasks.yaml").write_text(text)
    found = load_inventory_and_tasks(tmp_path / "inventory.yaml", [tmp_path / "tasks.yaml"])
    inventory, tasks = found[0], found[1]
    # No host has a container engine that edgectl could use: another engine runs the tasks.
    samples = {
        host.name: replace(a_sample(links={"robot1": a_link()}), engines=()) for host in inventory.edges
    }
    snapshot = a_snapshot(samples, memory=ManagerState())
    fleet = Fleet(inventory=inventory, tasks=tasks, transport=FakeTransport({}), state=tmp_path)
    plan = plan_for_engine(fleet, snapshot)
    if text == TASKS:
        assert list_left_out(plan, tasks) == ["nowhere: left out, it has no host"]
    return list_engine_tasks(fleet, plan, image)


def read_yaml(content: object) -> Any:
    """What an engine reads of the text that is written."""
    return yaml.safe_load(encode_yaml(round_numbers(content)))  # type: ignore[arg-type]


@cache
def load_registry() -> Registry[Any]:
    definitions = json.loads((SCHEMAS / "kubernetes/_definitions.json").read_text())
    resource = Resource.from_contents(definitions, default_specification=DRAFT202012)
    found: Registry[Any] = Registry().with_resource("/api/_definitions.json", resource)
    return found


def check_manifest(manifest: Mapping[str, Any]) -> None:
    names = {
        "Deployment": "deployment-apps-v1",
        "Job": "job-batch-v1",
        "PodDisruptionBudget": "poddisruptionbudget-policy-v1",
    }
    schema = json.loads((SCHEMAS / f"kubernetes/{names[manifest['kind']]}.json").read_text())
    faults = list(Draft202012Validator(schema, registry=load_registry()).iter_errors(manifest))
    assert faults == [], [fault.message for fault in faults]


def test_the_schema_of_kubernetes_refuses_what_it_does_not_know(placed: list[EngineTask]) -> None:
    (first, _) = read_yaml(build_manifests(placed, "lab").files["slam.yaml"])
    first["spec"]["template"]["spec"]["containers"][0]["colour"] = "red"
    with pytest.raises(AssertionError, match="colour"):
        check_manifest(first)


def test_kubernetes_takes_the_manifests(placed: list[EngineTask]) -> None:
    made = build_manifests(placed, "lab")
    found = {name: read_yaml(content) for name, content in made.files.items()}
    kinds = {name: [each["kind"] for each in manifests] for name, manifests in found.items()}
    services = ["Deployment", "PodDisruptionBudget"]
    assert kinds == {"slam.yaml": services, "nav-stack-2.yaml": services, "survey.yaml": ["Job"]}
    for manifests in found.values():
        for manifest in manifests:
            check_manifest(manifest)
    assert "hush-hush" not in str(found)


def test_kubernetes_says_what_the_plan_says(placed: list[EngineTask]) -> None:
    made = build_manifests(placed, "lab")
    deployment, budget = read_yaml(made.files["slam.yaml"])
    pod = deployment["spec"]["template"]["spec"]
    container = pod["containers"][0]
    here = pod["affinity"]["nodeAffinity"]["requiredDuringSchedulingIgnoredDuringExecution"]
    assert here["nodeSelectorTerms"][0]["matchExpressions"][0]["values"] == ["zeta"]
    assert (pod["hostNetwork"], pod["hostIPC"], pod["terminationGracePeriodSeconds"]) == (True, True, 7)
    assert container["resources"] == {
        "requests": {"cpu": "1500m", "memory": str(900 * 2**20)},
        "limits": {"cpu": "2000m", "memory": str(2**30), "nvidia.com/gpu": "1"},
    }
    assert container["command"] == ["/bin/sh", "-c", COMMAND.replace("$", "$$")]
    assert container["readinessProbe"]["exec"]["command"][-1] == "test -f /tmp/ready"
    assert container["livenessProbe"]["failureThreshold"] == 3
    assert container["securityContext"] == {"runAsUser": 1000, "runAsGroup": 1000}
    assert {"name": "v0", "mountPath": "/maps", "readOnly": True} in container["volumeMounts"]
    assert {"name": "ROS_DOMAIN_ID", "value": "7"} in container["env"]
    assert deployment["spec"]["strategy"]["type"] == "RollingUpdate"
    assert budget["spec"]["selector"] == deployment["spec"]["selector"]
    job = read_yaml(made.files["survey.yaml"])[0]
    assert (job["spec"]["backoffLimit"], job["spec"]["template"]["spec"]["restartPolicy"]) == (0, "Never")
    secret = {"secretKeyRef": {"name": "survey-env", "key": "TOKEN"}}
    assert {"name": "TOKEN", "valueFrom": secret} in job["spec"]["template"]["spec"]["containers"][0]["env"]
    notes = "\n".join(made.notes)
    for part in (
        "nav_stack.2, survey: needs are left out",
        "survey: secrets are expected",
        "slam: stop signal INT",
        "slam: checks are asked in the container; edgectl asks them on the host",
    ):
        assert part in notes


@pytest.mark.parametrize(
    ("command", "asked"),
    [
        ("""docker exec "$EDGECTL_CONTAINER" sh -c 'test -e /tmp/up && true'""", "test -e /tmp/up && true"),
        ("podman exec $EDGECTL_CONTAINER rosnode info /slam", "rosnode info /slam"),
        ("docker exec -i ${EDGECTL_CONTAINER} sh -c", "sh -c"),
        ("docker exec $EDGECTL_CONTAINER echo 'open", "echo 'open"),
        ("docker exec other test -e /up", "docker exec other test -e /up"),
        ("curl -f http://localhost", "curl -f http://localhost"),
    ],
)
def test_a_check_in_the_container_is_asked_there_by_every_engine(command: str, asked: str) -> None:
    assert select_probe(Check(command=command)) == asked


def test_shares_are_of_the_host_of_the_plan(placed: list[EngineTask]) -> None:
    """10 % of the cores and 5 % of the memory of the host that the builders make."""
    sample = a_sample()
    demand = next(each.demand for each in placed if each.task.name == "nav_stack.2")
    assert demand["cpu"] == pytest.approx(0.1 * sample.usage["cpu"].capacity)
    assert demand["memory"] == pytest.approx(0.05 * sample.usage["memory"].capacity)


def test_compose_takes_the_files(placed: list[EngineTask]) -> None:
    made = build_compose_files(placed, "lab")
    schema = json.loads((SCHEMAS / "compose.json").read_text())
    found = {name: read_yaml(content) for name, content in made.files.items()}
    assert {name: set(file["services"]) for name, file in found.items()} == {
        "zeta.compose.yaml": {"slam", "nav-stack-2"},
        "alpha.compose.yaml": {"survey"},
    }
    for file in found.values():
        faults = list(Draft201909Validator(schema).iter_errors(file))
        assert faults == [], [fault.message for fault in faults]
    slam, nav = (
        found["zeta.compose.yaml"]["services"]["slam"],
        found["zeta.compose.yaml"]["services"]["nav-stack-2"],
    )
    assert slam["command"][-1] == COMMAND.replace("$", "$$")
    assert (slam["stop_signal"], slam["stop_grace_period"], slam["network_mode"]) == ("SIGINT", "7s", "host")
    assert slam["deploy"]["resources"]["reservations"]["devices"][0]["count"] == 1
    assert nav["depends_on"] == {"slam": {"condition": "service_healthy"}}
    survey = found["alpha.compose.yaml"]["services"]["survey"]
    assert survey["environment"]["TOKEN"] == "${TOKEN:?}"
    assert "hush-hush" not in str(found)
    assert "survey: needs on other hosts are left out: a compose file is of one host" in made.notes


# Keys of the job specification in JSON, by the objects of Nomad's API (version 1.9).
NOMAD_KEYS = {
    "Job": "ID Name Type Datacenters Meta Constraints TaskGroups Region Namespace Priority Affinities Spreads Periodic Update",
    "TaskGroups": "Name Count RestartPolicy ReschedulePolicy Tasks Constraints Affinities Networks Services Volumes Meta",
    "Tasks": "Name Driver User Config Env Resources KillSignal KillTimeout LogConfig Templates Constraints Services Meta",
    "Constraints": "LTarget RTarget Operand",
    "RestartPolicy": "Attempts Interval Delay Mode RenderTemplates",
    "ReschedulePolicy": "Attempts Interval Delay DelayFunction MaxDelay Unlimited",
    "Resources": "CPU Cores MemoryMB MemoryMaxMB DiskMB Networks Devices NUMA",
    "Devices": "Name Count Constraints Affinities",
    "LogConfig": "MaxFiles MaxFileSizeMB Disabled",
    "Templates": "SourcePath DestPath EmbeddedTmpl ChangeMode ChangeSignal Perms Envvars",
}


def list_unknown_keys(value: object, kind: str = "Job") -> Iterator[str]:
    if isinstance(value, list):
        for inner in value:
            yield from list_unknown_keys(inner, kind)
    elif isinstance(value, dict) and kind in NOMAD_KEYS:
        yield from (f"{kind}.{key}" for key in value.keys() - set(NOMAD_KEYS[kind].split()))
        for key, inner in value.items():
            yield from list_unknown_keys(inner, key)


def test_nomad_knows_the_keys_of_the_jobs(placed: list[EngineTask]) -> None:
    made = build_nomad_jobs(placed, "lab")
    jobs = {
        name: json.loads(json.dumps(round_numbers(content)))["Job"] for name, content in made.files.items()
    }
    assert set(jobs) == {"slam.nomad.json", "nav-stack-2.nomad.json", "survey.nomad.json"}
    assert [unknown for job in jobs.values() for unknown in list_unknown_keys(job)] == []
    slam, survey = jobs["slam.nomad.json"], jobs["survey.nomad.json"]
    assert (slam["Type"], survey["Type"]) == ("service", "batch")
    assert slam["Constraints"] == [{"LTarget": "${node.unique.name}", "Operand": "=", "RTarget": "zeta"}]
    task = slam["TaskGroups"][0]["Tasks"][0]
    assert (task["KillSignal"], task["KillTimeout"]) == ("SIGINT", 7 * 10**9)
    assert task["Resources"] == {
        "CPU": 1500,
        "MemoryMB": 900,
        "MemoryMaxMB": 1024,
        "Devices": [{"Name": "nvidia/gpu", "Count": 1}],
    }
    assert task["Config"]["args"] == ["-c", COMMAND]
    assert survey["TaskGroups"][0]["RestartPolicy"]["Attempts"] == 0
    assert "TOKEN" in survey["TaskGroups"][0]["Tasks"][0]["Templates"][0]["EmbeddedTmpl"]
    assert "hush-hush" not in str(jobs)


def test_a_task_without_image_runs_on_the_node_under_nomad_and_bluechi(tmp_path: Path) -> None:
    text = f"version: 1\ntasks:\n  talk: {{command: {json.dumps(COMMAND)}, workdir: /tmp, demand: {{cpu: 1, memory: 0}}, hosts: {{only: [mid]}}}}\n"
    placed = make_tasks(tmp_path, text)
    config = build_nomad_jobs(placed, "lab").files["talk.nomad.json"]["Job"]["TaskGroups"][0]["Tasks"][0]  # type: ignore[index]
    lines = config["Config"]["args"][1].split("\n")
    assert (config["Driver"], lines) == (
        "raw_exec",
        ["source /opt/ros/jazzy/setup.bash", "cd '/tmp'", COMMAND],
    )
    for build in (build_manifests, build_compose_files):
        with pytest.raises(UsageError, match="no image: talk") as raised:
            build(placed, "lab")
        assert "--image" in (raised.value.hint or "")
        assert build(make_tasks(tmp_path, text, "ros:jazzy"), "lab").files
    units = build_bluechi_units(placed, "lab").files
    assert list(units) == ["mid/edgectl-talk.service", PLACEMENTS_FILE]
    verify_units(
        {"edgectl-talk.service": str(units["mid/edgectl-talk.service"])}, tmp_path / "units", user=False
    )


def test_systemd_gives_the_command_to_the_shell_as_it_is() -> None:
    """What the quoting undoes, by the rules of systemd's manual, is the text."""
    text = f"{COMMAND}\nsecond\tline \\ 100%"
    quoted = quote_argument(text)
    plain = quoted[1:-1].replace("%%", "%").replace("$$", "$")
    assert plain.encode().decode("unicode_escape") == text


def test_bluechi_has_units_by_node_and_their_commands(placed: list[EngineTask]) -> None:
    made = build_bluechi_units(placed, "lab")
    assert list(made.files) == [
        "zeta/edgectl-slam.container",
        "zeta/edgectl-nav-stack-2.container",
        "alpha/edgectl-survey.container",
        PLACEMENTS_FILE,
    ]
    commands = [
        shlex.split(line)
        for line in str(made.files[PLACEMENTS_FILE]).splitlines()
        if not line.startswith("#")
    ]
    assert ["bluechictl", "start", "zeta", "edgectl-slam.service"] in commands
    assert "After=edgectl-slam.service" in str(made.files["zeta/edgectl-nav-stack-2.container"])
    survey = str(made.files["alpha/edgectl-survey.container"])
    assert "Wants=bluechi-proxy@zeta_edgectl-slam.service" in survey
    assert "EnvironmentFile=/etc/edgectl/survey.env" in survey
    assert "hush-hush" not in str(made.files)
    done = subprocess.run(
        ["sh", "-n"], input=str(made.files[PLACEMENTS_FILE]), text=True, check=False, timeout=patience(20)
    )
    assert done.returncode == 0


def test_two_tasks_of_one_name_are_refused(tmp_path: Path) -> None:
    text = (
        "version: 1\ntasks:\n  a.b: {command: x, demand: {cpu: 0}}\n  a-b: {command: x, demand: {cpu: 0}}\n"
    )
    with pytest.raises(UsageError, match=r"a-b and a\.b are both a-b"):
        make_tasks(tmp_path, text)


@pytest.mark.parametrize(
    "build", [build_manifests, build_nomad_jobs, build_compose_files, build_bluechi_units]
)
def test_the_order_of_the_file_does_not_matter(placed: list[EngineTask], build: Any) -> None:
    made: EngineFiles = build(placed, "lab")
    again: EngineFiles = build(list(reversed(placed)), "lab")
    assert {name: text for name, text in made.files.items() if name != PLACEMENTS_FILE} == {
        name: text for name, text in again.files.items() if name != PLACEMENTS_FILE
    }
