"""How far an experiment is: what a person who waits for it is shown."""

from collections.abc import Callable
from dataclasses import dataclass

from edgectl.model.cycle import Cycle
from edgectl.model.experiment import Trial


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """Trial ``number`` of ``total`` is under way: ``elapsed`` s so far, ``completed`` of the tasks in ``until``.

    ``left``: s until all is done, None where nothing can be said yet. ``cycle``: what was just seen and done, None when the trial begins.
    ``trial``: what came of it, when it ends.
    """

    scheme: str
    repetition: int
    number: int
    total: int
    until: tuple[str, ...]
    elapsed: float = 0.0
    completed: tuple[str, ...] = ()
    left: float | None = None
    cycle: Cycle | None = None
    trial: Trial | None = None


Watcher = Callable[[Course], None]


def unwatched(_course: Course) -> None:
    """Show nothing."""
