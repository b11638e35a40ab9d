# SPDX-License-Identifier: Apache-2.0
"""Elements of a launch file with their positions: XML and the YAML form of it become one tree."""

import json
import re
from bisect import bisect_right
from dataclasses import dataclass, field
from xml.parsers import expat

from edgectl.config.node import Node, value_from_node
from edgectl.config.problems import Mark, ProblemCode, Problems, Source
from edgectl.importers.fault import ImportFaultError

MAX_DEPTH = 50
MAX_ELEMENTS = 50_000
_ATTRIBUTE = re.compile(r"""\s+([^\s=/>"']+)\s*=\s*("[^"]*"|'[^']*')""")
_XML_HINTS = {
    "mismatched tag": "close the elements in the reverse order of their opening",
    "not well-formed (invalid token)": "check the quotes and brackets here; write &amp; for & and &lt; for <",
    "no element found": "the file ends before its root element is closed",
    "unclosed token": "close this tag with >",
    "duplicate attribute": "remove one of the two",
    "junk after document element": "a file has one root element",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Attribute:
    """Value of one attribute as written, and its position. ``node``: the value in a YAML file."""

    text: str
    mark: Mark
    node: Node | None = None


@dataclass(slots=True, kw_only=True)
class Element:
    """One element. ``text``: what stands between its tags; ``text_line``: the line where that begins."""

    tag: str
    mark: Mark
    attributes: dict[str, Attribute] = field(default_factory=dict)
    children: "list[Element]" = field(default_factory=list)
    text: str = ""
    text_line: int = 0


def parse_xml(source: Source, problems: Problems) -> Element | None:
    """The root element of an XML file, or None with the cause collected. Entities cannot be declared."""
    builder = _TreeBuilder(source)
    try:
        builder.parser.Parse(builder.text.encode(), True)  # noqa: FBT003 - expat takes it by position
    except expat.ExpatError as error:
        message = expat.ErrorString(error.code)
        mark = builder.mark_place(error.lineno, error.offset + 1, 1)
        problems.add(mark, ProblemCode.SYNTAX, f"not XML: {message}", _XML_HINTS.get(message, ""))
        return None
    except ImportFaultError as fault:
        problems.add(fault.mark, fault.code, fault.message, fault.hint)
        return None
    return builder.root


class _TreeBuilder:
    """Builds the tree from the events of expat, which loads no external entity."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.text = source.text.replace("\r\n", "\n").replace("\r", "\n")
        self.starts = [0, *(found.end() for found in re.finditer("\n", self.text))]
        self.root: Element | None = None
        self.open: list[Element] = []
        self.count = 0
        self.parser = expat.ParserCreate("utf-8")
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self.begin
        self.parser.EndElementHandler = self.end
        self.parser.CharacterDataHandler = self.add_text
        self.parser.EntityDeclHandler = self.refuse_entity

    def mark_place(self, line: int, column: int, length: int) -> Mark:
        return Mark(self.source, line, column, length)

    def mark_span(self, start: int, end: int) -> Mark:
        line = bisect_right(self.starts, start)
        return Mark(self.source, line, start - self.starts[line - 1] + 1, max(1, end - start))

    def begin(self, tag: str, attributes: dict[str, str]) -> None:
        line, column = self.parser.CurrentLineNumber, self.parser.CurrentColumnNumber
        element = Element(tag=tag, mark=self.mark_place(line, column + 1, len(tag) + 1))
        self.count += 1
        if len(self.open) >= MAX_DEPTH or self.count > MAX_ELEMENTS:
            message = f"nested more than {MAX_DEPTH} deep, or more than {MAX_ELEMENTS:,} elements"
            raise ImportFaultError(element.mark, ProblemCode.BUDGET, message, "split the file")
        place = self.starts[line - 1] + column + 1 + len(tag)
        spans = {}
        while found := _ATTRIBUTE.match(self.text, place):
            spans[found[1]] = self.mark_span(found.start(2) + 1, found.end(2) - 1)
            place = found.end()
        for key, value in attributes.items():
            element.attributes[key] = Attribute(text=value, mark=spans.get(key, element.mark))
        element.text_line = bisect_right(self.starts, place)
        if self.open:
            self.open[-1].children.append(element)
        else:
            self.root = element
        self.open.append(element)

    def end(self, _tag: str) -> None:
        self.open.pop()

    def add_text(self, text: str) -> None:
        if self.open:
            self.open[-1].text += text

    def refuse_entity(self, name: str, *_rest: object) -> None:
        mark = self.mark_place(self.parser.CurrentLineNumber, self.parser.CurrentColumnNumber + 1, 8)
        message = f"the entity {name} is declared here; entities are not supported"
        raise ImportFaultError(mark, ProblemCode.SYNTAX, message, "write its text where it is used")


def build_yaml_elements(node: Node, problems: Problems) -> Element | None:
    """The tree of a launch file in YAML, ``launch: [{TAG: {ATTRIBUTE: VALUE, CHILD: [..]}}, ..]``."""
    if not isinstance(node.value, dict) or list(node.value) != ["launch"]:
        problems.add(node.mark, ProblemCode.MISSING, "must be a mapping with the one key launch",
            "begin with launch: and a list of actions below it")  # fmt: skip
        return None
    actions = node.value["launch"]
    if not isinstance(actions.value, list):
        problems.add(actions.mark, ProblemCode.TYPE, "launch must be a list of actions",
            "begin each action with a dash: - node: {pkg: .., exec: ..}")  # fmt: skip
        return None
    root = Element(tag="launch", mark=node.key_mark("launch"))
    for action in actions.value:
        _add_action(root, action, problems)
    return root


def _add_action(parent: Element, node: Node, problems: Problems) -> None:
    if not isinstance(node.value, dict) or len(node.value) != 1:
        message = "an action is a mapping with one key, its kind"
        problems.add(node.mark, ProblemCode.TYPE, message, "write it as - node: {pkg: .., exec: ..}")
        return
    tag, value = next(iter(node.value.items()))
    parent.children.append(_build_element(tag, node.key_mark(tag), value, problems))


def _build_element(tag: str, mark: Mark, node: Node, problems: Problems) -> Element:
    element = Element(tag=tag, mark=mark, text_line=mark.line)
    if isinstance(node.value, list):  # a group is the list of its actions
        for action in node.value:
            _add_action(element, action, problems)
        return element
    if not isinstance(node.value, dict):
        message = f"{tag} must be a mapping of its attributes"
        problems.add(node.mark, ProblemCode.TYPE, message, f"write {tag}: {{name: value}}")
        return element
    for key, value in node.value.items():
        if isinstance(value.value, list) and key == "children":
            for action in value.value:
                _add_action(element, action, problems)
        elif isinstance(value.value, list) and value.value and _are_mappings(value):
            element.children += [_build_element(key, inner.mark, inner, problems) for inner in value.value]
        else:
            element.attributes[key] = Attribute(text=_format_node(value), mark=value.mark, node=value)
    return element


def _are_mappings(node: Node) -> bool:
    return isinstance(node.value, list) and all(isinstance(inner.value, dict) for inner in node.value)


def _format_node(node: Node) -> str:
    """A scalar as written, and a list as JSON, which is YAML too."""
    if isinstance(node.value, dict | list):
        return json.dumps(value_from_node(node), ensure_ascii=False)
    return node.text
