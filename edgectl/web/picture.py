# SPDX-License-Identifier: Apache-2.0
"""One probe of the fleet as the page shows it."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from edgectl.errors import EdgectlError
from edgectl.formats.document import Document
from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.plan import Plan
from edgectl.model.revision import Revision
from edgectl.model.snapshot import Snapshot
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.hook_run import mask_secrets
from edgectl.usecases.plan import find_fleet_shortages, make_plan
from edgectl.usecases.probe import probe_fleet
from edgectl.views.fleet_page import FleetPage, FleetPicture


def collect_picture(
    fleet: Fleet, options: ProbeOptions, past: Callable[[], tuple[Revision, ...]]
) -> FleetPicture:
    """Probe, and plan as an unattended apply would; ``past`` gives the revisions.

    Raises:
        EdgectlError: the fleet cannot be probed, or its files of state cannot be read.
    """
    snapshot = probe_fleet(fleet, options)
    plan, error = _try_plan(fleet, snapshot)
    return FleetPicture(
        snapshot=snapshot,
        inventory=fleet.inventory,
        tasks=fleet.tasks,
        plan=plan,
        plan_error=error,
        shortages=find_fleet_shortages(fleet, snapshot),
        revisions=past(),
    )


def _try_plan(fleet: Fleet, snapshot: Snapshot) -> tuple[Plan | None, str]:
    """The plan, or why there is none: what runs is shown all the same."""
    try:
        return make_plan(fleet, replace(fleet.tasks.policy, attended=False), snapshot=snapshot), ""
    except EdgectlError as error:
        return None, error.message


def build_page_document(picture: FleetPicture, secrets: Sequence[str]) -> Document:
    """The document of the page without the ``secrets`` of the files, wherever a host may have written one."""
    document = FleetPage(picture).build_document()
    return document if not secrets else {key: _mask(value, secrets) for key, value in document.items()}


def _mask(value: object, secrets: Sequence[str]) -> object:
    match value:
        case str():
            return mask_secrets(value, secrets)
        case dict():
            return {mask_secrets(key, secrets): _mask(each, secrets) for key, each in value.items()}
        case list():
            return [_mask(each, secrets) for each in value]
        case _:
            return value
