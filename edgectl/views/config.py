"""Settings in effect with their origin, and contexts."""

from collections.abc import Sequence

from edgectl.dataclass import dataclass
from edgectl.formats.document import Document
from edgectl.views.glossary import head
from edgectl.views.output import ListView
from edgectl.views.output_format import ITEM_FORMATS, NAMED_FORMATS
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, render_columns


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """One setting. ``origin``: an option, a variable, or FILE:LINE; empty where nothing sets it."""

    name: str
    values: tuple[str, ...]
    origin: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ContextRow:
    """One context with its files and the place where it is defined."""

    name: str
    chosen: bool
    inventories: tuple[str, ...]
    tasks: tuple[str, ...]
    origin: str


class SettingsView(ListView):
    """One row per setting."""

    kind = "setting"
    formats = ITEM_FORMATS

    def __init__(self, settings: Sequence[Setting], missing: Sequence[str], *, origin: bool) -> None:
        self._settings, self._missing, self._origin = settings, missing, origin

    def table(self, look: RenderOptions = PLAIN) -> str:
        """The values; with ``origin``, where each comes from."""
        columns = 3 if self._origin else 2
        rows: list[Row] = [head("setting", "values", "origin")[:columns]]
        for each in self._settings:
            row = (Cell(each.name, "name"), ", ".join(each.values) or "-", each.origin or "-")
            rows.append(row[:columns])
        return render_columns(rows, look, wrap={1})

    def items(self) -> Sequence[Document]:
        """The settings as JSON types, always with their origin."""
        return [
            {"setting": each.name, "values": list(each.values), "origin": each.origin or None}
            for each in self._settings
        ]

    def warnings(self) -> Sequence[str]:
        """Why no inventory is chosen."""
        return self._missing


class ContextsView(ListView):
    """One row per context."""

    kind = "context"
    formats = NAMED_FORMATS

    def __init__(self, contexts: Sequence[ContextRow]) -> None:
        self._contexts = contexts

    def table(self, look: RenderOptions = PLAIN) -> str:
        """The context in effect has a star."""
        if not self._contexts:
            return ""
        rows: list[Row] = [head("chosen", "context", "inventories", "task_files", "origin")]
        rows += [
            (
                Cell("*" if each.chosen else "", "good"),
                Cell(each.name, "name"),
                ", ".join(each.inventories),
                ", ".join(each.tasks) or "-",
                each.origin,
            )
            for each in self._contexts
        ]
        return render_columns(rows, look, wrap={2, 3})

    def items(self) -> Sequence[Document]:
        """The contexts as JSON types."""
        return [
            {
                "context": each.name,
                "chosen": each.chosen,
                "inventories": list(each.inventories),
                "task_files": list(each.tasks),
                "origin": each.origin,
            }
            for each in self._contexts
        ]

    def names(self) -> Sequence[str]:
        """The contexts, as context/NAME."""
        return [f"context/{each.name}" for each in self._contexts]

    def notes(self) -> Sequence[str]:
        """That there are none."""
        return [] if self._contexts else ["no context"]
