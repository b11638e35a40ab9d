# SPDX-License-Identifier: Apache-2.0
"""Broken task files: each with its place, message and a hint that repairs it."""

from pathlib import Path

import pytest

from tests.config.broken_files import INVENTORY, TASKS, BrokenFile, check_problem, list_problems

NAV = "command: roslaunch nav.launch"
CASES = [
    BrokenFile(name="unknown key", old="    demand: {cpu: 500m", new="    demnd: {cpu: 500m", at="demnd", code="EC012",
        message="unknown key demnd in task navigation", hint="did you mean demand?", mended="    demand: {cpu: 500m"),
    BrokenFile(name="unknown resource", old="cpu: 500m", new="cpus: 500m", at="cpus: 500m", code="EC012", message="unknown key cpus in demand",
        hint="did you mean cpu?", mended="cpu: 500m"),
    BrokenFile(name="key twice", old=NAV, new=f"{NAV}\n    {NAV}", position=(14, 5), code="EC005", message="first defined on line 13",
        hint="remove line 13 or line 14", mended=NAV),
    BrokenFile(name="no command", old=f"    {NAV}\n", new="", at="navigation", code="EC011", message="task navigation needs command",
        hint="add command", mended="    command: x\n"),
    BrokenFile(name="empty command", old=NAV, new="command: ''", at="''", code="EC019", message="must not be empty", hint="write a value", mended=NAV),
    BrokenFile(name="command is a list", old=NAV, new="command: [roslaunch, nav.launch]", at="[roslaunch", code="EC010",
        message="must be one string, which a shell runs", hint="write command: roslaunch nav.launch", mended=NAV),
    BrokenFile(name="command begins with a brace", old=NAV, new="command: {robot}/run", at="/run", code="EC004",
        message="text after a closing bracket", hint="command: '{robot}/run'", mended="command: '{robot}/run'"),
    BrokenFile(name="command is a mapping", old=NAV, new="command: {robot}", at="{robot}\n    env", code="EC010",
        message="must be a string, not a mapping", hint="put it in quotes: '{robot}'", mended="command: '{robot}'"),
    BrokenFile(name="colon in a command", old=NAV, new="command: echo a: b", at=": b", code="EC004", message='a second ": "',
        hint="command: 'echo a: b'", mended="command: 'echo a: b'"),
    BrokenFile(name="at sign", old=NAV, new="command: @run", at="@run", code="EC004", message="@ cannot begin", hint="command: '@run'",
        mended="command: '@run'"),
    BrokenFile(name="star", old=NAV, new="command: *.launch", at=".launch\n    env", code="EC004", message="* and & begin an alias",
        hint="command: '*.launch'", mended="command: '*.launch'"),
    BrokenFile(name="open quote", old=NAV, new="command: 'run", at="'run", code="EC004", message="a quote is not closed",
        hint="close the quote", mended="command: 'run'"),
    BrokenFile(name="NUL in a command", old=NAV, new='command: "a\\0b"', at='"a\\0b"', code="EC019", message="must not contain a NUL",
        hint="remove \\0", mended='command: "ab"'),
    BrokenFile(name="needs nobody", old="needs: [slam]", new="needs: [slan]", at="slan", code="EC030", message="unknown task slan",
        hint="did you mean slam?", mended="needs: [slam]"),
    BrokenFile(name="needs with a placeholder", old="needs: [slam]", new='needs: ["slam-{robot}"]', at='"slam-{robot}"', code="EC030",
        message="unknown task slam-{robot}", hint="write slam, which means that of the same robot", mended="needs: [slam]"),
    BrokenFile(name="needs as text", old="needs: [slam]", new="needs: slam", at="slam\n    command: roslaunch nav", code="EC010",
        message="must be a list, not a string", hint="write [slam]", mended="needs: [slam]"),
    BrokenFile(name="needs twice", old="needs: [slam]", new="needs: [slam, slam]", at="slam]", code="EC032", message="slam-robot1 is needed twice",
        hint="name it once", mended="needs: [slam]"),
    BrokenFile(name="needs itself", old="needs: [slam]", new="needs: [navigation]", at="navigation]", code="EC031",
        message="navigation-robot1 needs itself: navigation-robot1 -> navigation-robot1", hint="remove one of these needs", mended="needs: []"),
    BrokenFile(name="cycle", old="  slam:\n", new="  slam:\n    needs: [map-merge]\n", at="{task: slam", code="EC031",
        message="map-merge needs itself: map-merge -> slam-robot1 -> map-merge", hint="such as slam-robot1 from map-merge", mended="  slam:\n"),
    BrokenFile(name="apart from nobody", old="needs: [slam]", new="apart: [slan]", at="slan", code="EC030", message="unknown task slan",
        hint="did you mean slam?", mended="apart: [slam]"),
    BrokenFile(name="apart from itself", old="kind: job", new="apart: [map-merge]", at="map-merge]", code="EC033",
        message="map-merge names itself in apart", hint="name other tasks, or remove map-merge", mended="apart: [slam]"),
    BrokenFile(name="apart and together", old="    needs: [slam]\n", new="    together: [slam]\n    apart: [slam]\n", position=(13, 13), code="EC033",
        message="navigation-robot1 is apart from slam-robot1 and together with it", hint="remove slam from apart", mended="    together: [slam]\n"),
    BrokenFile(name="apart on one host", old="    detect: {cmdline: \"pose_node\"}\n", new="    detect: {cmdline: \"pose_node\"}\n    hosts: {pin: edge1}\n  other:\n    command: x\n    hosts: {only: [edge1]}\n    apart: [pose]\n",
        at="pose]", code="EC033", message="other is apart from pose, and both may run on edge1 alone", hint="let one of them run elsewhere",
        mended="    detect: {cmdline: \"pose_node\"}\n"),
    BrokenFile(name="together, pinned apart", old="kind: job", new="hosts: {pin: edge1}\n  other:\n    command: x\n    hosts: {pin: edge2}\n    together: [map-merge]", at="[map-merge]",
        code="EC033", message="are pinned apart: map-merge to edge1 and other to edge2", hint="pin them to one host", mended="kind: job"),
    BrokenFile(name="together nowhere", old="kind: job", new="hosts: {only: [edge1]}\n  other:\n    command: x\n    hosts: {never: [edge1]}\n    together: [map-merge]", at="[map-merge]",
        code="EC033", message="no host may run map-merge and other together", hint="allow one host", mended="kind: job"),
    BrokenFile(name="spread over an unknown label", old="needs: [slam]", new="spread: gpus", at="gpus", code="EC030", message="no host has a label gpus",
        hint="did you mean gpu?", mended="spread: gpu"),
    BrokenFile(name="one task spread", old="kind: job", new="spread: host", position=(30, 13), code="EC033", message="map-merge is one task",
        hint="add for_each, or remove spread", mended="kind: job"),
    BrokenFile(name="spread together", old="    needs: [slam]\n", new="    spread: host\n    together: [navigation]\n", position=(12, 13), code="EC033",
        message="navigation-robot1 and navigation-robot2 are spread and together", hint="remove spread", mended="    spread: host\n"),
    BrokenFile(name="group of one", old="kind: job", new="group: mission", at="mission", code="EC033", message="map-merge is the only task of the group mission",
        hint="give other tasks this group, or remove it", mended="kind: job"),
    BrokenFile(name="unknown preference", old="weights: all", new="prefer: packed", at="packed", code="EC013", message="unknown word 'packed'",
        hint="did you mean pack?", mended="prefer: pack"),
    BrokenFile(name="unknown until", old="until: ready", new="until: redy", at="redy", code="EC013", message="unknown word 'redy'",
        hint="did you mean ready?", mended="until: ready"),
    BrokenFile(name="unknown robot", old="robot: robot1", new="robot: robot9", at="robot9", code="EC030", message="unknown robot robot9",
        hint="did you mean robot", mended="robot: robot2"),
    BrokenFile(name="robot and for_each", old="    robot: robot1\n", new="    for_each: robot\n    robot: robot1\n", at="robot: robot1", code="EC033",
        message="for_each and robot do not go together", hint="remove robot or for_each", mended="    for_each: robot\n"),
    BrokenFile(name="for_each robots", old="for_each: robot", new="for_each: robots", at="robots", code="EC010", message="must be the word robot",
        hint="write for_each: robot", mended="for_each: robot"),
    BrokenFile(name="unknown host", old="never: [edge3]", new="never: [egde3]", at="egde3", code="EC030", message="unknown host egde3",
        hint="did you mean edge3?", mended="never: [edge3]"),
    BrokenFile(name="only nobody", old="never: [edge3]", new="only: []", at="[]", code="EC033", message="only names no host", hint="or remove only",
        mended="never: []"),
    BrokenFile(name="for each of none", old="for_each: robot", new="for_each: []", at="[]", code="EC010", message="must be the word robot",
        hint="write for_each: robot", mended="for_each: robot"),
    BrokenFile(name="unknown label", old="labels: {gpu: maxwell}", new="labels: {gpus: maxwell}", at="gpus", code="EC030",
        message="no host has a label gpus", hint="did you mean gpu?", mended="labels: {gpu: maxwell}"),
    BrokenFile(name="unknown value of a label", old="labels: {gpu: maxwell}", new="labels: {gpu: maxwel}", at="maxwel", code="EC030",
        message="no host has the label gpu: maxwel", hint="did you mean maxwell?", mended="labels: {gpu: maxwell}"),
    BrokenFile(name="pin to nobody", old="{never: [edge3], labels: {gpu: maxwell}}", new="{pin: edge7}", at="edge7", code="EC030",
        message="unknown host edge7", hint="did you mean edge", mended="{pin: edge3}"),
    BrokenFile(name="pin against never", old="labels: {gpu: maxwell}}", new="pin: edge3}", at="edge3}", code="EC033",
        message="which its own only and never exclude", hint="remove pin", mended="labels: {gpu: maxwell}}"),
    BrokenFile(name="pin to another robot", old="{never: [edge3], labels: {gpu: maxwell}}", new="{pin: robot1}", at="robot1}", code="EC033",
        message="navigation-robot2 is pinned to the robot robot1, which cannot run it", hint="pin it to an edge", mended="{pin: edge1}"),
    BrokenFile(name="demand above all", old="cpu: 35.2%", new="cpu: 135%", at="135%", code="EC015", message="at most 100% of a host, not 135%",
        hint="write an absolute amount, such as 1.5", mended="cpu: 1.5"),
    BrokenFile(name="negative demand", old="cpu: 500m", new="cpu: -0.5", at="-0.5", code="EC015", message="must be a finite number, 0 or more",
        hint="write cores as 0.5 or 500m", mended="cpu: 0.5"),
    BrokenFile(name="measured misspelt", old="cpu: 500m", new="cpu: mesured", at="mesured", code="EC013", message="unknown word 'mesured'",
        hint="did you mean measured?", mended="cpu: measured"),
    BrokenFile(name="key of a measured demand", old="cpu: 500m", new="cpu: {until: 1}", at="until: 1", code="EC012",
        message="unknown key until in a measured demand", hint="known keys: until_measured", mended="cpu: {until_measured: 1}"),
    BrokenFile(name="unit of cores", old="cpu: 500m", new="cpu: 2cores", at="2cores", code="EC015", message="cannot be read as a quantity: '2cores'",
        hint="write 2", mended="cpu: 2"),
    BrokenFile(name="unit of a rate", old="throughput: 300kB/s", new="throughput: 12MBps", at="12MBps", code="EC015",
        message="cannot be read as a quantity: '12MBps'", hint="write 12MB/s", mended="throughput: 12MB/s"),
    BrokenFile(name="semicolon in a quantity", old="cpu: 500m", new='cpu: "1; 2"', at='"1; 2"', code="EC015",
        message="cannot be read as a quantity: '1; 2'", hint="write cores as 0.5 or 500m", mended="cpu: 0.5"),
    BrokenFile(name="demand is true", old="cpu: 500m", new="cpu: true", at="true", code="EC015", message="must not be true or false",
        hint="write cores as 0.5", mended="cpu: 0.5"),
    BrokenFile(name="unit of a duration", old="timeout: 20s", new="timeout: 20 sec", at="20 sec", code="EC015",
        message="cannot be read as a duration: '20 sec'", hint="write 20s", mended="timeout: 20s"),
    BrokenFile(name="no time", old="timeout: 20s", new="timeout: 0", at="0}", code="EC015", message="must be above 0", hint="write a quantity above 0",
        mended="timeout: 20s"),
    BrokenFile(name="deadline", old="priority: 1", new="deadline: 5min", at="5min", code="EC015", message="cannot be read as a duration",
        hint="write 5m", mended="deadline: 5m"),
    BrokenFile(name="priority as text", old="priority: 1", new="priority: high", at="high", code="EC010", message="must be a number, not a string",
        hint="write 10", mended="priority: 10"),
    BrokenFile(name="endless priority", old="priority: 1", new="priority: .inf", at=".inf", code="EC015", message="must be a finite number",
        hint="write a number between", mended="priority: 1"),
    BrokenFile(name="onboard of several", old="    kind: job", new="    onboard: only", at="only", code="EC033",
        message="onboard: only needs exactly one robot, and map-merge has 2", hint="or onboard: allow", mended="    onboard: allow"),
    BrokenFile(name="onboard where nothing runs", old="onboard: allow", new="onboard: only", at="only", code="EC033",
        message="onboard: only, but robot2 runs no tasks", hint="onboard: allow here", mended="onboard: allow"),
    *(
        BrokenFile(name=f"image, {name}", old="    demand: {cpu: 35.2%, memory: 2.5%, throughput: 2.5%}\n", new=f"    image: {new}\n    demand: {{cpu: 35.2%, memory: 2.5%, throughput: 2.5%}}\n", at=at, code=code,
            message=message, hint=hint, mended=f"    image: {mended}\n    demand: {{cpu: 35.2%, memory: 2.5%, throughput: 2.5%}}\n")
        for name, new, at, code, message, hint, mended in [
            ("an option", "--privileged", "--privileged\n", "EC019", "'--privileged' is no name of an image", "such as ros:jazzy", "ros:jazzy"),
            ("a number", "22.04", "22.04\n", "EC010", "must be a string, not 22.04", 'put it in quotes: "22.04"', '"22.04"'),
            ("no name", "{gpus: all}", "{gpus: all}", "EC011", "image needs name", "add name", "{name: a, gpus: all}"),
            ("unknown key", "{name: a, volume: []}", "volume", "EC012", "unknown key volume in image", "did you mean volumes?", "{name: a, volumes: []}"),
            ("unknown engine", "{name: a, engine: dcker}", "dcker", "EC013", "unknown word", "did you mean docker?", "{name: a, engine: docker}"),
            ("no GPU", "{name: a, gpus: 0}", "0}", "EC015", "1", "1", "{name: a, gpus: 1}"),
            ("device of nowhere", "{name: a, devices: [video0]}", "video0", "EC019", "'video0' is no device", "write /dev/video0", "{name: a, devices: [/dev/video0]}"),
            ("volume to a relative path", '{name: a, volumes: ["/srv:maps"]}', '"/srv:maps"', "EC019", "'/srv:maps' is no volume", "/srv/maps:/maps", '{name: a, volumes: ["/srv/maps:/maps:ro"]}'),
            ("option as a volume", '{name: a, volumes: ["-v:/maps"]}', '"-v:/maps"', "EC019", "is no volume", "NAME:/maps", '{name: a, volumes: ["NAME:/maps"]}'),
            ("user as a number", "{name: a, user: 1000}", "1000}", "EC010", "must be a string, not 1000", 'put it in quotes: "1000"', '{name: a, user: "1000"}'),
            ("option as a network", "{name: a, network: --x}", "--x", "EC019", "'--x' is no network", "write host, bridge", "{name: a, network: bridge}"),
            ("argument that is no option", "{name: a, args: [sh]}", "sh]", "EC019", "'sh' is no option of the engine", "as one word: --shm-size=1g", "{name: a, args: [--shm-size=1g]}"),
            ("devices of a service", "{name: a, engine: swarm, devices: [/dev/video0]}", "[/dev/video0]", "EC033", "a service of a swarm has no devices", "write engine: docker", "{name: a, engine: docker, devices: [/dev/video0]}"),
            ("GPUs of a service", "{name: a, engine: swarm, gpus: all}", "all}", "EC033", "a service of a swarm has no gpus", "--generic-resource=gpu=1", '{name: a, engine: swarm, args: ["--generic-resource=gpu=1"]}'),
            ("IPC namespace of a service", "{name: a, engine: swarm, ipc: shareable}", "shareable}", "EC033", "shared memory of its own, or that of the host", "write ipc: host", "{name: a, engine: swarm, ipc: private}"),
            ("volume of a service", '{name: a, engine: swarm, volumes: ["/srv:/srv:ro", "/srv:/maps:z"]}', '"/srv:/maps:z"', "EC033", "no options but ro", "write /srv/maps:/maps:ro", '{name: a, engine: swarm, volumes: ["/srv:/srv:ro", "/srv:/maps:ro"]}'),
            ("option of a container for a service", "{name: a, engine: swarm, args: [--privileged]}", "--privileged", "EC033", "a service of a swarm has no option --privileged", "write engine: docker", "{name: a, args: [--privileged]}"),
            ("option of edgectl for a service", "{name: a, engine: swarm, args: [--replicas=2]}", "--replicas", "EC033", "--replicas is an option that edgectl sets itself", "remove it", "{name: a, engine: swarm}"),
            ("option of edgectl", "{name: a, args: [--name=x]}", "--name=x", "EC033", "--name is an option that edgectl sets itself", "remove it", "{name: a, args: []}"),
        ]
    ),
    BrokenFile(name="image of an unmanaged task", old="    managed: false\n", new="    managed: false\n    image: ros:jazzy\n", at="image", code="EC033",
        message="a task with managed: false is never started, so it has no image", hint="remove image", mended="    managed: false\n"),
    *(
        BrokenFile(name=f"standby, {name}", old="    demand: {cpu: 35.2%, memory: 2.5%, throughput: 2.5%}\n", new=f"    standby: {new}\n    demand: {{cpu: 35.2%, memory: 2.5%, throughput: 2.5%}}\n", at=at, code=code,
            message=message, hint=hint, mended=f"    standby: {mended}\n    demand: {{cpu: 35.2%, memory: 2.5%, throughput: 2.5%}}\n")
        for name, new, at, code, message, hint, mended in [
            ("unknown word", "hot", "hot\n", "EC013", "standby: hot does not say how a copy becomes active", "activate: COMMAND", "{ros_lifecycle: /nav}"),
            ("half a pair", "{activate: wake}", "{activate: wake}", "EC011", "standby needs deactivate", "deactivate: COMMAND", "{activate: wake, deactivate: sleep}"),
            ("nothing", "{}", "{}\n    demand", "EC011", "standby needs activate and deactivate", "or ros_lifecycle: /NODE", "none"),
            ("both ways", "{activate: wake, deactivate: x, ros_lifecycle: /n}", "activate: wake", "EC033", "activate and ros_lifecycle do not go together", "remove activate", "{ros_lifecycle: /n}"),
            ("no host", "{ros_lifecycle: /n, warm: {hosts: 0}}", "0}}", "EC015", "1", "1", "{ros_lifecycle: /n, warm: {hosts: 1}}"),
            ("too many hosts", "{ros_lifecycle: /n, warm: {hosts: 9}}", "9}}", "EC015", "8", "8", "{ros_lifecycle: /n, warm: {hosts: 8}}"),
            ("warm as a number", "{ros_lifecycle: /n, warm: 2}", "2}\n", "EC010", "warm", "", "{ros_lifecycle: /n, warm: {hosts: 2}}"),
            ("unknown key", "{ros_lifecycle: /n, memry: 4Mi}", "memry", "EC012", "unknown key memry", "did you mean memory?", "{ros_lifecycle: /n, memory: 4Mi}"),
            ("measured memory", "{ros_lifecycle: /n, memory: measured}", "measured}", "EC015", "cannot be read as a quantity", "write", "{ros_lifecycle: /n, memory: 4Mi}"),
            ("on the robot", "{activate: {command: a, on: robot}, deactivate: b}", "on: robot}, dea", "EC033", "activate runs on the host of the instance", "remove on: robot", "{activate: a, deactivate: b}"),
            ("ready on the robot", "{ros_lifecycle: /n, ready: {command: a, on: robot}}", "on: robot}}", "EC033", "ready runs on the host of the instance", "remove on: robot", "{ros_lifecycle: /n, ready: a}"),
            ("no name of a node", "{ros_lifecycle: 'a b'}", "'a b'", "EC019", "is no name in the ROS graph", "write a name such as", "{ros_lifecycle: /a}"),
            ("empty command", "{activate: '', deactivate: b}", "'', dea", "EC019", "must not be empty", "write a value", "{activate: a, deactivate: b}"),
        ]
    ),
    *(
        BrokenFile(name=f"standby and {name}", old=old, new=new, at="standby", code="EC033", message=message, hint=hint, mended=mended)
        for name, old, new, message, hint, mended in [
            ("a job", "    kind: job\n", "    kind: job\n    standby: {ros_lifecycle: /m}\n", "a job has no standby", "remove standby, or kind: job", "    kind: job\n"),
            ("onboard alone", "    robot: robot1\n    managed: false\n    detect: {cmdline: \"pose_node\"}\n", "    robot: robot1\n    command: x\n    onboard: only\n    standby: {ros_lifecycle: /m}\n", "standby and onboard: only do not go together", "remove standby", "    robot: robot1\n    command: x\n    standby: {ros_lifecycle: /m}\n"),
            ("one host", "    hosts: {never: [edge3], labels: {gpu: maxwell}}\n", "    hosts: {pin: edge1}\n    standby: {ros_lifecycle: /m}\n", "standby of navigation-robot1 needs a second host, and only edge1 may run it", "allow another host", "    hosts: {never: [edge3]}\n    standby: {ros_lifecycle: /m}\n"),
            ("together", "    needs: [slam]\n", "    together: [slam]\n    standby: {ros_lifecycle: /m}\n", "which is together with slam-robot1", "or the together that joins them", "    needs: [slam]\n"),
            ("start-first", "    stop: ros\n", "    handoff: {order: start-first}\n    standby: {ros_lifecycle: /m}\n", "two instances are never active at once", "remove standby, or order: start-first", "    stop: ros\n"),
            ("unmanaged", "    managed: false\n", "    managed: false\n    standby: {ros_lifecycle: /m}\n", "standby is for moves", "remove standby", "    managed: false\n"),
        ]
    ),
    *(
        BrokenFile(name=f"state, {name}", old="    demand: {cpu: 35.2%, memory: 2.5%, throughput: 2.5%}\n", new=f"    state: {new}\n    demand: {{cpu: 35.2%, memory: 2.5%, throughput: 2.5%}}\n", at=at, code=code,
            message=message, hint=hint, mended=f"    state: {mended}\n    demand: {{cpu: 35.2%, memory: 2.5%, throughput: 2.5%}}\n")
        for name, new, at, code, message, hint, mended in [
            ("half a pair", "{save: a}", "{save: a}", "EC011", "state needs save and load, or topic", "load: COMMAND", "{save: a, load: b}"),
            ("both ways", "{save: a, load: b, topic: /map}", "save: a", "EC033", "save and topic do not go together", "remove save or topic", "{topic: /map}"),
            ("a word", "all", "all\n    demand", "EC010", "state", "", "{topic: /map}"),
            ("on the robot", "{save: {command: a, on: robot}, load: b}", "on: robot}, load", "EC033", "save runs on the host of the instance", "remove on: robot", "{save: a, load: b}"),
            ("no size", "{topic: /map, max_size: 0}", "0}\n", "EC015", "must be above 0", "write a quantity above 0", "{topic: /map, max_size: 1Mi}"),
            ("unknown moment", "{save: a, load: b, save_when: activ}", "activ}", "EC013", "unknown word 'activ'", "did you mean active?", "{save: a, load: b, save_when: active}"),
        ]
    ),
    BrokenFile(name="regular expression", old='cmdline: "pose_node"', new='cmdline: "pose(node"', at='"pose(node"', code="EC017",
        message="not a regular expression: missing ), unterminated subpattern", hint=r"'pose\(node'", mended=r"cmdline: 'pose\(node'"),
    BrokenFile(name="detect of two", old='cmdline: "pose_node"', new='cmdline: "pose", ros_node: /pose', at='{cmdline: "pose"', code="EC033",
        message="detect needs one of cmdline and ros_node", hint="write {cmdline", mended='cmdline: "pose"'),
    BrokenFile(name="unmanaged with a command", old="    managed: false\n", new="    managed: false\n    command: run\n", at="command: run", code="EC033",
        message="never started, so it has no command", hint="remove command", mended="    managed: false\n"),
    BrokenFile(name="unmanaged and not found", old='    detect: {cmdline: "pose_node"}\n', new="", at="pose:", code="EC011",
        message="task pose has managed: false, so it needs detect", hint="add detect: {cmdline", mended="    detect: {ros_node: /name}\n"),
    BrokenFile(name="managed with detect", old="stop: ros", new="detect: {ros_node: /nav}", at="detect: {ros", code="EC033",
        message="detect finds tasks that edgectl does not start", hint="remove detect", mended="stop: ros"),
    BrokenFile(name="job for ever", old="kind: job", new="kind: job\n    restart: always", at="restart", code="EC033",
        message="a job that is always restarted never completes", hint="write restart: on-failure", mended="kind: job\n    restart: on-failure"),
    BrokenFile(name="way to stop", old="stop: ros", new="stop: rso", at="rso", code="EC013", message="unknown way to stop: rso", hint="write ros",
        mended="stop: ros"),
    BrokenFile(name="signal", old="stop: ros", new="stop: {signal: SIGINT}", at="SIGINT", code="EC013", message="unknown signal 'SIGINT'",
        hint="did you mean INT?", mended="stop: {signal: INT}"),
    BrokenFile(name="unreachable", old="on_unreachable: hold", new="on_unreachable: {after: 2m}", at="{after", code="EC011",
        message="on_unreachable needs policy", hint="add policy", mended="on_unreachable: {policy: replace, after: 2m}\n    self_fence: 5m"),
    BrokenFile(name="downtime cost", old="on_unreachable: hold", new="downtime_cost: -1", at="-1", code="EC015",
        message="must be a number from 0 to 1e+06, not -1", hint="write 0.5", mended="downtime_cost: 0.5"),
    BrokenFile(name="replace unfenced", old="on_unreachable: hold", new="on_unreachable: replace", at="on_unreachable", code="EC033",
        message="on_unreachable: replace needs self_fence", hint="add self_fence: 5m", mended="on_unreachable: replace\n    self_fence: 5m"),
    BrokenFile(name="replace a service", old="on_unreachable: hold", new="on_unreachable: replace\n    self_fence: 5m\n    image: {name: a, engine: swarm}", at="on_unreachable", code="EC033",
        message="on_unreachable: replace and engine: swarm do not go together", hint="write on_unreachable: hold", mended="on_unreachable: hold\n    self_fence: 5m\n    image: {name: a, engine: swarm}"),
    BrokenFile(name="short fence", old="on_unreachable: hold", new="self_fence: 2s", at="self_fence", code="EC033",
        message="self_fence 2.0s is too short: heartbeats are sent every quarter of it (0.5s)", hint="write self_fence: 5m", mended="self_fence: 5m"),
    BrokenFile(name="robot without one", old="kind: job", new='env: {R: "{robot}"}', at='{R: "', code="EC035",
        message="{robot} and {robot_host} need exactly one robot, and map-merge has 2", hint="$EDGECTL_ROBOTS",
        mended='env: {R: "$EDGECTL_ROBOTS"}'),
    BrokenFile(name="check on no robot", old="kind: job", new="done_when: {on: robot, command: x}", at="{on", code="EC033",
        message="done_when runs on the robot, and map-merge has 2", hint="write done_when: {on: host", mended="done_when: {on: host, command: x}"),
    BrokenFile(name="hook of several robots", old="kind: job", new="handoff: {hold: x}", at="x}", code="EC033",
        message="hold runs on the robot, and map-merge has 2", hint="hold: {on: host", mended="handoff: {hold: {on: host, command: x}}"),
    BrokenFile(name="weights", old="weights: all", new="weights: every", at="every", code="EC015", message="unknown weights 'every'",
        hint="write one of cpu", mended="weights: cpu"),
    BrokenFile(name="no weight", old="weights: all", new="weights: {cpu: 0}", at="{cpu: 0}", code="EC015",
        message="at least one weight must be more than 0", hint="write one of", mended="weights: {cpu: .5, network: .5}"),
    BrokenFile(name="negative weight", old="weights: all", new="weights: {cpu: -1, memory: 2}", at="-1", code="EC015", message="weight cpu must be",
        hint="cpu=.5", mended="weights: {cpu: .5, network: .5}"),
    BrokenFile(name="unknown weight", old="weights: all", new="weights: {cpu: .4, mem: .2}", at="mem: .2", code="EC015",
        message="unknown weight 'mem'", hint="the weights are cpu, memory", mended="weights: {cpu: .4, memory: .2}"),
    BrokenFile(name="command as a list among braces", old='ready: {command: "rosnode info /{robot}/slam", timeout: 20s}',
        new="ready: {command: [a, b], timeout: 20s}", at="[a, b]", code="EC010", message="must be a string, not a list",
        hint="put it in quotes: '[a, b]'", mended="ready: {command: '[a, b]', timeout: 20s}"),
    BrokenFile(name="sequence", old="sequence: connectivity", new="sequence: conectivity", at="conectivity", code="EC013", message="unknown word",
        hint="did you mean connectivity?", mended="sequence: connectivity"),
    BrokenFile(name="margin", old="weights: all", new="move_margin: 2", at="2", code="EC015", message="must be a number from 0 to 1, not 2",
        hint="write 0.1", mended="move_margin: 0.1"),
    BrokenFile(name="name", old="  pose:", new="  Pose_Estimate!:", at="Pose_Est", code="EC014", message="cannot be the name of a task",
        hint="write pose_estimate", mended="  pose_estimate:"),
    BrokenFile(name="same name after for_each", old="  pose:", new="  slam-robot1:", at="slam-robot1", code="EC032",
        message="slam-robot1 makes a task slam-robot1, and slam does too", hint="rename one of the two", mended="  pose:"),
    BrokenFile(name="tasks as a list", old="tasks:\n", new="tasks: []\nx:\n", at="[]", code="EC010", message="tasks must be a mapping of names",
        hint="write a name, a colon", mended="tasks:\n"),
    BrokenFile(name="log", old="kind: job", new="log: {max_size: 10MI}", at="10MI", code="EC015", message="cannot be read as a quantity",
        hint="write 10Mi", mended="log: {max_size: 10Mi}"),
]  # fmt: skip


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_broken_task_file_is_told_with_place_and_mend(case: BrokenFile, tmp_path: Path) -> None:
    check_problem(case, tmp_path, in_tasks=True)


