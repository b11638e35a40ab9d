"""Exported units: systemd accepts them, reads every word back unchanged, and a run in the sandbox reaches its
hosts over ssh.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.errors import UsageError
from edgectl.export.job import ScheduledJob
from edgectl.export.systemd import build_timer_units, build_unit_name, build_watch_unit
from tests.agent.user_systemd import UserSystemd, can_be_real, user_systemd
from tests.compiled_agent import give_agent_and_keys
from tests.e2e.bench import a_mark, list_sleepers, wait_for_sleepers
from tests.pace import patience
from tests.sshd import Lab

JOB = ScheduledJob(
    name="lab", program=("/bin/true",), inventories=("/srv/lab/lab.yaml",), tasks=("/srv/lab/tasks",), directory="/srv/lab", user="root"
)  # fmt: skip
AWKWARD = 'it\'s 100% $HOME ${PATH} "a b" %h;'


def verify_units(units: dict[str, str], folder: Path, *, user: bool) -> None:
    """Verify the units with systemd's own tool."""
    program = shutil.which("systemd-analyze")
    assert program, "systemd-analyze is missing; install it: sudo apt-get install systemd"
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in units.items():
        (folder / name).write_text(text)
    env = {**os.environ, "XDG_RUNTIME_DIR": str(folder)}
    command = [program, *(["--user"] if user else []), "verify", *(str(folder / name) for name in units)]
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False, timeout=patience(60))
    ours = [line for line in done.stderr.splitlines() if "edgectl" in line]
    assert (done.returncode, ours) == (0, []), done.stderr


@pytest.mark.parametrize("user", [False, True])
@pytest.mark.parametrize("local", [False, True])
def test_systemd_accepts_the_units(tmp_path: Path, user: bool, local: bool) -> None:
    odd = tmp_path / AWKWARD
    odd.mkdir()
    for number, path in enumerate(("/srv/lab", str(odd))):
        job = replace(
            JOB,
            inventories=(f"{path}/lab.yaml",),
            directory=path,
            environment={"EDGECTL_STATE_DIR": f"{path}/state"},
            local=local,
        )
        verify_units(build_timer_units(job, user=user), tmp_path / f"apply{number}", user=user)
        verify_units(
            build_watch_unit(replace(job, every_s=30.0), user=user), tmp_path / f"watch{number}", user=user
        )


def test_verification_finds_what_is_wrong(tmp_path: Path) -> None:
    units = {
        name: text.replace("KillMode=process", "KillMode=maybe")
        for name, text in build_timer_units(JOB, user=False).items()
    }
    with pytest.raises(AssertionError):
        verify_units(units, tmp_path / "units", user=False)


def parse_settings(text: str) -> dict[str, str]:
    return dict(line.split("=", 1) for line in text.splitlines() if re.match(r"[A-Z]\w*=", line))


def test_a_timer_and_its_service() -> None:
    units = build_timer_units(replace(JOB, every_s=90.0), user=False)
    assert list(units) == ["edgectl-lab.service", "edgectl-lab.timer"]
    service, timer = (parse_settings(text) for text in units.values())
    assert service["ExecStart"] == "/bin/true apply --yes --quiet -i /srv/lab/lab.yaml -t /srv/lab/tasks"
    assert (service["SuccessExitStatus"], service["User"], service["KillMode"]) == (
        "4 75 130",
        "root",
        "process",
    )
    assert timer["OnUnitActiveSec"] == "90s"
    assert (
        parse_settings(build_timer_units(JOB, user=False)["edgectl-lab.timer"])["OnUnitActiveSec"] == "300s"
    )
    assert (
        parse_settings(build_timer_units(replace(JOB, every_s=1234567.0), user=False)["edgectl-lab.timer"])[
            "OnUnitActiveSec"
        ]
        == "1234567s"
    )
    assert "User" not in parse_settings(build_timer_units(JOB, user=True)["edgectl-lab.service"])
    with pytest.raises(UsageError, match="too short"):
        build_timer_units(replace(JOB, every_s=0.5), user=False)
    with pytest.raises(UsageError, match="too short"):
        build_watch_unit(replace(JOB, every_s=0.5), user=False)


