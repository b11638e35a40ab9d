"""Documents of experiment runs and their trials (docs/reference/files.md), and the digest of a trial's
conditions.
"""

from dataclasses import replace

from edgectl.experiments.model.experiment import Experiment, ExperimentRun, Trial
from edgectl.formats.digest import hash_value
from edgectl.formats.kinds import DocumentKind
from edgectl.model.inventory import Inventory
from edgectl.model.task import Tasks

_WRITER = "edgectl experiment run --out DIR"
RUN_KIND = DocumentKind(name="run", version=1, model=ExperimentRun, writer=_WRITER)
TRIAL_KIND = DocumentKind(name="trial", version=1, model=Trial, writer=_WRITER)


def digest_experiment(experiment: Experiment, inventory: Inventory, tasks: Tasks) -> str:
    """SHA-256 of everything that affects a trial: fleet, tasks and the conditions of a trial.

    Name, schemes, repetitions, metrics and equivalence are left out: a run can be resumed after they change.
    """
    conditions = replace(experiment, name="", schemes=(), repetitions=1, metrics={}, equivalence=None)
    return "sha256:" + hash_value(
        {"experiment": conditions, "inventory": inventory.digest, "tasks": tasks.digest}
    )
