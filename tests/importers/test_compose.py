# SPDX-License-Identifier: Apache-2.0
"""Compose files as task files: every key becomes what it means, or is named."""

import json
from pathlib import Path

import pytest

from edgectl.config.load import load_inventory_and_tasks
from edgectl.errors import InputError, UsageError
from edgectl.export.compose import build_compose_files
from edgectl.export.engine_task import EngineTask
from edgectl.model.image import PullPolicy
from edgectl.model.task import NeedCondition, RestartPolicy, Task, TaskKind
from edgectl.usecases.import_files import import_compose
from edgectl.views.encoder import encode_yaml

COMPOSE = """
name: robot
x-common: &common
  restart: unless-stopped
  network_mode: host
  environment: {ROS_DOMAIN_ID: 7, DEBUG: false}
networks: {lab: {}}
services:
  zed_driver:
    <<: *common
    image: registry.lab/zed:${ZED_TAG:-5.0}
    privileged: true
    devices: ["/dev/video0:/dev/video0"]
    volumes: ["/srv/zed:/data:ro", "./here:/there", {type: bind, source: /srv/maps, target: /maps, read_only: true}]
    deploy:
      resources:
        reservations: {cpus: "1.5", memory: 512M, devices: [{driver: nvidia, count: 1, capabilities: [gpu]}]}
        limits: {cpus: "2", memory: 1g}
    healthcheck: {test: ["CMD-SHELL", "test -e /tmp/up"], interval: 5s}
    stop_signal: SIGINT
    stop_grace_period: 30s
    ports: ["80:80"]
  calibrate:
    image: calib
    entrypoint: ["/bin/calib"]
    command: ["--name", "it's a test", "$$HOME"]
    restart: "no"
    user: 1000
    pull_policy: always
  slam:
    image: slam:${MISSING}
    command: run $${PATH} --fast
    cap_add: [SYS_NICE]
    shm_size: 1g
    ipc: shareable
    depends_on:
      zed_driver: {condition: service_healthy}
      calibrate: {condition: service_completed_successfully}
  web:
    build: ./web
    depends_on: [slam]
    environment: ["MODE=lab", "FROM_HOST"]
"""


def import_text(folder: Path, text: str) -> tuple[dict[str, Task], list[str]]:
    """The tasks that edgectl reads in what it has written, and the notes."""
    (folder / "robot.yaml").write_text(text)
    made = import_compose(str(folder / "robot.yaml"))
    (folder / "inventory.yaml").write_text(made.inventory)
    (folder / "tasks.yaml").write_text(made.tasks)
    found = load_inventory_and_tasks(folder / "inventory.yaml", [folder / "tasks.yaml"])
    return dict(found[1].tasks), [f"{note.line}: {note.message}" for note in made.notes]


@pytest.fixture
def imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[dict[str, Task], list[str]]:
    for name in ("ZED_TAG", "MISSING"):
        monkeypatch.delenv(name, raising=False)
    return import_text(tmp_path, COMPOSE)


def test_services_become_tasks(imported: tuple[dict[str, Task], list[str]]) -> None:
    tasks, _ = imported
    assert set(tasks) == {"zed_driver", "calibrate", "slam", "web"}
    zed = tasks["zed_driver"]
    assert zed.image is not None
    assert (zed.image.name, zed.image.gpus, zed.image.args) == (
        "registry.lab/zed:5.0",
        "1",
        ("--privileged",),
    )
    assert zed.image.volumes == ("/srv/zed:/data:ro", "/srv/maps:/maps:ro")
    assert zed.restart is RestartPolicy.ALWAYS
    assert (zed.demand["cpu"].value, zed.demand["memory"].value) == (1.5, 512 * 2**20)  # type: ignore[union-attr]
    assert (zed.limits.cpu, zed.limits.memory) == (2.0, 2**30)
    assert (zed.stop.signal, zed.stop.grace) == ("INT", 30.0)
    assert zed.ready is not None
    assert zed.ready.command == """docker exec "$EDGECTL_CONTAINER" sh -c 'test -e /tmp/up'"""
    assert {"ROS_DOMAIN_ID": "7", "DEBUG": "false"}.items() <= zed.env.items()
    assert zed.command == ""


