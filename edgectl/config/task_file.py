# SPDX-License-Identifier: Apache-2.0
"""Task file: the keys of tasks and policy, and the templates that it holds."""

from collections.abc import Mapping

from edgectl.config.check_readers import check_reader, read_alive
from edgectl.config.demand_readers import read_demand
from edgectl.config.fields import (
    Fields,
    keep_node,
    list_reader,
    list_reader_with_nodes,
    merge_keys,
    read_argument_vector,
    read_environment,
    read_fields,
    read_labels,
    record_reader,
)
from edgectl.config.image_readers import read_image
from edgectl.config.job_readers import read_job, read_service_time
from edgectl.config.latency_readers import read_deadline, read_heard, read_latency
from edgectl.config.node import Node
from edgectl.config.problems import Mark, ProblemCode, Problems
from edgectl.config.quantities import parse_cost, parse_margin
from edgectl.config.scalars import (
    NAME_PATTERN,
    NodeReader,
    check_name,
    enum_reader,
    quantity_reader,
    read_bool,
    read_duration,
    read_name,
    read_text,
    read_version,
    report_wrong_type,
)
from edgectl.config.schema import (
    Schema,
    build_file_schema,
    build_mapping_schema,
    build_object_schema,
)
from edgectl.config.standby_readers import read_standby, read_state
from edgectl.config.task_readers import (
    DETECT_KEYS,
    HANDOFF_KEYS,
    LOG_KEYS,
    TASK_LIMITS_KEYS,
    read_command,
    read_for_each,
    read_host_rules,
    read_max_moves,
    read_need,
    read_on_unreachable,
    read_priority,
    read_robots,
    read_stop,
    read_weights,
)
from edgectl.dataclass import dataclass
from edgectl.model.check import CheckLocation, OnUnhealthy
from edgectl.model.policy import Policy, PolicyName, Preference, SequenceRule
from edgectl.model.task import (
    DetectRule,
    HandoffContract,
    LogLimits,
    NothingFits,
    OnboardRule,
    RestartPolicy,
    TaskKind,
    TaskLimits,
)
from edgectl.units import parse_duration

TASK_KEYS: Mapping[str, NodeReader] = {
    "command": read_command,
    "image": read_image,
    "for_each": read_for_each,
    "robot": read_name,
    "robots": read_robots,
    "needs": list_reader_with_nodes(read_need),
    "demand": read_demand,
    "priority": read_priority,
    "preempt": read_bool,
    "if_nothing_fits": enum_reader(NothingFits),
    "apart": list_reader_with_nodes(read_name),
    "together": list_reader_with_nodes(read_name),
    "spread": read_text,
    "group": read_name,
    "deadline": read_deadline,
    "latency": read_latency,
    "heard": read_heard,
    "service_time": read_service_time,
    "job": read_job,
    "hosts": read_host_rules,
    "onboard": enum_reader(OnboardRule),
    "kind": enum_reader(TaskKind),
    "managed": read_bool,
    "detect": record_reader(DETECT_KEYS, DetectRule, "detect"),
    "ready": check_reader(CheckLocation.HOST),
    "up": quantity_reader(parse_duration),
    "alive": read_alive,
    "on_unhealthy": enum_reader(OnUnhealthy),
    "done_when": check_reader(CheckLocation.HOST),
    "stop": read_stop,
    "restart": enum_reader(RestartPolicy),
    "handoff": record_reader(HANDOFF_KEYS, HandoffContract, "handoff"),
    "standby": read_standby,
    "state": read_state,
    "env": read_environment,
    "env_command": read_argument_vector,
    "workdir": read_text,
    "limits": record_reader(TASK_LIMITS_KEYS, TaskLimits, "limits"),
    "log": record_reader(LOG_KEYS, LogLimits, "log"),
    "on_unreachable": read_on_unreachable,
    "self_fence": read_duration,
    "downtime_cost": quantity_reader(parse_cost),
    "labels": read_labels,
}
POLICY_KEYS: Mapping[str, NodeReader] = {
    "policy": enum_reader(PolicyName),
    "weights": read_weights,
    "sequence": enum_reader(SequenceRule),
    "move_margin": quantity_reader(parse_margin),
    "min_dwell": quantity_reader(parse_duration),
    "max_moves": read_max_moves,
    "prefer": enum_reader(Preference),
    "terms": list_reader(read_name),
}
# Keys of a task that exclude each other.
EXCLUSIVE_KEYS = (("for_each", "robot"), ("for_each", "robots"), ("robot", "robots"))
TASK_FILE_KEYS: Mapping[str, NodeReader] = {"version": read_version, **POLICY_KEYS, "tasks": keep_node}


MAX_TASKS = 10_000


def build_tasks_schema() -> Schema:
    """JSON Schema of a task file."""
    exclusive = [{"not": {"required": [one, other]}} for one, other in EXCLUSIVE_KEYS]
    unmanaged = {
        "if": {"properties": {"managed": {"const": False}}, "required": ["managed"]},
        "then": {"required": ["detect"], "properties": {"command": False, "image": False}},
        "else": {
            "anyOf": [{"required": ["command"]}, {"required": ["image"]}],
            "properties": {"detect": False},
        },
    }
    task = build_object_schema(TASK_KEYS) | {"allOf": [*exclusive, unmanaged]}
    tasks = build_mapping_schema(NAME_PATTERN.pattern, task)
    schema = build_object_schema(TASK_FILE_KEYS, ("version", "tasks"), tasks=tasks)
    return build_file_schema("task file", schema)


@dataclass(frozen=True, slots=True)
class TaskTemplate:
    """One entry of ``tasks:`` as written, before ``for_each`` is expanded; ``file``: the id of its file."""

    name: str
    fields: Fields
    named_at: Mark
    file: str = ""


@dataclass(frozen=True, slots=True)
class TaskDraft:
    """One task to be: its template, its own name and its robots.

    ``each`` is the robot that ``for_each`` made it for.
    """

    template: TaskTemplate
    name: str
    robots: tuple[str, ...]
    each: str | None = None


def read_templates(
    node: Node, problems: Problems, templates: dict[str, TaskTemplate], file: str = ""
) -> Fields:
    """Add the templates of the file with id ``file`` to ``templates``, with everything wrong noted; gives the
    file's other keys.
    """
    top = read_fields(node, problems, TASK_FILE_KEYS, required=("version", "tasks"), what="a task file")
    entries = top.at("tasks")
    if "tasks" in top and not isinstance(entries.value, dict):
        report_wrong_type(
            entries,
            problems,
            "tasks must be a mapping of names",
            "write a name, a colon and the task's keys below it",
        )
    for key, inner in entries.value.items() if "tasks" in top and isinstance(entries.value, dict) else ():
        check_name(key, entries, problems, "a task")
        if key in templates:
            first = templates[key].named_at
            message = f"task {key} is already defined in {first.source.file}, line {first.line}"
            problems.add(entries.key_mark(key), ProblemCode.TAKEN, message, "rename or remove one of the two")
            continue
        fields = read_fields(inner, problems, TASK_KEYS, what=f"task {key}")
        templates[key] = TaskTemplate(key, fields, entries.key_mark(key), file)
    return top


def merge_policy(files: list[Fields], problems: Problems) -> Policy:
    """The policy that the files state together; stating a key twice differently is a mistake."""
    stated = merge_keys(files, POLICY_KEYS, problems)
    return Policy(**({"name": stated.pop("policy")} if "policy" in stated else {}), **stated)
