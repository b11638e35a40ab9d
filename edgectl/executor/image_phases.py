# SPDX-License-Identifier: Apache-2.0
"""The image of a task: fetched on its new host before anything is stopped for its sake."""

import time

from edgectl.agent.link import protocol
from edgectl.errors import HostError
from edgectl.executor.action_phases import PlannedPhase, PlannedPhases, PlannedRequest, get_host
from edgectl.executor.host_requests import build_pull_request
from edgectl.executor.step_run import StepRun
from edgectl.model.inventory import Inventory
from edgectl.model.result import Phase
from edgectl.model.task import Task

# One request lasts at most so long, so that a lost connection is not mistaken for a slow registry.
_PIECE_S = 15.0
# An image of some GB over a slow link.
_PULL_S = 1800.0


def build_pull_phases(task: Task, host_name: str, inventory: Inventory) -> PlannedPhases:
    """Have the image on the host; nothing for a task without one.

    Raises:
        HostError: the host left the inventory.
    """
    if task.image is None:
        return ()
    host = get_host(inventory, host_name)
    body = build_pull_request(task, task.image, host, timeout_s=_PIECE_S)
    request = PlannedRequest(host=host, body=body, timeout_s=_PIECE_S)
    return (PlannedPhase(phase=Phase.PULL, task=task.name, requests=(request,), timeout_s=_PULL_S),)


def pull_image(act: StepRun, planned: PlannedPhase) -> None:
    """Ask the host until it has the image.

    Raises:
        HostError: it cannot be had, or not in time.
    """
    request, host = planned.requests[0], planned.host
    deadline = time.monotonic() + planned.timeout_s
    body = {**request.body, "instance": act.instance(host.name)}
    with act.phase(Phase.PULL, host.name, side_effect=False) as remarks:
        while True:
            answer = act.run.ask(host, body, timeout=request.timeout_s + act.run.options.call_s)
            if answer.get("state") != protocol.PULLING:
                break
            if time.monotonic() >= deadline:
                message = f"the image was not pulled on {host.name} within {planned.timeout_s:.3g} s"
                raise HostError(message, hint="the pull continues there: run apply again", host=host.name)
        if answer.get("state") == protocol.PULLED:
            remarks.append("pulled")