def test_a_watch_is_started_again_but_not_where_its_files_are_wrong() -> None:
    unit = parse_settings(
        build_watch_unit(replace(JOB, every_s=30.0), user=True)["edgectl-lab-watch.service"]
    )
    assert unit["ExecStart"].startswith("/bin/true watch --apply --every 30s -i ")
    assert (unit["Restart"], unit["RestartPreventExitStatus"], unit["WantedBy"]) == (
        "always",
        "64",
        "default.target",
    )
    assert (
        "--every"
        not in parse_settings(build_watch_unit(JOB, user=False)["edgectl-lab-watch.service"])["ExecStart"]
    )


def test_tasks_on_this_machine_do_not_inherit_a_sandbox() -> None:
    assert "NoNewPrivileges" in parse_settings(build_timer_units(JOB, user=False)["edgectl-lab.service"])
    assert "NoNewPrivileges" not in parse_settings(
        build_timer_units(replace(JOB, local=True), user=False)["edgectl-lab.service"]
    )


def test_names_of_units_are_names() -> None:
    assert build_unit_name(replace(JOB, name="our lab (new)")) == "edgectl-our_lab__new_"


@pytest.fixture(scope="module")
def manager(tmp_path_factory: pytest.TempPathFactory) -> Iterator[UserSystemd | None]:
    """A real systemd to run units in; None where the tests may not have one (the units are verified all the
    same).
    """
    if not can_be_real():
        yield None
        return
    with user_systemd(tmp_path_factory.mktemp("systemd") / "user", real=True) as found:
        yield found


def run_systemctl(manager: UserSystemd, *words: str) -> "subprocess.CompletedProcess[str]":
    inside = [
        "nsenter",
        f"--mount=/proc/{manager.pid}/ns/mnt",
        "env",
        f"XDG_RUNTIME_DIR=/run/user/{os.geteuid()}",
    ]
    return subprocess.run(
        [*inside, "systemctl", "--user", *words],
        capture_output=True,
        text=True,
        check=False,
        timeout=patience(90),
    )


def start_unit(manager: UserSystemd, units: dict[str, str], name: str) -> dict[str, str]:
    """Start a unit and wait for its end; return systemd's properties, and whether it counts as a success
    (``ok``).
    """
    folder = manager.folder / ".config" / "systemd" / "user"
    folder.mkdir(parents=True, exist_ok=True)
    for unit, text in units.items():
        # systemd --user has the uid of its caller; there is no journal to print into.
        kept = "".join(line for line in text.splitlines(keepends=True) if not line.startswith("User="))
        said = f"[Service]\nStandardOutput=append:{manager.folder}/said\nStandardError=inherit\n"
        (folder / unit).write_text(kept.replace("[Service]\n", said))
    run_systemctl(manager, "daemon-reload")
    done = run_systemctl(manager, "start", name)
    shown = dict(
        line.split("=", 1) for line in run_systemctl(manager, "show", name).stdout.splitlines() if "=" in line
    )
    output = manager.folder / "said"
    return {
        **shown,
        "ok": "yes" if done.returncode == 0 else done.stderr,
        "said": output.read_text() if output.exists() else "",
    }


def test_systemd_hands_over_every_word_as_it_was(manager: UserSystemd | None, tmp_path: Path) -> None:
    folder = tmp_path / AWKWARD
    folder.mkdir()
    script = folder / "note.py"
    script.write_text(
        "import json, os, sys\njson.dump([sys.argv[1:], os.getcwd(), os.environ['EDGECTL_STATE_DIR']], open(sys.argv[0] + '.json', 'w'))\nsys.exit(75)\n"
    )
    job = replace(
        JOB, program=(sys.executable, str(script)), inventories=(f"{folder}/lab.yaml",), tasks=("$A", "${B}", "%t"), directory=str(folder),
        environment={"EDGECTL_STATE_DIR": f"{folder}/$state"}, name="words", local=True,
    )  # fmt: skip
    units = build_timer_units(job, user=False)
    if manager is None:
        verify_units(units, tmp_path / "units", user=False)
        return
    shown = start_unit(manager, units, "edgectl-words.service")
    assert shown["ok"] == "yes", "a busy lock is no failure of the unit"
    said, directory, state = json.loads(Path(f"{script}.json").read_text())
    assert said == [
        "apply",
        "--yes",
        "--quiet",
        "-i",
        f"{folder}/lab.yaml",
        "-t",
        "$A",
        "-t",
        "${B}",
        "-t",
        "%t",
    ]
    assert (directory, state) == (str(folder), f"{folder}/$state")


