# SPDX-License-Identifier: Apache-2.0
"""Random launch files of ROS 1, most of them valid, to compare readers with each other."""

import random
from pathlib import Path

VALUES = ["1", "-2.5", "true", "False", "word", "two words", "/lab/x", "007", "1e3", "", "$(arg a)", "$(arg b)/$(arg a)", "$(optenv LAB_NOT dflt x)",
          "$(eval arg('a') + 'x' if arg('flag') else b)", "$(eval 3 * 2 - 1)", "$(eval 7 / 2)", "$(eval 'x' in a)", "$(find lab_bringup)/f", "$(dirname)/g"]  # fmt: skip
CONDITIONS = [
    "",
    "",
    "",
    ' if="$(arg flag)"',
    ' unless="$(arg flag)"',
    ' if="1"',
    ' unless="true"',
    ' if="$(eval len(a) > 1)"',
    ' if="0"',
]
NAMESPACES = ["", ' ns="x"', ' ns="y/z"', ' ns="/top"', ' ns="$(arg b)"']
YAMLS = [
    "{p: 1, q: {r: [1, two, 3.5]}}",
    "a: yes\nb: 'no'\nc: 010\nd: ~\n",
    "x: deg(90)\ny: rad(pi/2)\nz: 1e3\n",
    "k: '7'\nl: 0x10\nm: -.5\n",
]


class LaunchWriter:
    """Writes one file from a seeded generator; names are unique, so that most files are valid."""

    def __init__(self, seed: int, included: str) -> None:
        self.random = random.Random(seed)
        self.included = included
        self.count = 0

    def pick(self, values: list[str]) -> str:
        return self.random.choice(values)

    def name(self, stem: str) -> str:
        self.count += 1
        return f"{stem}{self.count}"

    def value(self) -> str:
        return self.pick(VALUES)

    def node_child(self) -> str:
        kind = self.random.randrange(4)
        if kind == 0:
            return f'<remap from="{self.pick(["scan", "/odom", "~in"])}" to="{self.name("/t")}"{self.pick(CONDITIONS)}/>'
        if kind == 1:
            return f'<env name="{self.pick(["A", "B"])}" value="{self.value()}"/>'
        if kind == 2:
            return (
                f"<rosparam{self.pick(['', ' ns=' + chr(34) + 'in' + chr(34)])}>{self.pick(YAMLS)}</rosparam>"
            )
        return self.param()

    def param(self) -> str:
        kind = self.pick(["", "", "", ' type="str"', ' type="auto"'])
        return f'<param name="{self.pick(["", "", "~", "deep/"])}{self.name("p")}" value="{self.value()}"{kind}{self.pick(CONDITIONS)}/>'

    def node(self) -> str:
        words = ' respawn="true"' if self.random.random() < 0.2 else ""
        words += self.pick(NAMESPACES) + self.pick(CONDITIONS)
        inner = "".join(self.node_child() for _ in range(self.random.randrange(3)))
        return f'<node pkg="topic_tools" type="relay" name="{self.name("n")}" args="{self.value()} \'a b\' {self.value()}"{words}>{inner}</node>'

    def element(self, depth: int) -> str:
        kind = self.random.randrange(10)
        if kind < 4 or depth > 3:
            return self.node()
        if kind == 4:
            return f'<env name="{self.pick(["A", "C"])}" value="{self.value()}"{self.pick(CONDITIONS)}/>'
        if kind == 5:
            return f'<remap from="{self.pick(["scan", "map"])}" to="{self.name("/t")}"/>'
        if kind == 6:
            return self.param()
        if kind == 7:
            return f'<rosparam ns="{self.name("space")}">{self.pick(YAMLS)}</rosparam>'
        if kind == 8:
            args = f'<arg name="b" value="{self.value()}"/>' if self.random.random() < 0.7 else ""
            every = ' pass_all_args="true"' if self.random.random() < 0.3 else ""
            return f'<include file="{self.included}"{every} ns="{self.name("inc")}"{self.pick(CONDITIONS)}>{args}</include>'
        inner = "\n".join(self.element(depth + 1) for _ in range(self.random.randrange(1, 4)))
        return f"<group{self.pick(NAMESPACES)}{self.pick(CONDITIONS)}>\n{inner}\n</group>"

    def document(self) -> str:
        args = f'<arg name="a" default="{self.pick(["x", "word", "long_word"])}"/>\n<arg name="b" default="{self.pick(["bb", "$(arg a)b"])}"/>\n'
        args += f'<arg name="flag" default="{self.pick(["true", "false", "0", "1"])}"/>\n'
        body = "\n".join(self.element(0) for _ in range(self.random.randrange(1, 7)))
        last = '<node pkg="topic_tools" type="relay" name="last"/>'
        return f"<launch>\n{args}{body}\n{last}\n</launch>\n"


def write_random_launch_files(directory: Path, count: int, seed: int) -> list[Path]:
    """Write files and one that they include; their paths."""
    (directory / "inner.launch").write_text(
        LaunchWriter(seed, "none").document().replace('"none"', '"$(dirname)/leaf.launch"')
    )
    (directory / "leaf.launch").write_text('<launch>\n<arg name="b" default="c"/>\n<arg name="a" default="c"/>\n<arg name="flag" default="1"/>\n'
        '<node pkg="topic_tools" type="relay" name="leaf" args="$(arg b)"/>\n</launch>\n')  # fmt: skip
    paths = []
    for number in range(count):
        path = directory / f"random{number}.launch"
        path.write_text(LaunchWriter(seed + 1 + number, "$(dirname)/inner.launch").document())
        paths.append(path)
    return paths
