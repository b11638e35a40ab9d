# SPDX-License-Identifier: Apache-2.0
"""Broken launch files, inventories and requirement files: each message names file, line and what to do."""

import os
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from edgectl.cli.user_files import refuse_exposed_files
from edgectl.errors import InputError, Problem
from edgectl.usecases.import_files import import_ansible, import_paper, import_ros
from edgectl.usecases.import_result import Imported
from edgectl.usecases.launch_program import run_launch_program
from tests.cli.inprocess import edgectl

NODE = '<node pkg="topic_tools" type="relay" name="relay"/>'
NODE2 = '<node pkg="topic_tools" exec="relay" name="relay"/>'


@dataclass(frozen=True, kw_only=True)
class Broken:
    """A file that cannot be imported: the place of the first problem, and parts of its message and hint."""

    name: str
    text: str
    line: int
    message: str
    hint: str
    file: str = "bad.launch"
    at: str = ""
    arguments: str = ""


def ros1(
    name: str, body: str, message: str, hint: str, *, line: int = 2, at: str = "", arguments: str = ""
) -> Broken:
    return Broken(
        name=name,
        text=f"<launch>\n{body}\n</launch>\n",
        line=line,
        message=message,
        hint=hint,
        at=at,
        arguments=arguments,
    )


def ros2(
    name: str, body: str, message: str, hint: str, *, line: int = 2, at: str = "", arguments: str = ""
) -> Broken:
    broken = ros1(name, body, message, hint, line=line, at=at, arguments=arguments)
    return replace(broken, file="bad.launch.xml")


def python(name: str, body: str, message: str, hint: str = "", *, line: int = 1) -> Broken:
    return Broken(name=name, text=body, line=line, message=message, hint=hint, file="bad.launch.py")


def yaml(name: str, text: str, message: str, hint: str, *, line: int) -> Broken:
    return Broken(name=name, text=text, line=line, message=message, hint=hint, file="bad.launch.yaml")


def ansible(name: str, text: str, message: str, hint: str, *, line: int, file: str = "hosts.ini") -> Broken:
    return Broken(name=name, text=text, line=line, message=message, hint=hint, file=file)


def paper(name: str, text: str, message: str, hint: str, *, line: int) -> Broken:
    return Broken(name=name, text=text, line=line, message=message, hint=hint, file="task_req.yaml")


HEAD = "from launch import LaunchDescription\nfrom launch.actions import *\nfrom launch_ros.actions import Node\nfrom launch.substitutions import *\n"
GENERATE = "def generate_launch_description():\n    return LaunchDescription([{}])\n"

