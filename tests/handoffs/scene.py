# SPDX-License-Identifier: Apache-2.0
"""A plain TCP task with a copy, and moves of it between two hosts."""

import shlex
from dataclasses import dataclass, replace
from pathlib import Path

from edgectl.model.check import Check
from edgectl.model.inventory import Capacity, Inventory
from edgectl.model.result import Outcome, Results
from edgectl.model.standby import Activation, StandbyRule
from edgectl.model.task import Task
from edgectl.usecases.apply import ApplyOptions, plan_and_apply
from tests.builders import a_task
from tests.e2e.bench import BY_CPU, GENTLE, QUICK, Bench
from tests.handoffs import node
from tests.handoffs.subscriber import Subscriber

TASK = "steer"


def a_node_task(folder: Path, address: str, port: int, **fields: object) -> Task:
    """The node, whose files are in ``folder`` by the name of the host."""
    here = f"{shlex.quote(str(folder))}/$EDGECTL_HOST"
    program = shlex.quote(str(Path(node.__file__)))
    task = a_task(
        TASK,
        cpu=0.5,
        command=f"exec python3 {program} {here} $EDGECTL_HOST {address} {port}",
        standby=StandbyRule(
            activation=Activation(
                activate=Check(command=say_word(here, "wake"), timeout=10.0),
                deactivate=Check(command=say_word(here, "sleep"), timeout=10.0),
                ready=Check(command=f"test -p {here}/out", timeout=20.0),
            )
        ),
        stop=GENTLE,
        up=0.1,
    )
    return replace(task, **fields)  # type: ignore[arg-type]


def say_word(folder: str, word: str) -> str:
    """A command that succeeds once the node has done what ``word`` says; only words of the shell."""
    return f'echo {word} > {folder}/in && read answer < {folder}/out && test "$answer" = {word}'


@dataclass
class Scene:
    """``bench``: a manager of the hosts ``names``. ``location``: the host on which the task is active.

    ``discovers``: its subscriber has to discover the copy before it hears it.
    """

    bench: Bench
    names: tuple[str, ...]
    task: Task
    subscriber: Subscriber
    location: str = ""
    discovers: bool = False

    def prefer(self, host: str) -> Inventory:
        """The inventory in which ``host`` is by far the best."""
        inventory = self.bench.fleet.inventory
        hosts = {
            name: replace(each, capacity=Capacity(cpu=16.0 if name == host else 1.0, memory=4e9))
            if name in self.names
            else each
            for name, each in inventory.hosts.items()
        }
        return replace(inventory, hosts=hosts)

    def apply(self, host: str, *, ok: bool = True) -> Results:
        """Apply where ``host`` is the best."""
        fleet = self.bench.using(self.task, inventory=self.prefer(host)).fleet
        applied = plan_and_apply(fleet, BY_CPU, options=ApplyOptions(probe=QUICK))
        assert applied.results is not None, applied.plan.steps
        assert applied.results.done or not ok, applied.results
        for action in applied.results.actions:
            self.location = action.located or self.location
        return applied.results

    def start(self) -> None:
        """Start the task on the first host and its copy on the other one."""
        results = self.apply(self.names[0])
        assert [copy.outcome for copy in results.standbys] == [Outcome.DONE]
        self.subscriber.wait_for_sender(self.names[0])
        if self.discovers:
            self.subscriber.wait_for_publishers(len(self.names))

    def other(self) -> str:
        return next(name for name in self.names if name != self.location)

    def move(self) -> Results:
        """Move to the other host; the copy is there already."""
        target = self.other()
        results = self.apply(target)
        assert self.location == target, results
        self.subscriber.wait_for_sender(target)
        return results
