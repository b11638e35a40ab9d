# SPDX-License-Identifier: Apache-2.0
"""Stand-in of nav2_common.launch."""

from _edgectl_recorder import Context, Recorded, Substitution, make_dropped, perform


class RewrittenYaml(Substitution):
    """A file of parameters with some of them replaced."""

    REPLACED = "param_rewrites"

    def perform(self, context: Context) -> str:
        """The file as it is; what would be replaced is noted."""
        names = [perform(context, name) for name in self.named.get(self.REPLACED) or {}]
        if names:
            hint = "write the values into the file, or add -p NAME:=VALUE to the command"
            message = f"{self.REPLACED} of {type(self).__name__} is not imported: {', '.join(names)}"
            context.note(self.place, message, hint)
        return perform(context, self.named.get("source_file", self.words[0] if self.words else ""))


class ReplaceString(RewrittenYaml):
    """A file with some texts replaced."""

    REPLACED = "replacements"


def __getattr__(name: str) -> type[Recorded]:
    return make_dropped(name)
