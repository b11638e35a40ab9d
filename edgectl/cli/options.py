# SPDX-License-Identifier: Apache-2.0
"""Options shared by commands, each defined once, and groups of options that commands take as one value."""

import dataclasses
import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, get_origin

from typer import Argument, Option

from edgectl.cli.completion import (
    complete_entries,
    complete_hosts,
    complete_labels,
    complete_policies,
    complete_tasks,
    complete_weights,
)
from edgectl.cli.project import PreferredOutput
from edgectl.dataclass import dataclass
from edgectl.views.output_format import (
    CYCLE_FORMATS,
    DIAGNOSIS_FORMATS,
    FLEET_FORMATS,
    GRAPH_FORMATS,
    ITEM_FORMATS,
    NAMED_FORMATS,
    PLAN_FORMATS,
    VALIDATION_FORMATS,
    WIDE_FORMATS,
    Formats,
    OutputFormat,
    check_output_format,
    is_supported,
)

InventoryOption = Annotated[
    list[Path] | None,
    Option(
        "--inventory",
        "-i",
        metavar="FILE",
        help="Default: edgectl.yaml, else inventories/; repeatable.",
    ),
]
TasksOption = Annotated[
    list[Path] | None,
    Option(
        "--tasks",
        "-t",
        metavar="PATH",
        help="Default: edgectl.yaml, else tasks/; repeatable.",
    ),
]


def build_output_option(forms: Formats) -> object:
    """``-o`` of a command whose view offers ``forms``. Any other is a UsageError that lists them."""

    def form(text: str) -> OutputFormat:
        if isinstance(text, PreferredOutput) and not is_supported(text, forms):
            return forms[0]
        return check_output_format(text, forms)

    def beginning(incomplete: str) -> list[str]:
        return [form.value for form in forms if form.startswith(incomplete)]

    return Option(
        "--output",
        "-o",
        metavar="FORM",
        envvar="EDGECTL_OUTPUT",
        show_envvar=False,
        show_default=False,
        parser=form,
        autocompletion=beginning,
        help=f"{'|'.join(forms)}.",
    )


def strip_host_kind(word: str) -> str:
    """The name of a host that may be given as ``-o name`` prints it: ``edge/NAME``, ``profiler/NAME``."""
    kind, slash, name = word.partition("/")
    return name if slash and kind in ("edge", "robot", "host", "profiler") else word


def strip_task_kind(word: str) -> str:
    """The name of a task that may be given as ``-o name`` prints it, ``task/NAME``."""
    return word.removeprefix("task/")


PlanOutput = Annotated[OutputFormat, build_output_option(PLAN_FORMATS)]
FleetOutput = Annotated[OutputFormat, build_output_option(FLEET_FORMATS)]
WideOutput = Annotated[OutputFormat, build_output_option(WIDE_FORMATS)]
NamedOutput = Annotated[OutputFormat, build_output_option(NAMED_FORMATS)]
GraphOutput = Annotated[OutputFormat, build_output_option(GRAPH_FORMATS)]
WatchOutput = Annotated[OutputFormat, build_output_option(CYCLE_FORMATS)]
DiagnosisOutput = Annotated[OutputFormat, build_output_option(DIAGNOSIS_FORMATS)]
ItemOutput = Annotated[OutputFormat, build_output_option(ITEM_FORMATS)]
ValidateOutput = Annotated[OutputFormat, build_output_option(VALIDATION_FORMATS)]

SnapshotOption = Annotated[
    Path | None, Option("--snapshot", metavar="FILE", help="Plan from this file (-: stdin); contact no host.")
]
WeightsOption = Annotated[
    str | None,
    Option(
        "--weights",
        "-W",
        metavar="WEIGHTS",
        autocompletion=complete_weights,
        help="cpu, memory, network, task, all, or cpu=.5,task=1.",
    ),
]
PolicyOption = Annotated[
    str | None,
    Option(
        "--policy",
        metavar="NAME",
        autocompletion=complete_policies,
        help="utility, static, local, pack, .., or a plugin.",
    ),
]
BestEffortOption = Annotated[bool, Option("--best-effort", help="Place a task even where it does not fit.")]
PruneOption = Annotated[bool, Option("--prune", help="Also stop the tasks of other task files.")]
RebalanceOption = Annotated[bool, Option("--rebalance", help="Swap and move tasks for a greater total.")]
OptimalOption = Annotated[bool, Option("--optimal", help="Find the best plan, and prove it (extra opt).")]
FullOption = Annotated[bool, Option("--full", help="Rank every host, however many there are.")]
MaxMovesOption = Annotated[
    int | None,
    Option("--max-moves", metavar="N", min=0, help="At most N voluntary moves."),
]
WithoutOption = Annotated[
    list[str] | None,
    Option(
        "--without",
        metavar="HOST",
        autocompletion=complete_hosts,
        parser=strip_host_kind,
        help="Plan as if this host were gone; repeatable.",
    ),
]
TargetOption = Annotated[
    list[str] | None,
    Option("--target", metavar="TASK", autocompletion=complete_entries, help="Only this task; repeatable."),
]
SortByOption = Annotated[
    str | None, Option("--sort-by", metavar="KEY", help="By a key of -o json, such as cpu.used_cores.")
]
FieldOption = Annotated[
    str | None, Option("--field", metavar="KEY", help="Print only this key of -o json, a line each.")
]
NoHeadersOption = Annotated[bool, Option("--no-headers", help="Omit the headings.")]
SelectorOption = Annotated[
    str | None,
    Option(
        "--selector",
        "-l",
        metavar="LABELS",
        autocompletion=complete_labels,
        help="With these labels: a=b, a!=b, a in (b,c), a, !a.",
    ),
]
DetailedExitcodeOption = Annotated[
    bool, Option("--detailed-exitcode", help="Exit 2: changes pending, 3: a task is unplaced.")
]
AllowUnreachableOption = Annotated[
    bool, Option("--allow-unreachable", help="Exit as if every host had answered.")
]
SavePlanOption = Annotated[
    Path | None, Option("--out", metavar="PLAN", help="Save the plan for: edgectl apply PLAN.")
]
YesOption = Annotated[bool, Option("--yes", "-y", help="Do not ask.")]
QuietOption = Annotated[bool, Option("--quiet", "-q", help="Print nothing if there is nothing to do.")]
LockTimeoutOption = Annotated[
    str | None,
    Option(
        "--lock-timeout",
        metavar="TIME",
        help="Wait for another edgectl; else for a watch only.",
        show_default=False,
    ),
]
MaxParallelOption = Annotated[
    int, Option("--max-parallel", metavar="N", min=1, help="At most N actions at once.")
]
FailFastOption = Annotated[bool, Option("--fail-fast", help="After a failure, start no new action.")]
WindowOption = Annotated[str, Option("--window", metavar="TIME", help="How long usage is measured.")]
WatchOption = Annotated[bool, Option("--watch", "-w", help="Keep watching until Ctrl-C.")]
EveryOption = Annotated[str, Option("--every", metavar="TIME", help="With -w: time between probes.")]
ReadonlyOption = Annotated[bool, Option("--readonly", help="With -I: keys change nothing.")]
InteractiveOption = Annotated[
    bool, Option("--interactive", "-I", help="Full-screen view with keys (needs the extra tui).")
]
TimeoutOption = Annotated[str, Option("--timeout", metavar="TIME", help="Deadline of each host.")]
AcceptNewOption = Annotated[
    bool, Option("--accept-new", help="Trust hosts with unknown keys, as OpenSSH does.")
]