def test_all_mistakes_of_both_files_at_once(tmp_path: Path) -> None:
    inventory = INVENTORY.replace("user: jetson", "usr: jetson").replace("cpu: 2,", "cpu: x,")
    tasks = (
        TASKS.replace("cpu: 500m", "cpu: -1")
        .replace("until: ready", "until: never")
        .replace("robot: robot1", "robot: r")
    )
    found = list_problems(tmp_path, inventory, tasks)
    assert [(Path(p.file).name, p.line, p.code) for p in found] == [
        ("inventory.yaml", 2, "EC012"),
        ("inventory.yaml", 6, "EC015"),
        ("tasks.yaml", 15, "EC015"),
        ("tasks.yaml", 22, "EC030"),
        ("tasks.yaml", 27, "EC013"),
    ]


def test_a_template_mistake_is_told_once_not_per_robot(tmp_path: Path) -> None:
    found = list_problems(
        tmp_path, INVENTORY.replace(", onboard: true", ""), TASKS.replace("onboard: allow", "onboard: only")
    )
    assert [problem.code for problem in found] == ["EC033"]


def test_what_has_a_bad_name_or_value_is_not_told_a_second_time(tmp_path: Path) -> None:
    tasks = (
        TASKS.replace('cmdline: "pose_node"', 'cmdline: "(["')
        .replace("  pose:", "  Pose:")
        .replace("needs: [slam]", "needs: [Pose]")
    )
    assert [problem.code for problem in list_problems(tmp_path, INVENTORY, tasks)] == ["EC014", "EC017"]


def test_several_cycles_are_all_told(tmp_path: Path) -> None:
    tasks = "version: 1\ntasks:\n" + "".join(
        f"  {name}: {{command: x, needs: [{need}], demand: {{cpu: 0, memory: 0}}}}\n"
        for name, need in ("ab", "ba", "cd", "dc")
    )
    found = list_problems(tmp_path, INVENTORY, tasks)
    assert [(p.line, p.code, p.message) for p in found] == [
        (3, "EC031", "a needs itself: a -> b -> a"),
        (5, "EC031", "c needs itself: c -> d -> c"),
    ]
