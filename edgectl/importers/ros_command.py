# SPDX-License-Identifier: Apache-2.0
"""Command lines of ROS nodes: lists of words, quoted for the one shell that edgectl starts on a host."""

import json
import re
import shlex
from collections.abc import Iterable

from edgectl.importers.launch_values import PACKAGE_MARK, RosNode
from edgectl.importers.ros_parameters import flatten_parameters, is_plain_text

_WORD = re.compile(r"[A-Za-z_/][\w/.-]*")
_FINDERS = {
    (1, "share"): "rospack find {}",
    (1, "prefix"): "rospack find {}",
    (2, "share"): "ros2 pkg prefix --share {}",
    (2, "prefix"): "ros2 pkg prefix {}",
}


def build_command(node: RosNode) -> str:
    """The command of the task that runs ``node``, in the environment of its host."""
    words, before = _build_ros1_words(node) if node.version == 1 else _build_ros2_words(node)
    env = [f"{name}={value}" for name, value in node.env.items() if PACKAGE_MARK.search(value)]
    words = [*(["env", *env] if env else []), *words]
    line = join_words(words, node.version)
    steps = [join_words(step, node.version) for step in before]
    steps += [build_computed_step(f"{node.full_name}/{name}", each) for name, each in node.computed.items()]
    return " && ".join([*steps, f"exec {line}"]) if steps else line


def build_computed_step(name: str, words: Iterable[str]) -> str:
    """A step that sets the parameter ``name`` of ROS 1 to what a command prints on the host.

    ``rosparam set`` would read the text as YAML, so it is made JSON first, by the Python that edgectl needs.
    """
    namespace, _, last = name.rpartition("/")
    program = f"import json, sys; print(json.dumps({{{json.dumps(last)}: sys.stdin.read()}}))"
    return (
        f'text=$({join_words(words, 1)}) && printf %s "$text" | python3 -c {shlex.quote(program)}'
        f" | rosparam load - {namespace or '/'}"
    )


def list_plain_env(node: RosNode) -> dict[str, str]:
    """The environment of the node that can stand in the task file: no directory of a package is in it."""
    return {name: value for name, value in node.env.items() if not PACKAGE_MARK.search(value)}


def join_words(words: Iterable[str], version: int) -> str:
    """A command line whose words reach the program unchanged; the host finds the directories of packages."""
    return " ".join(_quote_word(word, version) for word in words)


def _quote_word(word: str, version: int) -> str:
    if not PACKAGE_MARK.search(word):
        return (
            shlex.quote(word)
            if not re.fullmatch(r"[\w@%+=:,./~-]*[\w@%+=:,./-]", word) or word.startswith("~")
            else word
        )
    text, place = "", 0
    for found in PACKAGE_MARK.finditer(word):
        text += _escape_in_quotes(word[place : found.start()])
        text += "$(" + _FINDERS[(version, found[1])].format(found[2]) + ")"
        place = found.end()
    return '"' + text + _escape_in_quotes(word[place:]) + '"'


def _escape_in_quotes(text: str) -> str:
    return re.sub(r'([\\"$`])', r"\\\1", text)


def _build_ros1_words(node: RosNode) -> tuple[list[str], list[list[str]]]:
    """The words of the node's own command, and the commands before it, which set what no argument can."""
    if not node.package:
        return [*shlex.split(node.prefix), node.executable, *node.arguments], []
    simple = {name: value for name, value in node.parameters.items() if _is_simple(value)}
    others = {name: value for name, value in node.parameters.items() if name not in simple}
    before = [["rosparam", "load", file, namespace] for file, namespace in node.parameter_files]
    if others:
        before.append(["rosparam", "set", node.full_name, format_json(others)])
    words = [
        "rosrun",
        *(["--prefix", node.prefix] if node.prefix else []),
        node.package,
        node.executable,
        *node.arguments,
        f"__name:={node.name}",
        *([f"__ns:={node.namespace}"] if node.namespace != "/" else []),
        *(f"{name}:={target}" for name, target in node.remaps),
        *(f"_{name}:={format_ros_value(value)}" for name, value in simple.items()),
    ]
    return words, before


def _is_simple(value: object) -> bool:
    """Whether a parameter on the command line gets its type from roscpp and from rospy alike."""
    if isinstance(value, str):
        text = PACKAGE_MARK.sub("/", value)
        return bool(_WORD.fullmatch(text)) and is_plain_text(text)
    return isinstance(value, bool | int | float)


def _build_ros2_words(node: RosNode) -> tuple[list[str], list[list[str]]]:
    if not node.package:
        return [*shlex.split(node.prefix), node.executable, *node.arguments], []
    parameters = flatten_parameters(node.parameters, separator=".")
    ros = [
        *node.ros_arguments,
        *(["-r", f"__node:={node.name}"] if node.name else []),
        *(["-r", f"__ns:={node.namespace}"] if node.namespace != "/" else []),
        *(word for name, target in node.remaps for word in ("-r", f"{name}:={target}")),
        *(word for file, _ in node.parameter_files for word in ("--params-file", file)),
        *(
            word
            for name, value in parameters.items()
            for word in ("-p", f"{name}:={format_ros_value(value)}")
        ),
    ]
    words = [
        "ros2",
        "run",
        *(["--prefix", node.prefix] if node.prefix else []),
        node.package,
        node.executable,
        *node.arguments,
        *(["--ros-args", *ros] if ros else []),
    ]
    return words, []


def format_ros_value(value: object) -> str:
    """A value as the text from which ROS reads it again."""
    if not isinstance(value, str):
        return format_json(value)
    text = PACKAGE_MARK.sub("/", value)
    plain = (
        re.fullmatch(r"[A-Za-z_/.][\w/.: -]*", text) and ": " not in text and not text.endswith((":", " "))
    )
    return value if plain and is_plain_text(text) else format_json(value)


def format_json(value: object) -> str:
    """JSON without blanks, which YAML reads too."""
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"))
