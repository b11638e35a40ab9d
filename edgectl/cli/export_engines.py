# SPDX-License-Identifier: Apache-2.0
"""export kubernetes, nomad, compose and bluechi commands."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Exit, Option

from edgectl.cli import console, exit_codes, options
from edgectl.cli.user_files import PUBLIC_FILE_MODE, load_inputs, make_directory, save_file
from edgectl.errors import UsageError

if TYPE_CHECKING:
    from edgectl.export.engine_task import EngineFiles, EngineTask

_ToOption = Annotated[
    Path | None, Option("--to", metavar="DIR", help="Write the files to this directory; default: stdout.")
]
_ImageOption = Annotated[
    str | None, Option("--image", metavar="NAME", help="Image of the tasks that name none.")
]


def export_kubernetes_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    snapshot: options.SnapshotOption = None,
    image: _ImageOption = None,
    to: _ToOption = None,
    allow_unreachable: options.AllowUnreachableOption = False,
) -> None:
    """Plan, and print Kubernetes manifests that run the tasks where the plan puts them.

    A service is a Deployment with a PodDisruptionBudget, a job a Job. Nodes are named as the hosts of the
    inventory. What is not carried over is named on stderr. Nothing is changed.

    Examples:
        edgectl export kubernetes --image ros:jazzy
        edgectl export kubernetes --image ros:jazzy --to manifests
    """
    from edgectl.export.kubernetes import build_manifests

    _export(build_manifests, inventory, tasks, snapshot, image, to, allow_unreachable=allow_unreachable)


def export_nomad_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    snapshot: options.SnapshotOption = None,
    image: _ImageOption = None,
    to: _ToOption = None,
    allow_unreachable: options.AllowUnreachableOption = False,
) -> None:
    """Plan, and print Nomad jobs (JSON) that run the tasks where the plan puts them.

    A task without an image runs by raw_exec on the node itself. Nodes are named as the hosts of the
    inventory. What is not carried over is named on stderr. Nothing is changed.

    Examples:
        edgectl export nomad
        edgectl export nomad --to jobs
    """
    from edgectl.export.nomad import build_nomad_jobs

    _export(build_nomad_jobs, inventory, tasks, snapshot, image, to, allow_unreachable=allow_unreachable)


def export_compose_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    snapshot: options.SnapshotOption = None,
    image: _ImageOption = None,
    to: _ToOption = None,
    allow_unreachable: options.AllowUnreachableOption = False,
) -> None:
    """Plan, and print a compose file for each host with the tasks that the plan puts there.

    What is not carried over is named on stderr. Nothing is changed.

    Examples:
        edgectl export compose --image ros:jazzy
        edgectl export compose --image ros:jazzy --to compose
    """
    from edgectl.export.compose import build_compose_files

    _export(build_compose_files, inventory, tasks, snapshot, image, to, allow_unreachable=allow_unreachable)


def export_bluechi_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    snapshot: options.SnapshotOption = None,
    image: _ImageOption = None,
    to: _ToOption = None,
    allow_unreachable: options.AllowUnreachableOption = False,
) -> None:
    """Plan, and print systemd units by node and the BlueChi commands that start them there.

    A task with an image is a Quadlet (.container), any other a .service. Nodes are named as the hosts of the
    inventory. What is not carried over is named on stderr. Nothing is changed.

    Examples:
        edgectl export bluechi
        edgectl export bluechi --to units
    """
    from edgectl.export.bluechi import build_bluechi_units

    _export(build_bluechi_units, inventory, tasks, snapshot, image, to, allow_unreachable=allow_unreachable)


def _export(
    build: "Callable[[Sequence[EngineTask], str], EngineFiles]",
    inventory: Sequence[Path] | None,
    tasks: Sequence[Path] | None,
    snapshot: Path | None,
    image: str | None,
    to: Path | None,
    *,
    allow_unreachable: bool,
) -> None:
    from edgectl.cli.connect import build_fleet, build_offline_fleet
    from edgectl.config.documents import load_snapshot
    from edgectl.usecases.engine_export import list_engine_tasks, list_left_out, plan_for_engine

    loaded = load_inputs(inventory, tasks)
    fleet = build_offline_fleet(loaded) if snapshot else build_fleet(loaded)
    seen = load_snapshot(snapshot) if snapshot else None
    plan = plan_for_engine(fleet, seen)
    placed = list_engine_tasks(fleet, plan, image)
    made = build(placed, fleet.inventory.fleet)
    for line in (*list_left_out(plan, fleet.tasks), *made.notes):
        console.print_message(f"note: {line}")
    _write_files({name: _render(name, content) for name, content in made.files.items()}, to)
    raise Exit(exit_codes.of_plan(plan, detailed=False, allow_unreachable=allow_unreachable))


def _render(name: str, content: object) -> str:
    """The text of a file: JSON or YAML by its name; a list is documents of YAML."""
    from edgectl.views.encoder import encode_json, encode_yaml, round_numbers

    if isinstance(content, str):
        return content
    documents: list[Any] = [
        round_numbers(each) for each in (content if isinstance(content, list) else [content])
    ]
    if name.endswith(".json"):
        return encode_json(documents[0])
    return "---\n".join(encode_yaml(each) for each in documents)


def _write_files(files: dict[str, str], to: Path | None) -> None:
    if to is None:
        console.print_text(_join_files(files))
        return
    taken = [to / name for name in files if (to / name).exists()]
    if taken:
        raise UsageError(f"{taken[0]} exists", hint="remove it, or name another directory")
    for name, text in files.items():
        make_directory((to / name).parent)
        save_file(to / name, text, mode=PUBLIC_FILE_MODE)
        console.print_message(f"wrote {to / name}")


def _join_files(files: dict[str, str]) -> str:
    """All files as one text: a stream of JSON values, documents of YAML, or texts under their names."""
    if all(name.endswith(".json") for name in files):
        return "".join(files.values())
    separator = "---\n" if all(name.endswith(".yaml") for name in files) else "\n"
    return separator.join(f"# {name}\n{text}" for name, text in files.items())
