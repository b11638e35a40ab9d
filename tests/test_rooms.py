# SPDX-License-Identifier: Apache-2.0
"""The direction of imports between rooms, and inside the agent."""

import ast
import sys
from functools import cache
from pathlib import Path

import edgectl

ROOT = Path(edgectl.__file__).parent
PURE = {"model", "units", "errors", "names", "dataclass", "deferred_imports"}
# room -> edgectl rooms that it may import besides itself
ALLOWED = {
    "dataclass": set(),
    "deferred_imports": set(),
    "module_cache": set(),
    "errors": {"dataclass"},
    "units": {"dataclass"},
    "names": {"errors"},
    "model": PURE,
    "formats": PURE,
    "rules": PURE,
    "scheduler": PURE | {"rules"},
    "config": PURE | {"formats"},
    "transport": PURE | {"plugins"},
    "gateway": PURE | {"formats", "rules", "transport"},
    "state": PURE | {"formats"},
    "doctor": PURE,
    "importers": PURE | {"config"},
    "solver": PURE | {"scheduler"},
    "executor": PURE | {"rules", "transport", "state"},
    "export": PURE | {"state", "formats"},
    "experiments": PURE
    | {"cli", "config", "executor", "formats", "gateway", "rules", "scheduler", "state", "usecases", "views"},
    "usecases": PURE
    | {
        "config",
        "export",
        "formats",
        "rules",
        "scheduler",
        "solver",
        "executor",
        "doctor",
        "transport",
        "gateway",
        "importers",
        "plugins",
        "state",
    },
    "views": PURE | {"formats", "rules"},
    "tui": PURE | {"usecases", "views", "gateway"},
    "web": PURE | {"export", "formats", "usecases", "views", "gateway"},
    "cli": PURE
    | {
        "module_cache",
        "rules",
        "solver",
        "usecases",
        "views",
        "config",
        "transport",
        "gateway",
        "importers",
        "state",
        "formats",
        "scaffold",
        "export",
        "tui",
        "web",
    },
    "api": PURE | {"cli", "config", "gateway", "solver", "state", "transport", "usecases"},
    "plugins": PURE,
    "agent": set(),
    "scaffold": set(),
}
# The modules of the agent that both sides read, and the rooms that read them.
PROTOCOL = "edgectl.agent.link.protocol"
BOTH_SIDES = ("edgectl.agent.link", PROTOCOL, "edgectl.agent.link.sketch", "edgectl.agent.link.frames")
PROTOCOL_READERS = {
    "model",
    "config",
    "transport",
    "gateway",
    "executor",
    "usecases",
    "export",
    "experiments",
}
# The rules of byte counters, which the manager prints for an operator.
SHARED_RULES = "edgectl.agent.measure.counters_rules"
# third-party package -> the only modules that may import it
OWNERS: dict[str, str | tuple[str, ...]] = {
    "typer": ("cli", "experiments/commands"),
    "rich": ("views", "tui/"),
    "yaml": ("config", "views/encoder"),
    "fabric": "transport/ssh_client",
    "paramiko": "transport/ssh",
    "psutil": "agent",
    "platformdirs": "state",
    "simpy": "experiments/simulator",
    "ray": "experiments/sweep_ray",
    "distributed": "experiments/sweep_dask",
    "skimage": "experiments/ssim",
    "numpy": ("scheduler/array_", "solver/highs", "experiments/ssim"),
    "PIL": "experiments/ssim",
    "matplotlib": "experiments/report/",
    "jinja2": "experiments/report/page",
    "prometheus_client": "export/prometheus",
    "textual": "tui/",
    "highspy": "solver/highs",
}
PURE_ROOMS = (
    "model/",
    "rules/",
    "scheduler/",
    "experiments/model/",
    "experiments/views/",
    "experiments/files/run_codec.py",
    "experiments/files/map_file.py",
    "experiments/report/page.py",
    "experiments/report/figure_style.py",
    "experiments/report/gantt_chart.py",
    "experiments/report/distribution_plots.py",
    "experiments/report/time_series_plots.py",
    "experiments/report/trial_selection.py",
    "experiments/simulator.py",
    "experiments/simulator_events.py",
    "experiments/simulator_probe.py",
    "experiments/simulator_state.py",
    "experiments/student.py",
    "experiments/paired_tests.py",
    "experiments/scheme_comparison.py",
    "experiments/replay.py",
    "experiments/recorded_snapshots.py",
    "experiments/recovery.py",
    "experiments/event_results.py",
    "experiments/report/event_marks.py",
    "experiments/trial_recorder.py",
    "experiments/scheme_results.py",
    "experiments/reference_values.py",
    "experiments/ssim.py",
    "experiments/sequential_test.py",
    "experiments/files/sweep_worlds.py",
    "doctor/",
    "importers/ansible",
    "importers/elements",
    "importers/expression",
    "importers/fault",
    "importers/host_lists",
    "importers/launch",
    "importers/paper",
    "importers/python",
    "importers/ros",
    "importers/ssh",
    "importers/substitution",
    "importers/yaml",
    "formats/",
    "executor/action_phases.py",
    "executor/dependencies.py",
    "executor/diff.py",
    "executor/host_requests.py",
    "dataclass.py",
    "units.py",
    "errors.py",
    "names.py",
)
# Parts of the wing experiments/, each above those before it; "" holds the modules at its top.
WING_PARTS = ("model", "files", "", "views", "report", "commands")
# Part, or module at the top, of the wing -> the rooms outside of it that it may import besides PURE.
WING_DOORS = {
    "model": set(),
    "files": {"config", "formats", "state"},
    "simulator": {"scheduler"},
    "simulator_memory": {"scheduler"},
    "simulator_plans": {"scheduler", "executor", "rules"},
    "simulator_probe": {"rules"},
    "sweep_runs": {"scheduler"},
    "simulator_oracle": {"scheduler"},
    "replay": {"scheduler"},
    "recorded_snapshots": {"usecases"},
    "event_actions": {"gateway", "usecases"},
    "held_changes": {"formats", "state", "usecases"},
    "runner": {"executor", "gateway", "state", "usecases"},
    "trial": {"executor", "gateway", "usecases"},
    "trial_state": {"state", "usecases"},
    "views": {"formats", "views"},
    "report": set(),
    "commands": {"cli", "config", "formats", "usecases", "views"},
}
IMPURE = {
    "os",
    "time",
    "random",
    "logging",
    "subprocess",
    "pathlib",
    "socket",
    "threading",
    "secrets",
    "uuid",
}