CASES = [
    # XML
    Broken(name="mismatched tag", text="<launch>\n  <group>\n</launch>\n", line=3, message="not XML: mismatched tag", hint="reverse order"),
    Broken(name="bare ampersand", text="<launch>\n  <arg name='a' default='x & y'/>\n</launch>\n", line=2, message="not XML", hint="&amp;", at=" y"),
    Broken(name="ends too early", text="<launch>\n  <group>\n", line=3, message="no element found", hint="before its root element is closed"),
    Broken(name="attribute twice", text='<launch>\n  <arg name="a" name="b"/>\n</launch>\n', line=2, message="duplicate attribute", hint="remove one"),
    Broken(name="billion laughs", text='<!DOCTYPE x [\n  <!ENTITY a "aa">\n  <!ENTITY b "&a;&a;">\n]>\n<launch>&b;</launch>\n', line=2,
        message="the entity a is declared here", hint="write its text"),
    Broken(name="external entity", text='<!DOCTYPE x [\n  <!ENTITY a SYSTEM "file:///etc/passwd">\n]>\n<launch>&a;</launch>\n', line=2,
        message="the entity a is declared here", hint="write its text"),
    Broken(name="not a launch file", text="<package>\n  <name>x</name>\n</package>\n", line=1, message="the root element is package", hint="name a launch file"),
    Broken(name="empty file", text="<launch/>\n", line=1, message="the file starts nothing", hint="check the conditions"),
    # ROS 1
    ros1("unknown element in a node", '  <node pkg="a" type="b" name="c"><parm name="x"/></node>', "unknown element parm", "did you mean param?", at="<parm"),
    ros1("unknown element in an include", '  <include file="x.launch"><ars name="x"/></include>', "unknown element ars", "did you mean arg?", at="<ars"),
    ros1("unknown element", "  <noed/>", "unknown element noed", "did you mean node?", at="<noed"),
    ros1("unknown attribute", '  <node pkg="a" type="b" name="c" respwan="true"/>', "unknown attribute respwan of node", "did you mean respawn?", at='true"'),
    ros1("no type", '  <node pkg="a" name="c"/>', "node needs type", 'add type=".."', at="<node"),
    ros1("slash in a name", '  <node pkg="a" type="b" name="x/c"/>', "the name of a node has no /", "ns", at="x/c"),
    ros1("bad name", '  <node pkg="a" type="b" name="c-1"/>', "'c-1' is no name", "letters, digits", at="c-1"),
    ros1("node twice", f"  {NODE}\n  <group>{NODE}</group>", "/relay is defined twice, first at bad.launch:2", "rename", line=3, at="<node"),
    ros1("unknown arg", '  <arg name="robot" default="a"/>\n  <node pkg="a" type="b" name="c" args="x $(arg robt)"/>', "unknown arg robt",
        "did you mean robot?", line=3, at="$(arg robt)"),
    ros1("arg without a value", '  <arg name="robot"/>', "arg robot has no value", "robot:=VALUE", at="<arg"),
    ros1("arg twice", '  <arg name="a" default="1"/>\n  <arg name="a" default="2"/>', "arg a is declared twice", "remove one", line=3),
    ros1("value and default", '  <arg name="a" default="1" value="2"/>', "both value and default", "keep one"),
    ros1("fixed arg is given", '  <arg name="a" value="2"/>', "has a fixed value", "default=", arguments="a:=1"),
    ros1("undeclared arg is given", f'  <arg name="rate" default="2"/>{NODE}', "declares no arg rat", "did you mean rate?", line=1, arguments="rat:=1"),
    ros1("no truth value", '  <group if="maybe"/>', "if must be true or false, not 'maybe'", "write true", at="maybe"),
    ros1("if and unless", '  <group if="1" unless="1"/>', "exclude each other", "remove one", at="<group"),
    ros1("open substitution", '  <node pkg="a" type="b" name="c" args="$(arg x"/>', "is not closed", "close it with )", at="$("),
    ros1("unknown substitution", '  <node pkg="a" type="b" name="c" args="$(fnid x)"/>', "unknown substitution $(fnid)", "did you mean find?", at="$(fnid x)"),
    ros1("variable not set", '  <node pkg="a" type="b" name="c" args="$(env NOT_THERE_7)"/>', "NOT_THERE_7 is not set", "$(optenv NOT_THERE_7 DEFAULT)"),
    ros1("eval of code", """  <arg name="a" value="$(eval __import__('os').system('id'))"/>""", "the function __import__ is not supported", "simplify"),
    ros1("eval of attributes", """  <arg name="a" value="$(eval ().__class__)"/>""", "Attribute is not supported", "simplify"),
    ros1("eval takes for ever", '  <arg name="a" value="$(eval 9**9**9)"/>', "exponent is above 1000", "simplify"),
    ros1("eval of much memory", """  <arg name="a" value="$(eval 'x' * 1000000000)"/>""", "only numbers can be multiplied", "simplify"),
    ros1("eval divides by zero", '  <arg name="a" value="$(eval 1/0)"/>', "division by zero", "simplify"),
    ros1("eval is no expression", '  <arg name="a" value="$(eval 1 +)"/>', "is not an expression", "simplify", at="$(eval"),
    ros1("eval of an unknown name", '  <arg name="a" value="$(eval count + 1)"/>', "count is not known", "simplify"),
    ros1("file is missing", '  <include file="$(dirname)/nothing.launch"/>', "nothing.launch: no such file", "did you mean good.launch?", at="$(dirname)"),
    ros1("package is missing", '  <include file="$(find nowhere)/x.launch"/>', "the package nowhere is not on this machine", "--package-path DIR", at="$(find"),
    ros1("include of itself", '  <include file="$(dirname)/bad.launch"/>', "includes itself for ever", "remove this include"),
    ros1("arg that nobody declares", '  <include file="$(dirname)/good.launch">\n    <arg name="rat" value="1"/>\n  </include>', "good.launch declares no arg rat",
        "did you mean rate?", line=3, at="<arg"),
    ros1("unknown machine", '  <machine name="edge1" address="10.0.0.1"/>\n  <node pkg="a" type="b" name="c" machine="edge2"/>', "unknown machine edge2",
        "did you mean edge1?", line=3, at="edge2"),
    ros1("machine twice", '  <machine name="edge1" address="10.0.0.1"/>\n  <machine name="edge1" address="10.0.0.2"/>', "defined differently on line 2", "rename", line=3),
    ros1("param without a value", '  <param name="x"/>', "needs one of value, textfile and command", "value"),
    ros1("param of a wrong type", '  <param name="x" value="seven" type="int"/>', "'seven' is not of type int", "correct", at="seven"),
    ros1("rosparam is no YAML", '  <rosparam>\n    a: [1, 2\n  </rosparam>', "[ is not closed", "close it with ]", line=3),
    ros1("rosparam without names", "  <rosparam>[1, 2]</rosparam>", "parameters must be a mapping of names", "param="),
    ros1("open quote in args", """  <node pkg="a" type="b" name="c" args="it's"/>""", "a quote in args is not closed", "close it", at="it's"),
    # ROS 2
    ros2("unknown element", "  <nod/>", "unknown element nod", "did you mean node?", at="<nod"),
    ros2("no exec", '  <node pkg="a" name="x"/>\n  <node pkg="a" exec="b"/>', "node needs exec", "add exec", at="<node"),
    ros2("unknown variable", '  <arg name="robot" default="a"/>\n  <node pkg="a" exec="b" args="$(var robt)"/>', "unknown variable robt", "did you mean robot?",
        line=3, at="$(var robt)"),
    ros2("no choice", f'  <arg name="mode" default="x"><choice value="a"/><choice value="b"/></arg>{NODE2}', "arg mode is 'x'", "its choices are a, b"),
    ros2("undeclared arg is given", NODE2, "declares no arg rate", "it has none", line=1, arguments="rate:=7"),
    ros2("a command", """  <node pkg="a" exec="b" args="$(command 'id')"/>""", "has no value here", "--group file"),
    ros2("param without a value", '  <node pkg="a" exec="b"><param name="x"/></node>', "param x has no value", "add value", at="<param"),
    ros2("param from and name", '  <node pkg="a" exec="b"><param name="x" from="y"/></node>', "either from, or name", "remove one"),
    ros2("no truth value", '  <node pkg="a" exec="b" if="$(not perhaps)"/>', "an operand must be true or false", "write true or false", at="$(not"),
    ros2("include of itself", '  <arg name="x" default="1"/><include file="$(dirname)/bad.launch.xml"/><node pkg="a" exec="b"/>', "includes itself for ever", "remove"),
    yaml("no launch", "nodes:\n- a\n", "one key launch", "begin with launch:", line=1),
    yaml("no list", "launch: {node: {pkg: a}}\n", "must be a list of actions", "begin each action with a dash", line=1),
    yaml("unknown action", "launch:\n- nod: {pkg: a}\n", "unknown element nod", "did you mean node?", line=2),
    yaml("no action", "launch:\n- arg: {name: a, default: b}\n- pkg\n", "an action is a mapping", "- node:", line=3),
    yaml("unknown attribute", "launch:\n- node:\n    pkg: a\n    exce: b\n", "unknown attribute exce", "did you mean exec?", line=4),
    yaml("bad indentation", "launch:\n- node: {pkg: a, exec: b\n- node: {}\n", "is not closed", "close it with }", line=2),
    # Python
    python("syntax", "import os\nx = (\n", "not Python: '(' was never closed", line=2),
    python("no function", "x = 1\n", "no function generate_launch_description", "name a launch file"),
    python("exception", f"{HEAD}def generate_launch_description():\n    return [][1]\n", "IndexError", line=6),
    python("unknown module", "import nav2_common_7\n", "the module nav2_common_7 is not on this machine", "--group file"),
    python("node without executable", HEAD + GENERATE.format("Node(package='a')"), "Node needs executable", "add executable=", line=6),
    python("argument without a value", HEAD + GENERATE.format("DeclareLaunchArgument('robot')"), "argument robot has no value", "robot:=VALUE", line=6),
    python("unknown argument", HEAD + GENERATE.format("Node(package='a', executable='b', name=LaunchConfiguration('x'))"), "unknown argument x", "declare it", line=6),
    python("a command", HEAD + GENERATE.format("Node(package='a', executable='b', name=Command('xacro x'))"), "the command 'xacro' is not run here", "--group file", line=6),
    python("exit", "import sys\nsys.exit(0)\n", "SystemExit", line=2),
    python("hard exit", "import os\nos._exit(0)\n", "ended by itself", "--group file"),
    python("memory", "x = bytearray(2**33)\n", "MemoryError"),
    python("include of itself", HEAD + GENERATE.format("IncludeLaunchDescription(__file__)"), "includes itself", line=6),
    python("missing include", HEAD + GENERATE.format("IncludeLaunchDescription('/nowhere/x.launch.py')"), "no such file: /nowhere/x.launch.py", "correct the path", line=6),
    python("no action", HEAD + GENERATE.format("7"), "int is not an action", line=6),
    # Ansible
    ansible("no section", "edge1\n[edges\nedge2\n", "this is no section", "[GROUP:vars]", line=2),
    ansible("unknown kind", "[edges:kids]\n", "unknown kind of section :kids", ":children", line=1),
    ansible("no value", "[edges]\nedge1 ansible_host\n", "a variable is missing its value", "NAME=VALUE", line=2),
    ansible("bad port", "[edges]\nedge1\nedge2 ansible_port=ssh\n", "'ssh' is no port", "1 to 65535", line=3),
    ansible("huge range", "edge[1:99999999]\n", "too large a range", "split", line=1),
    ansible("circle", "[a:children]\nb\n[b:children]\na\n[a]\nedge1\n", "contains itself", "remove one", line=2),
    ansible("open quote", "edge1 ansible_user='x\n", "a quote is not closed", "close it", line=1),
    ansible("script", "#!/usr/bin/env python3\nprint()\n", "this is a script, which is not run", "ansible-inventory", line=1, file="hosts.py"),
    ansible("no host", "[edges]\n", "the file names no host", "name an inventory", line=1),
    ansible("unknown key", "all:\n  host:\n    a:\n", "unknown key host of group all", "known are hosts", line=2, file="hosts.yaml"),
    ansible("hosts are a list", "all:\n  hosts:\n    - a\n", "hosts of all must be a mapping", "colon", line=3, file="hosts.yaml"),
    # the paper's authors
    paper("no demands", "task_seq: [A]\n", "no task_req", "authors", line=1),
    paper("two numbers", "task_req:\n  R1_SLAM: [35, 2.5]\n", "must be three numbers", "[35.2, 2.5, 2.53]", line=2),
    paper("unknown task in the order", "task_req:\n  R1_SLAM: [35, 2.5, 1]\ntask_seq: [R1_SLAN]\n", "R1_SLAN has no entry", "did you mean R1_SLAM?", line=3),
    paper("unknown predecessor", "task_req: {R1_SLAM: [35, 2.5, 1]}\ntask_req_seq: {R1_SLAM: [R1_Map]}\n", "R1_Map has no entry", "did you mean R1_SLAM?", line=2),
    paper("more than everything", "task_req:\n  R1_SLAM: [350, 2.5, 1]\n", "350 % is not between 0 and 100", "correct", line=2),
    paper("three weights", "task_req: {A: [1, 1, 1]}\nweights:\n  new: [1, 2, 3]\n", "must be four numbers", "[0.25", line=3),
    paper("unknown key", "task_req: {A: [1, 1, 1]}\ntask_rq: {}\n", "unknown key task_rq", "did you mean task_req?", line=2),
]  # fmt: skip


