# SPDX-License-Identifier: Apache-2.0
"""Kinds of documents with their versions: snapshot, plan, and the state of the manager."""

from collections.abc import Callable
from typing import Any, Generic, TypeVar

from edgectl.dataclass import dataclass
from edgectl.formats.codec import build_document_schema, decode, encode
from edgectl.formats.document import Document, Fault, Faults, FormatErrors
from edgectl.formats.scalar_codecs import Schema, describe_json_type
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Plan
from edgectl.model.snapshot import Snapshot

Model = TypeVar("Model")


@dataclass(frozen=True, slots=True, kw_only=True)
class DocumentKind(Generic[Model]):
    """One kind of document: a dataclass with a version.

    ``writer`` is the command that writes one, for hints; empty where none does so on purpose. ``derive``
    gives further entries, which are written and never read.
    """

    name: str
    version: int
    model: type[Model]
    writer: str = ""
    derive: Callable[[Model], Document] | None = None

    def encode(self, value: Model) -> Document:
        """The document of a value; it begins with its version."""
        derived = self.derive(value) if self.derive is not None else {}
        return {"format_version": self.version, **encode(value), **derived}

    def schema(self) -> Schema:
        """JSON Schema of the document."""
        return build_document_schema(self.name, self.version, self.model)

    def decode(self, raw: object) -> Model:
        """The value in a document.

        Raises:
            FormatErrors: everything that is wrong with it.
        """
        faults: Faults = []
        _check_version(self, raw, faults)
        value = decode(self.model, raw, faults) if not faults else None
        if faults or value is None:
            raise FormatErrors(self.name, faults)
        return value


def _check_version(kind: DocumentKind[Any], raw: object, faults: Faults) -> None:
    if not isinstance(raw, dict):
        faults.append(Fault(path=(), message=f"must be an object, not {describe_json_type(raw)}"))
        return
    version = raw.get("format_version")
    if version is None:
        faults.append(Fault(path=(), message="format_version is missing", hint="add format_version"))
    elif type(version) is not int or version < 1:
        message = f"must be a whole number from 1, not {version!r}"
        faults.append(Fault(path=("format_version",), message=message))
    elif version != kind.version:
        faults.append(
            Fault(
                path=("format_version",),
                message=f"{kind.name} of format_version {version}; this edgectl reads {kind.version}",
                hint=_suggest_version_change(kind, version),
            )
        )


def _suggest_version_change(kind: DocumentKind[Any], version: int) -> str:
    if version > kind.version:
        return "update edgectl, or write the file again with this one" + (
            f": {kind.writer}" if kind.writer else ""
        )
    return (
        f"write it again: {kind.writer}"
        if kind.writer
        else "use the edgectl that wrote it, or remove the file"
    )


def _summarize_plan(plan: Plan) -> Document:
    return {"summary": {action.value: count for action, count in plan.summary.items()}}


SNAPSHOT_KIND = DocumentKind(name="snapshot", version=2, model=Snapshot, writer="edgectl probe --out FILE")
PLAN_KIND = DocumentKind(
    name="plan", version=2, model=Plan, writer="edgectl plan --out FILE", derive=_summarize_plan
)
MANAGER_STATE_KIND = DocumentKind(name="manager state", version=1, model=ManagerState)