def drop_impossible_sandbox(manager: UserSystemd, units: dict[str, str]) -> dict[str, str]:
    """Return the units; without their sandbox where this machine cannot create one, not even around /bin/true
    (some containers).
    """
    probe = build_timer_units(replace(JOB, name="nothing", directory="/"), user=False)
    if start_unit(manager, probe, "edgectl-nothing.service")["ok"] == "yes":
        return units
    return {
        name: re.sub(r"^(Protect|Restrict[AN]).*\n", "", text, flags=re.MULTILINE)
        for name, text in units.items()
    }


# Slices: they fit on a busy machine, too.
HOSTS = """version: 1
edges:
  edge1: {host: edge1, capacity: {cpu: 2, memory: 1Gi}}
  edge2: {host: edge2, connection: openssh, capacity: {cpu: 2, memory: 1Gi}}
"""


@pytest.mark.slow
def test_a_run_in_the_sandbox_reaches_its_hosts(
    manager: UserSystemd | None, lab: Lab, tmp_path: Path
) -> None:
    """The whole unit as exported by the command, for hosts by paramiko and by the ssh program; then a broken
    file fails the unit.
    """
    mark = a_mark()
    (tmp_path / "lab.yaml").write_text(HOSTS)
    tasks = [f'  {name}: {{command: "exec sleep {mark}", hosts: {{only: [{host}]}}, demand: {{cpu: 0.1, memory: 1Mi}}, stop: {{grace: 2s}}}}' for name, host in (("one", "edge1"), ("two", "edge2"))]  # fmt: skip
    (tmp_path / "tasks.yaml").write_text("\n".join(["version: 1", "tasks:", *tasks, ""]))
    give_agent_and_keys(tmp_path / "state", tmp_path / "lab.yaml")
    env = {**os.environ, **lab.environment, "EDGECTL_STATE_DIR": str(tmp_path / "state")}
    edgectl = [sys.executable, "-m", "edgectl"]
    files = ["-i", "lab.yaml", "-t", "tasks.yaml"]
    subprocess.run(
        [*edgectl, "export", "systemd", "--out", "units", *files],
        cwd=tmp_path,
        env=env,
        check=True,
        capture_output=True,
        timeout=patience(60),
    )
    units = {path.name: path.read_text() for path in sorted((tmp_path / "units").iterdir())}
    assert list(units) == ["edgectl-lab.service", "edgectl-lab.timer"]
    if manager is None:
        verify_units(units, tmp_path / "verified", user=False)
        return
    units = drop_impossible_sandbox(manager, units)
    try:
        shown = start_unit(manager, units, "edgectl-lab.service")
        assert shown["ok"] == "yes", shown
        assert shown["NoNewPrivileges"] == "yes"
        assert shown["ProtectSystem"] == (
            "full" if "ProtectSystem=full" in units["edgectl-lab.service"] else "no"
        )
        assert len(wait_for_sleepers(mark)) == 2, shown["said"]
    finally:
        subprocess.run(
            [*edgectl, "stop", "--all", "--yes", *files],
            cwd=tmp_path,
            env=env,
            check=False,
            capture_output=True,
            timeout=patience(60),
        )
    assert list_sleepers(mark) == []
    (tmp_path / "tasks.yaml").write_text("version: 2\n")
    shown = start_unit(manager, units, "edgectl-lab.service")
    assert (shown["ActiveState"], shown["ExecMainStatus"]) == ("failed", "64")
