# SPDX-License-Identifier: Apache-2.0
"""Policy and task filter from the options of plan and apply."""

import dataclasses
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from edgectl.cli import console
from edgectl.cli.extras import require_extra
from edgectl.cli.options import PlanFilterOptions, PolicyOptions, strip_task_kind
from edgectl.cli.selector import matches_selector
from edgectl.cli.user_files import refuse_exposed_files, select_exposed
from edgectl.config.weights import parse_weights
from edgectl.errors import UsageError
from edgectl.model.plan import Plan
from edgectl.model.policy import Policy, PolicyName, Weights
from edgectl.model.resource import RATING, TERMS
from edgectl.model.task import Tasks
from edgectl.names import check_known_names
from edgectl.units import QuantityError
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan import check_search, keep_whole_plan, limit_plan_to_tasks


def policy_from_options(fleet: Fleet, given: PolicyOptions, *, attended: bool = True) -> Policy:
    """The policy of the task files with the overrides of the command line.

    Raises:
        UsageError: invalid weights, or an unknown host.
    """
    check_known_names(given.without or (), fleet.inventory.hosts, "host")
    stated = _choose_policy(fleet.tasks.policy, given)
    return dataclasses.replace(
        stated,
        weights=_parse_weights_option(given.weights) if given.weights is not None else stated.weights,
        without=frozenset(given.without or ()),
        best_effort=given.best_effort,
        full=given.full,
        prune=given.prune,
        rebalance=given.rebalance,
        optimal=given.optimal,
        # Who passes a limit wants it kept, whether somebody reviews the plan or not.
        attended=attended and given.max_moves is None,
        max_moves=stated.max_moves if given.max_moves is None else given.max_moves,
    )


def _choose_policy(stated: Policy, given: PolicyOptions) -> Policy:
    """``stated`` with the policy of ``--policy``: one of edgectl, or the ratings of a plugin alone."""
    if given.policy is None:
        return stated
    if given.policy in {*PolicyName}:
        return dataclasses.replace(stated, name=PolicyName(given.policy))
    from edgectl.usecases.ratings import list_policy_plugins

    check_known_names([given.policy], [*PolicyName, *list_policy_plugins()], "policy", every=True)
    if given.weights is not None:
        raise UsageError(f"policy {given.policy} weighs its own ratings alone", hint="omit --weights")
    alone = Weights({**dict.fromkeys(TERMS, 0.0), RATING: 1.0})
    return dataclasses.replace(stated, name=PolicyName.UTILITY, weights=alone, terms=(given.policy,))


def require_solver(policy: Policy) -> None:
    """Check that a plan under ``policy`` can be made.

    Raises:
        UsageError: it needs a solver that is not installed, or that has nothing to solve.
    """
    check_search(policy)
    if not policy.optimal:
        return
    with require_extra("opt"):
        import edgectl.solver.highs  # noqa: F401


def _parse_weights_option(text: str) -> Weights:
    try:
        return parse_weights(text)
    except QuantityError as error:
        raise UsageError(f"--weights: {error.message}", hint=error.hint) from None


def load_saved_plan(path: Path | None, overrides: PolicyOptions, limits: PlanFilterOptions) -> Plan | None:
    """The saved plan if one is given; it is applied as it is.

    Raises:
        UsageError: an option that changes decisions is given as well.
        InputError: everything that is wrong with the file, or others may write it.
    """
    if path is None:
        return None
    from edgectl.config.documents import read_plan
    from edgectl.config.problems import Problems

    if any(dataclasses.astuple(overrides)) or any(dataclasses.astuple(limits)):
        raise UsageError(
            f"{path} is a saved plan: options that change decisions do not apply to it",
            hint="pass them to: edgectl plan --out PLAN",
        )
    problems = Problems()
    plan = read_plan(path, problems)
    refuse_exposed_files(select_exposed(problems.warnings))
    return plan


def build_plan_filter(
    tasks: Tasks, limits: PlanFilterOptions, *, quiet: bool = False
) -> Callable[[Plan], Plan]:
    """Filter that limits a plan to ``--target`` and ``-l``; decisions still cover all tasks. ``quiet``:
    without a warning about that.

    Raises:
        UsageError: an unknown task, or an invalid selector.
    """
    if not limits.target and limits.selector is None:
        return keep_whole_plan
    from edgectl.cli.task_names import check_task_names, expand_task_names, label_task

    targets = [strip_task_kind(name) for name in limits.target or ()]
    check_task_names(targets, tasks)
    wanted = set(expand_task_names(targets, tasks))
    if limits.selector is not None:
        matching = {
            task.name for task in tasks.tasks.values() if matches_selector(limits.selector, label_task(task))
        }
        if not matching:
            console.print_message(f"warning: no task matches -l {limits.selector}")
        wanted |= matching
    return partial(_filter_plan, wanted=frozenset(wanted), quiet=quiet)


def _filter_plan(plan: Plan, wanted: frozenset[str], *, quiet: bool) -> Plan:
    chosen = limit_plan_to_tasks(plan, wanted)
    left = sum(step.changes for step in plan.steps) - sum(step.changes for step in chosen.steps)
    if left and not quiet:
        console.print_message(
            "warning: 1 other change is left out, although this plan depends on it"
            if left == 1
            else f"warning: {left} other changes are left out, although this plan depends on them"
        )
    return chosen


def is_interactive() -> bool:
    """Whether a person can be asked."""
    from edgectl.views.text import is_ci

    return sys.stdin.isatty() and not is_ci()
