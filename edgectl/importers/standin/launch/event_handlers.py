# SPDX-License-Identifier: Apache-2.0
"""Stand-in of launch.event_handlers."""

from typing import Any

from _edgectl_recorder import Context, Recorded, make_dropped


class _OnEvent(Recorded):
    """Actions after an event of another action. ``STATE``: what the target's task must have reached."""

    STATE, KEY = "running", "on_start"

    def register(self, context: Context) -> None:
        """Evaluate the actions later, once the target is known."""
        target = self.named.get("target_action", self.words[0] if self.words else None)
        actions: Any = self.named.get(self.KEY, self.words[1] if len(self.words) > 1 else [])
        if target is None:
            context.note(self.place, f"{type(self).__name__} without a target_action is not imported")
        elif callable(actions):
            context.note(self.place, f"{type(self).__name__} with a function is not imported")
        else:
            context.handlers.append((target, self.STATE, actions, self.place))


class OnProcessStart(_OnEvent):
    """Actions after the start of a process."""


class OnProcessExit(_OnEvent):
    """Actions after the end of a process."""

    STATE, KEY = "completed", "on_exit"


class OnExecutionComplete(_OnEvent):
    """Actions after the end of an action."""

    STATE, KEY = "completed", "on_completion"


class OnProcessIO(Recorded):
    """Actions on output, which have no counterpart."""

    def register(self, context: Context) -> None:
        """Note it as dropped."""
        context.note(self.place, f"{type(self).__name__} is not imported", "write ready: in the task")


class OnShutdown(OnProcessIO):
    """Actions at the end."""


def __getattr__(name: str) -> type[Recorded]:
    return make_dropped(name)
