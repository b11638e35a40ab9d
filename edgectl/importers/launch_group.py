# SPDX-License-Identifier: Apache-2.0
"""One task per launch file (``--group file``): the command is roslaunch or ros2 launch itself."""

import posixpath
from collections.abc import Mapping

from edgectl.config.problems import Mark, Source
from edgectl.importers.launch_values import Launch, RosNode


def add_launch_file(
    path: str,
    version: int,
    package: str,
    arguments: Mapping[str, str],
    launch: Launch,
) -> None:
    """Add the whole file as one process. ``package``: the one that holds it, if any."""
    mark = Mark(Source(file=path, text="", lines=()), 1, 1)
    words = [f"{name}:={value}" for name, value in arguments.items()]
    if package:
        place = [package, posixpath.basename(path)]
    else:
        place = [path]
        launch.note(mark, "no package holds this file: the hosts need it at the same path")
    name = posixpath.basename(path).partition(".")[0]
    executable, first = ("roslaunch", []) if version == 1 else ("ros2", ["launch"])
    launch.add_node(
        RosNode(
            version=version,
            mark=mark,
            package="",
            executable=executable,
            name=name,
            arguments=(*first, *place, *words),
        )
    )