@cache
def list_imports(path: Path) -> list[str]:
    names = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names.append(node.module)
            if node.module in ("edgectl", "edgectl.agent", "edgectl.agent.link"):
                names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


MODULES = sorted(path.relative_to(ROOT).as_posix() for path in ROOT.rglob("*.py"))


def test_rooms_import_only_their_neighbours() -> None:
    foreign = [
        f"{module} imports {name}"
        for module in MODULES
        for name in list_imports(ROOT / module)
        if not may_import(module, name)
    ]
    assert foreign == []


def may_import(module: str, name: str) -> bool:
    room = module.split("/")[0].removesuffix(".py")
    if room in ("__init__", "__main__") or not name.startswith("edgectl."):
        return True
    if room == "gateway" and name in ("edgectl.agent.measure", SHARED_RULES):
        return True
    if room in PROTOCOL_READERS and name in BOTH_SIDES:
        return True
    target = name.split(".")[1]
    if module == "executor/diff.py":
        return target in PURE | {"rules"}
    return target == room or target in ALLOWED[room] or target == "__version__"


def split_wing_module(name: str) -> tuple[str, str]:
    """Return part and door of a module of the wing, such as ("", "runner") or ("views", "views")."""
    words = name.split(".")[2:]
    part = words[0] if words and words[0] in WING_PARTS else ""
    return part, part or (words[0] if words else "")


def test_the_wing_imports_downward_and_through_its_doors() -> None:
    foreign = [
        f"{module} imports {name}"
        for module in MODULES
        if module.startswith("experiments/")
        for name in list_imports(ROOT / module)
        if not may_wing_import(module, name)
    ]
    assert foreign == []


def may_wing_import(module: str, name: str) -> bool:
    part, door = split_wing_module("edgectl." + module.removesuffix(".py").replace("/", "."))
    if name.split(".")[:2] == ["edgectl", "experiments"]:
        target, _ = split_wing_module(name)
        downward = WING_PARTS.index(target) <= WING_PARTS.index(part)
        return downward and {part, target} != {"views", "report"}
    if not name.startswith("edgectl.") or name in BOTH_SIDES:
        return True
    return name.split(".")[1] in PURE | WING_DOORS.get(door, set()) | {"__version__"}


