"""Project file, contexts and the user's configuration: which files a command reads, and from where."""

import json
import os
from pathlib import Path

import pytest

from tests.cli.conftest import Run
from tests.forkserver import run_edgectl

HOSTS = "version: 1\nfleet: {fleet}\nedges:\n  {edge}: {{host: 127.0.0.1, connection: local}}\nrobots:\n  robot1: {{host: 127.0.0.1, probe: false}}\n"
TASKS = "version: 1\ntasks:\n  {task}: {{robot: robot1, command: sleep 9, demand: {{cpu: 0, memory: 0, throughput: 0}}}}\n"


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project ``lab`` with the folders ``deep/er``, a second fleet ``field``, and an empty configuration."""
    lab = tmp_path / "home" / "lab"
    for folder in ("inventories", "tasks", "deep/er"):
        (lab / folder).mkdir(parents=True)
    for fleet, edge, task in (("lab", "edge3", "zeta"), ("field", "edge2", "mapping")):
        (lab / "inventories" / f"{fleet}.yaml").write_text(HOSTS.format(fleet=fleet, edge=edge))
        (lab / "tasks" / f"{fleet}.yaml").write_text(TASKS.format(task=task))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    for name in ("EDGECTL_INVENTORY", "EDGECTL_TASKS", "EDGECTL_CONTEXT", "EDGECTL_INSECURE_FILES"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(lab / "deep" / "er")
    return tmp_path / "home"


def project(home: Path, text: str) -> None:
    (home / "lab" / "edgectl.yaml").write_text("version: 1\n" + text)


def user(home: Path, text: str) -> Path:
    path = home.parent / "config" / "edgectl" / "config.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("version: 1\n" + text)
    return path


CONTEXTS = """context: lab
contexts:
  lab: {inventory: inventories/lab.yaml, tasks: tasks/lab.yaml}
  field:
    inventory: [inventories/field.yaml]
    tasks: tasks/field.yaml
