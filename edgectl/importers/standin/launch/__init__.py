# SPDX-License-Identifier: Apache-2.0
"""Stand-in of the package launch."""

from collections.abc import Iterable
from typing import Any

from _edgectl_recorder import Context as LaunchContext
from _edgectl_recorder import Recorded, Substitution, make_dropped, visit


class LaunchDescription(Recorded):
    """A list of actions."""

    def __init__(self, initial_entities: Iterable[Any] | None = None, **named: Any) -> None:  # noqa: ANN401
        super().__init__(**named)
        self.entities = list(initial_entities or [])

    def add_action(self, action: Any) -> None:  # noqa: ANN401
        """Add one action."""
        self.entities.append(action)

    add_entity = add_action

    def execute(self, context: LaunchContext) -> list[int]:
        """Evaluate all actions."""
        return visit(context, self.entities)


LaunchDescriptionEntity = Action = Recorded
SomeSubstitutionsType = Any


def __getattr__(name: str) -> type[Recorded]:
    return make_dropped(name)


__all__ = ["LaunchContext", "LaunchDescription", "Substitution"]
