# SPDX-License-Identifier: Apache-2.0
"""What roslaunch itself reads: run by the Python that has roslaunch; one JSON object per file on standard output.

Each argument is ``FILE[,ARG:=VALUE..]``.
"""

import json
import sys
from typing import Any


def read_launch_file(path: str, arguments: "list[str]") -> "dict[str, Any]":
    """Nodes, parameters and machines of a file, or its error."""
    import roslaunch.config
    import roslaunch.xmlloader

    config = roslaunch.config.ROSLaunchConfig()
    try:
        roslaunch.xmlloader.XmlLoader().load(path, config, argv=arguments, verbose=False)
    except Exception as error:
        return {"error": "{}: {}".format(type(error).__name__, error)}  # noqa: UP032
    return {
        "nodes": [
            {
                "name": node.namespace + node.name,
                "package": node.package,
                "executable": node.type,
                "arguments": node.args,
                "remaps": node.remap_args,
                "env": dict(node.env_args),
                "machine": node.machine_name or "",
                "respawn": node.respawn,
                "prefix": node.launch_prefix or "",
            }
            for node in config.nodes
        ],
        "parameters": {name: parameter.value for name, parameter in config.params.items()},
        "machines": {
            name: [machine.address, machine.user or "", machine.ssh_port]
            for name, machine in config.machines.items()
            if name
        },
    }


if __name__ == "__main__":
    specs = sys.argv[1:]
    sys.argv = ["roslaunch"]
    for spec in specs:
        file, *given = spec.split(",")
        print(json.dumps(read_launch_file(file, given)))
