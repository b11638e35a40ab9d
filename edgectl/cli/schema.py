"""schema: JSON Schemas of files and documents, and the files that ``edgectl init`` writes for editors."""

import json
from collections.abc import Mapping
from importlib import import_module
from operator import attrgetter
from typing import Annotated, Any

from typer import Argument

from edgectl.cli import console
from edgectl.errors import UsageError
from edgectl.names import check_known_names
from edgectl.views.document_schema import DOCUMENT_KINDS, build_view_schema

# Kind -> module below edgectl, and the function in it that builds the schema.
SCHEMAS = {
    "inventory": ("config.inventory_file", "build_inventory_schema"),
    "tasks": ("config.task_file", "build_tasks_schema"),
    "project": ("config.project_file", "build_project_schema"),
    "user-config": ("config.project_file", "build_user_schema"),
    "experiment": ("experiments.files.experiment_file", "build_experiment_schema"),
    "scenario": ("experiments.files.scenario_file", "build_scenario_schema"),
    "snapshot": ("formats.kinds", "SNAPSHOT_KIND.schema"),
    "plan": ("formats.kinds", "PLAN_KIND.schema"),
    "manager-state": ("formats.kinds", "MANAGER_STATE_KIND.schema"),
    "run": ("experiments.files.run_codec", "RUN_KIND.schema"),
    "trial": ("experiments.files.run_codec", "TRIAL_KIND.schema"),
}
# Kind -> kind of the document that -o json prints. The experiment is a file too, and that has the name.
DOCUMENTS = {"experiment-results" if kind == "experiment" else kind: kind for kind in DOCUMENT_KINDS}
# Schemas of the files that a user edits.
EDITED_KINDS = ("inventory", "tasks", "project", "experiment", "scenario")


def list_kinds() -> tuple[str, ...]:
    """The kinds that have a schema: files first, then documents."""
    return (*SCHEMAS, *DOCUMENTS)


def _complete_kinds(incomplete: str) -> list[str]:
    return [kind for kind in list_kinds() if kind.startswith(incomplete)]


def schema_command(
    kind: Annotated[
        str | None,
        Argument(
            metavar="KIND",
            autocompletion=_complete_kinds,
            help="inventory, tasks, snapshot, plan, or the kind of a document: event, task-status ..",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Print the JSON Schema (draft 2020-12) of a file or document.

    Editors use it to complete and check YAML files.

    Examples:
        edgectl schema inventory
        edgectl schema plan
        edgectl schema task-status
    """
    if kind is None:
        raise UsageError("Missing argument 'KIND'", hint="known: " + ", ".join(list_kinds()))
    check_known_names([kind], list_kinds(), "kind")
    console.print_text(render_schema(kind))


def build_schema(kind: str) -> dict[str, Any]:
    """The schema of one of ``list_kinds``."""
    if kind in DOCUMENTS:
        return build_view_schema(DOCUMENTS[kind])
    module, name = SCHEMAS[kind]
    schema: dict[str, Any] = attrgetter(name)(import_module(f"edgectl.{module}"))()
    return schema


def render_schema(kind: str) -> str:
    """The text of a schema."""
    return json.dumps(build_schema(kind), indent=2, ensure_ascii=False) + "\n"


def render_editor_schemas() -> Mapping[str, str]:
    """The schemas of the files that a user edits, by kind."""
    return {kind: render_schema(kind) for kind in EDITED_KINDS}