def test_nothing_outside_of_the_wing_imports_it() -> None:
    outside = [m for m in MODULES if not m.startswith("experiments/")]
    assert [
        m for m in outside if any(name.startswith("edgectl.experiments") for name in list_imports(ROOT / m))
    ] == []
    # The tables of commands and of schemas name modules as text, and no other module does so.
    assert [m for m in outside if '"experiments.' in (ROOT / m).read_text()] == [
        "cli/app.py",
        "cli/schema.py",
    ]


def test_third_party_packages_have_one_owner() -> None:
    owned = [
        (module, name, OWNERS.get(name.split(".")[0]))
        for module in MODULES
        for name in list_imports(ROOT / module)
    ]
    foreign = [
        f"{module} imports {name} of {owner}"
        for module, name, owner in owned
        if owner and not module.startswith(owner)
    ]
    assert foreign == []


def agent_imports(module: str) -> set[str]:
    """Return the modules of the agent that ``module`` imports anywhere, by path, except for type checks."""
    tree = ast.parse((ROOT / module).read_text())
    for_types = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level and id(node) not in for_types:
            package = [*Path(module).parts[: -node.level], *(node.module or "").split(".")]
            base = "/".join(part for part in package if part)
            found |= {
                f"{base}/{alias.name}.py" if (ROOT / base / f"{alias.name}.py").exists() else f"{base}.py"
                for alias in node.names
            }
    return found


@cache
def list_agent_imports() -> dict[str, set[str]]:
    return {module: agent_imports(module) for module in MODULES if module.startswith("agent/")}


def test_the_agent_needs_the_standard_library_alone() -> None:
    for module in list_agent_imports():
        roots = {name.split(".")[0] for name in list_imports(ROOT / module)}
        assert roots <= {*sys.stdlib_module_names, "psutil", "_sha2", "_sha256"}, module


def test_the_protocol_imports_nothing() -> None:
    assert not any(
        isinstance(node, ast.Import | ast.ImportFrom)
        for node in ast.walk(ast.parse((ROOT / "agent/link/protocol.py").read_text()))
    )


def test_no_import_circle_in_the_agent() -> None:
    left = dict(list_agent_imports())
    while free := [module for module, needs in left.items() if not needs & left.keys()]:
        for module in free:
            del left[module]
    assert not left, f"in an import circle, or importing one: {sorted(left)}"


def test_pure_rooms_do_no_io() -> None:
    pure = [module for module in MODULES if module.startswith(PURE_ROOMS)]
    assert pure
    assert [
        f"{module} imports {name}"
        for module in pure
        for name in list_imports(ROOT / module)
        if name.split(".")[0] in IMPURE
    ] == []


def get_dotted_name(node: ast.expr) -> str:
    """Return a name such as ``os.system``; of other expressions, what follows their last part that is none."""
    if isinstance(node, ast.Attribute):
        return f"{get_dotted_name(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def test_no_dangerous_calls() -> None:
    """No eval, exec, pickle, yaml.load, shell=True or os.system, and no way to switch host key checks off.

    The agent runs code that it compiled before, where the seal of the manager is on it (ADR 57); the modules of
    commands are in a file beside those of Python (ADR 208); dataclasses are made of the names of their own fields
    (ADR 99).
    """
    loaders = {ROOT / "agent" / "link" / name for name in ("first.py", "stub.py", "boot.py", "cache.py")}
    loaders.add(ROOT / "module_cache.py")
    for path in ROOT.rglob("*.py"):
        text = path.read_text()
        assert "AutoAddPolicy" not in text, path
        assert "StrictHostKeyChecking=no" not in text, path
        tree = ast.parse(text)
        barred = {"pickle", "shelve"} if path in loaders else {"pickle", "shelve", "marshal"}
        assert not {n.split(".")[0] for n in list_imports(path)} & barred, path
        for node in ast.walk(tree):
            if isinstance(node, ast.Call):
                called = get_dotted_name(node.func)
                assert called not in {
                    "eval",
                    *(() if path in {*loaders, ROOT / "dataclass.py"} else ("exec",)),
                    "yaml.load",
                    "os.system",
                    "os.popen",
                    "tempfile.mktemp",
                }, f"{path}: {called}"
                assert not any(
                    k.arg == "shell" and getattr(k.value, "value", None) is True for k in node.keywords
                ), f"{path}: shell=True"
