# SPDX-License-Identifier: Apache-2.0
"""Stand-in of launch.conditions."""

from _edgectl_recorder import Context, Recorded, perform, perform_boolean


class IfCondition(Recorded):
    """A condition that must be true."""

    def evaluate(self, context: Context) -> bool:
        """Whether the action is wanted."""
        return perform_boolean(
            context, self.words[0] if self.words else self.named["predicate_expression"], self.place
        )


class UnlessCondition(IfCondition):
    """A condition that must be false."""

    def evaluate(self, context: Context) -> bool:
        """Whether the action is wanted."""
        return not super().evaluate(context)


class LaunchConfigurationEquals(Recorded):
    """An argument that must have a value."""

    def evaluate(self, context: Context) -> bool:
        """Whether the action is wanted."""
        name, expected = (*self.words, *self.named.values())[:2]
        return context.launch_configurations.get(perform(context, name)) == perform(context, expected)


class LaunchConfigurationNotEquals(LaunchConfigurationEquals):
    """An argument that must not have a value."""

    def evaluate(self, context: Context) -> bool:
        """Whether the action is wanted."""
        return not super().evaluate(context)