"""


def seen(run: Run, *words: str) -> tuple[list[str], list[str]]:
    """The edges and tasks that a command reads."""
    said = run("validate", "-o", "json", *words)
    assert said.code == 0, said.err
    item = json.loads(said.out)["item"]
    return item["edge_names"], item["task_names"]


def test_a_project_is_found_from_a_folder_below(run: Run, home: Path) -> None:
    project(home, "inventory: inventories/lab.yaml\ntasks: tasks/lab.yaml\n")
    assert seen(run) == (["edge3"], ["zeta"])


def test_without_a_project_the_hint_marks_the_folder_above(run: Run, home: Path) -> None:
    said = run("validate")
    assert said.code == 64
    assert said.err == (
        "error: no inventory given, and there is none in inventories/\n"
        f"hint: pass -i FILE, or mark {home}/lab as the project: echo 'version: 1' > ../../edgectl.yaml\n"
    )


def test_a_project_without_keys_has_the_usual_folders(run: Run, home: Path) -> None:
    project(home, "")
    said = run("validate")
    assert "../../inventories/ holds 2: field.yaml, lab.yaml" in said.err
    for name in ("inventories", "tasks"):
        (home / "lab" / name / "field.yaml").unlink()
    assert seen(run) == (["edge3"], ["zeta"])


def test_the_nearest_of_two_nested_projects_counts(run: Run, home: Path) -> None:
    project(home, CONTEXTS)
    (home / "lab" / "deep" / "edgectl.yaml").write_text(
        "version: 1\ninventory: ../inventories/field.yaml\ntasks: ../tasks/field.yaml\n"
    )
    assert seen(run) == (["edge2"], ["mapping"])


def test_options_go_before_the_environment_before_the_project_before_the_user(
    run: Run, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = home / "own.yaml"
    own.write_text(HOSTS.format(fleet="own", edge="edge1"))
    (home / "own-tasks.yaml").write_text(TASKS.format(task="alpha"))
    user(home, f"context: own\ncontexts:\n  own: {{inventory: {own}, tasks: {home}/own-tasks.yaml}}\n")
    assert seen(run) == (["edge1"], ["alpha"])
    project(home, CONTEXTS)
    assert seen(run) == (["edge3"], ["zeta"])
    monkeypatch.setenv("EDGECTL_CONTEXT", "field")
    assert seen(run) == (["edge2"], ["mapping"])
    assert seen(run, "--context", "own") == (["edge1"], ["alpha"])
    assert seen(run, "--context=lab") == (["edge3"], ["zeta"])
    monkeypatch.delenv("EDGECTL_CONTEXT")
    monkeypatch.setenv("EDGECTL_INVENTORY", "../../inventories/field.yaml")
    monkeypatch.setenv("EDGECTL_TASKS", "../../tasks/field.yaml")
    assert seen(run) == (["edge2"], ["mapping"])
    assert seen(run, "-i", str(own), "-t", f"{home}/own-tasks.yaml") == (["edge1"], ["alpha"])
    assert seen(run, "--context", "lab") == (["edge3"], ["zeta"])


def test_two_choices_of_one_strength_are_refused(
    run: Run, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    project(home, CONTEXTS)
    said = run("--context", "lab", "validate", "-i", "x.yaml")
    assert (said.code, said.err.splitlines()[0]) == (
        64,
        "error: -i and --context both choose the inventory",
    )
    monkeypatch.setenv("EDGECTL_CONTEXT", "lab")
    monkeypatch.setenv("EDGECTL_INVENTORY", "x.yaml")
    assert "both choose the inventory" in run("validate").err


def test_the_tasks_of_a_project_never_meet_the_hosts_of_the_user(run: Run, home: Path) -> None:
    own = home / "own.yaml"
    own.write_text(HOSTS.format(fleet="own", edge="edge1"))
    user(home, f"contexts:\n  own: {{inventory: {own}}}\n")
    project(home, "inventory: inventories/lab.yaml\ntasks: tasks/lab.yaml\n")
    said = run("--context", "own", "validate")
    assert said.code == 64
    assert said.err.startswith(f"error: no task file given, and there is none in {home.parent}/config/")


def test_a_context_whose_inventory_is_missing_names_the_line(run: Run, home: Path) -> None:
    project(home, CONTEXTS)
    (home / "lab" / "inventories" / "field.yaml").unlink()
    for words in (
        ("validate",),
        ("--context", "field", "plan"),
        ("-i", "../../inventories/lab.yaml", "-t", "../../tasks/lab.yaml"),
    ):
        said = run(*(("validate", *words) if words[0] == "-i" else words))
        assert said.code == 64
        assert said.err == (
            "error[EC001]: ../../edgectl.yaml:6:17: inventory of context field: no such file: "
            "../../inventories/field.yaml\n"
            "    6 |     inventory: [inventories/field.yaml]\n"
            "      |                 ^^^^^^^^^^^^^^^^^^^^^^\n"
            "hint: ../../inventories holds lab.yaml\n"
        )
    assert run("plan", "--context", "fild").err == (
        "error: unknown context 'fild'\nhint: did you mean field?\n"
    )


@pytest.mark.parametrize(
    ("text", "place", "hint"),
    [
        ("inventori: x.yaml\n", "2:1: unknown key inventori", "did you mean inventory?"),
        ("defaults: {outputt: json}\n", "2:12: unknown key outputt", "did you mean output?"),
        ("defaults: {output: jsn}\n", "2:20: unknown word 'jsn'", "did you mean json?"),
        ("defaults: {yes: true}\n", "2:12: unknown key yes", "known keys"),
        ("contexts: {lab: {tasks: t}}\n", "2:17: context lab needs inventory", "add inventory"),
        ("inventory: []\n", "2:12: must name a file", "write a path"),
        ("safe_directories: [/]\n", "2:1: unknown key safe_directories", "known keys"),
        ("contexts: {Lab: {inventory: i}}\n", "2:12: 'Lab' cannot be the name", "write lab"),
    ],
)
def test_a_project_file_with_a_mistake(run: Run, home: Path, text: str, place: str, hint: str) -> None:
    project(home, text)
    said = run("plan")
    assert said.code == 64
    assert f"../../edgectl.yaml:{place}" in said.err
    assert f"hint: {hint}" in said.err
    assert "^" in said.err
    assert run("version").code == 0


@pytest.mark.parametrize("place", ["folder", "file"])
def test_a_project_that_others_may_write_is_refused(run: Run, home: Path, place: str) -> None:
    project(home, CONTEXTS)
    exposed = home / "lab" / ("" if place == "folder" else "edgectl.yaml")
    exposed.chmod(0o777 if place == "folder" else 0o666)
    for words in (("validate",), ("plan",), ("config", "view")):
        said = run(*words)
        assert said.code == 64
        assert "../../edgectl.yaml: not trusted: " in said.err
        assert "every user may change it" in said.err
    assert run("--insecure-files", "validate").code == 0
    os.environ.pop("EDGECTL_INSECURE_FILES")
    user(home, f"safe_directories: [{home / 'lab'}]\n")
    assert seen(run) == (["edge3"], ["zeta"])


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give a file to another user")
def test_a_project_of_another_user_is_refused(run: Run, home: Path) -> None:
    project(home, CONTEXTS)
    os.chown(home / "lab" / "edgectl.yaml", 65534, 65534)
    assert "user 65534 owns it" in run("validate").err
    os.chown(home / "lab" / "edgectl.yaml", 0, 0)
    os.chown(home / "lab", 65534, 65534)
    assert "its folder: user 65534 owns it" in run("validate").err


def test_a_linked_project_file_is_relative_to_the_folder_of_the_link(run: Run, home: Path) -> None:
    elsewhere = home / "elsewhere.yaml"
    elsewhere.write_text("version: 1\n" + CONTEXTS)
    (home / "lab" / "edgectl.yaml").symlink_to(elsewhere)
    assert seen(run) == (["edge3"], ["zeta"])


def test_a_folder_reached_by_a_link_is_searched_where_it_is(
    run: Run, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    project(home, CONTEXTS)
    (home / "short").symlink_to(home / "lab" / "deep")
    monkeypatch.chdir(home / "short" / "er")
    assert seen(run) == (["edge3"], ["zeta"])


def test_cron_has_no_home(home: Path) -> None:
    project(home, CONTEXTS)
    (home / "lab" / "tasks" / "mine").mkdir()
    env = {"PATH": os.environ["PATH"], "EDGECTL_STATE_DIR": str(home / "state")}
    done = run_edgectl("validate", env=env, cwd=home / "lab" / "tasks" / "mine")
    assert (done.returncode, done.stdout) == (0, "ok: 1 edge, 1 robot, 1 task\n"), done.stderr


def test_defaults_of_options_give_way_to_options_and_environment(
    run: Run, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    project(home, CONTEXTS + "defaults: {output: json}\n")
    user(home, "defaults: {output: yaml, every: 7s}\n")
    assert json.loads(run("validate").out)["kind"] == "validation"
    assert run("validate", "-o", "table").out == "ok: 1 edge, 1 robot, 1 task\n"
    monkeypatch.setenv("EDGECTL_OUTPUT", "table")
    assert run("validate").out == "ok: 1 edge, 1 robot, 1 task\n"
    monkeypatch.delenv("EDGECTL_OUTPUT")
    project(home, CONTEXTS + "defaults: {output: name}\n")
    assert run("validate").out == "ok: 1 edge, 1 robot, 1 task\n"
    rows = {row["setting"]: row for row in json.loads(run("config", "view", "-o", "json").out)["items"]}
    assert (rows["defaults.every"]["values"], rows["defaults.every"]["origin"]) == (
        ["7s"],
        f"{home.parent}/config/edgectl/config.yaml:2",
    )


def test_view_names_the_origin_of_each_setting(run: Run, home: Path) -> None:
    project(home, CONTEXTS)
    assert run("config", "view", "--origin").out.splitlines() == [
        "SETTING    VALUE                       ORIGIN",
        "project    ../../edgectl.yaml          -",
        "user       -                           -",
        "context    lab                         ../../edgectl.yaml:2",
        "inventory  ../../inventories/lab.yaml  ../../edgectl.yaml:4",
        "tasks      ../../tasks/lab.yaml        ../../edgectl.yaml:4",
    ]
    said = run("config", "view", "--context", "field", "-t", "x.yaml", "-o", "json")
    rows = {row["setting"]: (row["values"], row["origin"]) for row in json.loads(said.out)["items"]}
    assert rows["context"] == (["field"], "--context")
    assert rows["tasks"] == (["x.yaml"], "-t")


def test_use_context_writes_the_file_that_decides(run: Run, home: Path) -> None:
    project(home, "# ours\n" + CONTEXTS.replace("context: lab", "context: lab  # the room"))
    said = run("config", "use-context", "context/field")
    assert (said.code, said.err) == (0, "context/field chosen in ../../edgectl.yaml\n")
    text = (home / "lab" / "edgectl.yaml").read_text()
    assert "# ours\ncontext: field  # the room\n" in text
    assert run("config", "current-context").out == "field\n"
    assert run("config", "get-contexts", "-o", "name").out == "context/lab\ncontext/field\n"
    listed = run("config", "get-contexts").out.splitlines()
    assert [line[:3] for line in listed] == ["NOW", "   ", "*  "]
    assert run("config", "use-context", "feild").err == (
        "error: unknown context 'feild'\nhint: did you mean field?\n"
    )


def test_use_context_of_the_user_without_a_project(run: Run, home: Path) -> None:
    path = user(
        home,
        f"contexts:\n  z: {{inventory: {home}/lab/inventories/lab.yaml, tasks: {home}/lab/tasks/lab.yaml}}\n",
    )
    assert run("config", "current-context").err.startswith("error: no context is chosen\n")
    assert run("config", "use-context", "z").code == 0
    assert path.read_text().startswith("version: 1\ncontext: z\ncontexts:\n")
    assert seen(run) == (["edge3"], ["zeta"])


def test_tab_offers_contexts_and_the_names_of_the_named_one(home: Path) -> None:
    project(home, CONTEXTS)
    for line, offered in (
        ("edgectl config use-context fi", ["field"]),
        ("edgectl --context ", ["field", "lab"]),
        ("edgectl --context field cordon e", ["edge2"]),
        ("edgectl cordon e", ["edge3"]),
    ):
        words = line.split(" ")
        env = {
            **os.environ,
            "_EDGECTL_COMPLETE": "complete_bash",
            "COMP_WORDS": line,
            "COMP_CWORD": str(len(words) - 1),
        }
        assert sorted(run_edgectl(env=env).stdout.split()) == offered, line


def test_several_inventories_by_option_and_context(run: Run, home: Path) -> None:
    more = home / "lab" / "inventories" / "more.yaml"
    more.write_text("version: 1\nedges:\n  edge7: {host: e7}\n")
    assert seen(run, "-i", "../../inventories/lab.yaml", "-i", str(more), "-t", "../../tasks/lab.yaml") == (
        ["edge3", "edge7"],
        ["zeta"],
    )
    project(home, "inventory: [inventories/more.yaml, inventories/lab.yaml]\ntasks: tasks/lab.yaml\n")
    assert seen(run) == (["edge3", "edge7"], ["zeta"])
    cron = run("export", "cron").out
    assert f"-i {home}/lab/inventories/more.yaml -i {home}/lab/inventories/lab.yaml" in cron