HostsArgument = Annotated[
    list[str],
    Argument(
        metavar="HOST...",
        autocompletion=complete_hosts,
        parser=strip_host_kind,
        help="Names in the inventory.",
        show_default=False,
    ),
]
HostArgument = Annotated[
    str,
    Argument(
        metavar="HOST",
        autocompletion=complete_hosts,
        parser=strip_host_kind,
        help="Name in the inventory.",
        show_default=False,
    ),
]

TaskArgument = Annotated[
    str,
    Argument(
        metavar="TASK",
        autocompletion=complete_tasks,
        parser=strip_task_kind,
        help="Name of the task.",
        show_default=False,
    ),
]
TasksArgument = Annotated[
    list[str] | None,
    Argument(
        metavar="[TASK...]",
        autocompletion=complete_entries,
        parser=strip_task_kind,
        help="Names of tasks.",
        show_default=False,
    ),
]
Shell = Literal["bash", "zsh", "fish"]
DryRunOption = Annotated[bool, Option("--dry-run", help="Only print the exact remote commands.")]
DryRunMarkOption = Annotated[bool, Option("--dry-run", help="Only check and print; change nothing.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class PolicyOptions:
    """Overrides of the policy of the task files. ``full``, ``rebalance``, ``optimal`` and ``max_moves`` are
    options of ``PlanPolicyOptions`` only.
    """

    weights: WeightsOption = None
    policy: PolicyOption = None
    best_effort: BestEffortOption = False
    prune: PruneOption = False
    rebalance: bool = False
    optimal: bool = False
    full: bool = False
    max_moves: int | None = None
    without: WithoutOption = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanPolicyOptions(PolicyOptions):
    """Overrides of the policy for one plan."""

    rebalance: RebalanceOption = False
    optimal: OptimalOption = False
    full: FullOption = False
    max_moves: MaxMovesOption = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanFilterOptions:
    """Tasks to which a plan is limited; decisions still cover all tasks."""

    target: TargetOption = None
    selector: SelectorOption = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangeOptions:
    """How a plan is confirmed and carried out."""

    yes: YesOption = False
    quiet: QuietOption = False
    dry_run: DryRunOption = False
    max_parallel: MaxParallelOption = 16
    fail_fast: FailFastOption = False
    lock_timeout: LockTimeoutOption = None


def expand_option_groups(command: Callable[..., None]) -> Callable[..., None]:
    """``command`` with the options of each group (a parameter whose type is a dataclass) as its own."""
    signature = inspect.signature(command)
    groups: dict[str, type[Any]] = {
        name: parameter.annotation
        for name, parameter in signature.parameters.items()
        if isinstance(parameter.annotation, type) and dataclasses.is_dataclass(parameter.annotation)
    }

    @functools.wraps(command)
    def call(**given: Any) -> None:  # noqa: ANN401
        for name, group in groups.items():
            given[name] = group(**{each.name: given.pop(each.name) for each in _list_group_options(group)})
        command(**given)

    parameters = [
        each
        for name, parameter in signature.parameters.items()
        for each in (_list_group_options(groups[name]) if name in groups else [parameter])
    ]
    call.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return call


def _list_group_options(group: type[Any]) -> list[inspect.Parameter]:
    """The fields of a group that are options, as parameters."""
    return [
        inspect.Parameter(
            each.name, inspect.Parameter.KEYWORD_ONLY, default=each.default, annotation=each.type
        )
        for each in dataclasses.fields(group)
        if get_origin(each.type) is Annotated
    ]