def test_needs_and_jobs(imported: tuple[dict[str, Task], list[str]]) -> None:
    tasks, _ = imported
    needs = {need.task: need.until for need in tasks["slam"].needs}
    assert needs == {"zed_driver": NeedCondition.READY, "calibrate": NeedCondition.COMPLETED}
    assert [need.until for need in tasks["web"].needs] == [NeedCondition.RUNNING]
    calibrate = tasks["calibrate"]
    assert (calibrate.kind, calibrate.restart) == (TaskKind.JOB, RestartPolicy.NEVER)
    assert calibrate.command == "/bin/calib --name 'it'\"'\"'s a test' '$HOME'"
    assert calibrate.image is not None
    assert (calibrate.image.user, calibrate.image.pull) == ("1000", PullPolicy.ALWAYS)
    slam = tasks["slam"]
    assert slam.command == "run ${PATH} --fast"
    assert slam.image is not None
    assert (slam.image.args, slam.image.ipc) == (("--cap-add=SYS_NICE", "--shm-size=1g"), "shareable")


def test_what_is_left_out_is_named_with_its_line(imported: tuple[dict[str, Task], list[str]]) -> None:
    _, notes = imported
    said = "\n".join(notes)
    for part in (
        "7: networks of the file is not imported",
        "zed_driver: ports is not imported",
        "zed_driver: the volume ./here:/there is not imported",
        "$MISSING has no value here",
        "web has no image: build it, and write its name",
        "web: FROM_HOST is not imported: it has no value in the file",
    ):
        assert part in said, said


def test_a_variable_of_the_environment_is_filled_in_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ZED_TAG", "6")
    tasks, notes = import_text(tmp_path, COMPOSE)
    image = tasks["zed_driver"].image
    assert image is not None
    assert image.name == "registry.lab/zed:6"
    assert any("$ZED_TAG is fixed as '6', its value here" in note for note in notes)


def test_what_compose_export_writes_is_imported_again(
    imported: tuple[dict[str, Task], list[str]], tmp_path: Path
) -> None:
    """The way back keeps command, image, needs on the same host, limits, stop and environment."""
    tasks, _ = imported
    found = load_inventory_and_tasks(tmp_path / "inventory.yaml", [tmp_path / "tasks.yaml"])
    host = found[0].hosts["edge1"]
    placed = [
        EngineTask(
            task=task, host=host, label=name.replace("_", "-"), env=task.env, demand={}, image=task.image
        )
        for name, task in tasks.items()
    ]
    (content,) = build_compose_files(placed, "lab").files.values()
    folder = tmp_path / "again"
    folder.mkdir()
    again, _ = import_text(folder, encode_yaml(content))  # type: ignore[arg-type]
    for name, task in tasks.items():
        back = again[name.replace("_", "-")]
        shell = f"/bin/sh -c {task.command and json.dumps(task.command)}"
        assert back.image is not None
        assert task.image is not None
        assert (back.image.name, back.image.volumes, back.limits) == (
            task.image.name,
            task.image.volumes,
            task.limits,
        )
        assert (back.stop.signal, back.env, bool(back.command)) == (
            task.stop.signal,
            task.env,
            shell != "/bin/sh -c ",
        )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("services: []\n", "the file has no services"),
        ("version: '3'\n", "the file has no services"),
        ("services: {a: text}\n", "service a must be a mapping"),
        ("services: {a: {image: x, depends_on: [b]}}\n", "b is no service of the file"),
        ("services: {a: {<<: *none}}\n", "unknown anchor"),
    ],
)
def test_a_wrong_file_is_told_where(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "robot.yaml").write_text(text)
    with pytest.raises(InputError) as raised:
        import_compose(str(tmp_path / "robot.yaml"))
    found = raised.value.problems[0]
    assert (message in found.message, found.line, bool(found.hint)) == (True, 1, True), found


def test_an_empty_file(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text("")
    with pytest.raises((InputError, UsageError), match="empty"):
        import_compose(str(tmp_path / "robot.yaml"))
