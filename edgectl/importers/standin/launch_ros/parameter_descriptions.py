# SPDX-License-Identifier: Apache-2.0
"""Stand-in of launch_ros.parameter_descriptions."""

from typing import Any

from _edgectl_recorder import Context, Substitution, parse_scalar, perform, perform_value


class ParameterValue(Substitution):
    """A value with a type."""

    def perform(self, context: Context) -> str:
        """Its text."""
        return perform(context, self.words[0] if self.words else self.named["value"])

    def perform_typed(self, context: Context) -> Any:  # noqa: ANN401
        """The value, of the type that the file states."""
        kind: Any = self.named.get("value_type", self.words[1] if len(self.words) > 1 else None)
        if kind is str:
            return self.perform(context)
        value = self.words[0] if self.words else self.named["value"]
        if kind in (int, float):
            return kind(self.perform(context))
        return parse_scalar(self.perform(context)) if kind is bool else perform_value(context, value)


class ParameterFile(Substitution):
    """A file of parameters."""

    def perform(self, context: Context) -> str:
        """Its path."""
        if self.named.get("allow_substs"):
            context.note(
                self.place, "allow_substs of ParameterFile is not imported: the file is passed as it is"
            )
        return perform(context, self.words[0] if self.words else self.named["param_file"])