def import_file(name: str, arguments: str) -> Imported:
    if name.startswith("hosts"):
        return import_ansible(name)
    if name == "task_req.yaml":
        return import_paper(name)
    return import_ros(
        [name],
        dict([arguments.split(":=")]) if arguments else {},
        [],
        by_file=False,
        refuse_exposed=refuse_exposed_files,
    )


def import_broken(case: Broken, directory: Path, monkeypatch: pytest.MonkeyPatch) -> Problem:
    monkeypatch.chdir(directory)
    (directory / case.file).write_text(case.text)
    (directory / "good.launch").write_text(f'<launch><arg name="rate" default="1"/>{NODE}</launch>\n')
    with pytest.raises(InputError) as caught:
        import_file(case.file, case.arguments)
    return caught.value.problems[0]


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.file}: {case.name}")
def test_a_broken_file_is_named_with_its_line(
    case: Broken, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = import_broken(case, tmp_path, monkeypatch)
    assert case.message in problem.message
    assert case.hint in problem.hint
    assert problem.line == case.line
    assert Path(problem.file).name == case.file or not case.line
    if case.at:
        line = case.text.splitlines()[case.line - 1]
        assert line[problem.column - 1 :].startswith(case.at), (problem.column, line)


def test_there_are_enough_broken_files() -> None:
    launch_files = [case for case in CASES if case.file.startswith("bad.")]
    assert len({(case.file, case.name) for case in launch_files}) >= 40


def test_all_mistakes_are_reported_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.launch").write_text(
        '<launch>\n<noed/>\n<node pkg="a"/>\n<group>\n<param name="x"/>\n</group>\n</launch>\n'
    )
    with pytest.raises(InputError) as caught:
        import_file("bad.launch", "")
    assert [problem.line for problem in caught.value.problems] == [2, 3, 5]


def test_a_broken_file_is_an_input_error_with_a_caret(
    tmp_path: Path,
) -> None:
    (tmp_path / "bad.launch").write_text('<launch>\n  <group if="maybe"/>\n</launch>\n')
    said = edgectl(["import", "ros", "bad.launch"], tmp_path, os.environ)
    assert said == (
        64,
        "",
        (
            "error[EC013]: bad.launch:2:14: if must be true or false, not 'maybe'\n"
            '    2 |   <group if="maybe"/>\n'
            "      |              ^^^^^\n"
            "hint: write true, false, 1 or 0\n"
        ),
    )


def test_a_python_file_that_never_ends_is_ended(tmp_path: Path) -> None:
    note = tmp_path / "pid"
    file = tmp_path / "bad.launch.py"
    file.write_text(
        f"import os, time, pathlib\npathlib.Path({str(note)!r}).write_text(str(os.getpid()))\ntime.sleep(60)\n"
    )
    record = run_launch_program(str(file), {}, {}, timeout_s=1.0)
    assert record["fault"]["message"] == "the file did not end within 1 s"
    assert not Path(f"/proc/{note.read_text()}").exists()
