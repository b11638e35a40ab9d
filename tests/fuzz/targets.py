"""Fuzz targets: every decoder of foreign input, with valid seeds and a reader."""

import contextlib
import hashlib
import json
import random
import re
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from edgectl.agent.link import fast_json
from edgectl.agent.measure import metrics
from edgectl.cli.user_files import refuse_exposed_files
from edgectl.config.documents import load_plan, load_snapshot
from edgectl.config.load import load_inventory_and_tasks
from edgectl.errors import StateError
from edgectl.executor.diff import plan_from_assignment
from edgectl.executor.manager_state_update import update_manager_state
from edgectl.experiments.files import run_codec
from edgectl.experiments.files.experiment_file import load_experiment
from edgectl.experiments.files.map_file import parse_map_metadata
from edgectl.experiments.files.run_directory import load_run, save_run, save_trial
from edgectl.experiments.ssim import MapImage, compute_ssim
from edgectl.formats.document import dump_document
from edgectl.formats.kinds import MANAGER_STATE_KIND, PLAN_KIND
from edgectl.gateway.fanout import HostReply
from edgectl.gateway.fetch import fetch_file
from edgectl.gateway.host_facts import SentRequest, decode_host_facts
from edgectl.gateway.probe_reply import ReplyContext, decode_host_sample
from edgectl.gateway.ros_graph import decode_graph
from edgectl.importers.ros_live import build_live_tasks
from edgectl.importers.yaml_text import render_file
from edgectl.model.inventory import Host, Role
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.plan import Action
from edgectl.model.result import ActionResult, Outcome, Results
from edgectl.model.snapshot import HostSample, LinkSample, TaskSample, TaskState
from edgectl.scheduler.assign import assign
from edgectl.scheduler.claims import describe_claims
from edgectl.state import journal, journal_reader, store_rows
from edgectl.state.manager_state import load_manager_state
from edgectl.state.shared_state import (
    PendingStart,
    SharedState,
    compute_state_digest,
    decode_shared_state,
    encode_shared_state,
)
from edgectl.state.store import Store
from edgectl.state.store_file import HISTORY_FILE_NAME as HISTORY
from edgectl.transport.agent_client import call_agent
from edgectl.transport.base import Exchange, Reply
from edgectl.transport.etcd_client import encode_text
from edgectl.transport.etcd_lease import parse_fleet_keys
from edgectl.usecases.import_files import import_ansible, import_paper, import_ros
from edgectl.views.output import render_view
from edgectl.views.plan import PlanView
from edgectl.views.snapshot import SnapshotView
from edgectl.views.status import StatusView
from edgectl.views.text import PLAIN
from tests import builders
from tests.builders import NOW, a_robot, a_sample, a_snapshot, an_edge, an_inventory, silent, some_tasks
from tests.config.broken_files import INVENTORY, TASKS
from tests.config.test_bad_documents import TEXTS
from tests.experiments.map_images import (
    a_grey_image,
    a_map_image,
    a_map_metadata,
    draw_room,
    encode_pgm,
    encode_png,
)
from tests.experiments.test_experiment_file import EVENTS
from tests.experiments.test_experiment_file import FLEET as SPEC_FLEET
from tests.experiments.test_experiment_file import GOOD as SPEC
from tests.experiments.test_experiment_file import TASKS as SPEC_TASKS
from tests.experiments.test_map_file import ROS1, ROS2
from tests.experiments.test_run_codec import RUN, TRIAL
from tests.formats.test_complete import MANAGER, PLAN
from tests.fuzz.hostile_fleet import run_against_liar
from tests.fuzz.mutate import damage_seed, mutate_seed
from tests.gateway.test_decode import a_document, a_task
from tests.gateway.test_facts import DOCUMENT as FACTS
from tests.gateway.test_ros_graph import DOCUMENT as GRAPH
from tests.importers.test_commands import HOSTS_INI, REQUIREMENTS
from tests.importers.test_launch_files import CORPUS

Read = Callable[[bytes], object]
SECRETS = INVENTORY.replace(
    'env: {ROS_DOMAIN_ID: "7"}', "env: {KEY: {value: x, secret: true}}, env_command: [vault, read]"
)


ETCD_ANSWER = {
    "header": {"cluster_id": "1", "revision": "7"},
    "kvs": [
        {
            "key": encode_text("edgectl/lab/holder"),
            "mod_revision": "6",
            "lease": "75",
            "value": encode_text('{"who": "ana", "every_s": 2.0}'),
        },
        {"key": encode_text("edgectl/lab/id"), "mod_revision": "2", "value": encode_text("0" * 32)},
        {"key": encode_text("edgectl/lab/state"), "mod_revision": "5", "value": encode_text("state")},
    ],
}


@dataclass(frozen=True)
class Target:
    """One decoder. ``read`` returns a value or raises an EdgectlError; anything else is a bug. ``cost``:
    number of plain cases that one of its cases is worth.
    """

    name: str
    seeds: list[bytes]
    read: Read
    cost: int = 1
    damage: Callable[[random.Random, list[bytes]], bytes] = mutate_seed

    def case(self, seed: int, number: int) -> bytes:
        """Return the input of one case: the same for the same seed and number."""
        return self.damage(random.Random(f"{seed}:{self.name}:{number}"), self.seeds)


@contextlib.contextmanager
def build_targets(directory: Path) -> Iterator[list[Target]]:
    """Return all targets; their files are written into ``directory``."""
    good_inventory, good_tasks = directory / "good-inventory", directory / "good-tasks"
    good_inventory.write_text(INVENTORY)
    good_tasks.write_text(TASKS)
    (directory / "world.yaml").touch()
    path = directory / "damaged"
    yield [
        Target("agent document", _build_documents(), _read_as_payload),
        Target(
            "agent frame",
            [b"%s " % MARK, *(_frame_reply(text) for text in _build_documents())],
            _read_as_frame,
        ),
        Target("task's metrics", [METRICS], _read_as_metrics),
        Target("fetched piece", [json.dumps(PIECE).encode()], _read_as_piece),
        Target("doctor's answer", [json.dumps(FACTS).encode()], _read_as_facts),
        Target("graph's answer", [json.dumps(GRAPH).encode()], _read_as_graph),
        Target("snapshot", [TEXTS["snapshot"].encode()], _read_through_file(path, load_snapshot)),
        Target("plan", [TEXTS["plan"].encode()], _read_through_file(path, load_plan)),
        Target(
            "journal",
            _write_journals(directory / "journal"),
            _read_through_file(directory / "journal.jsonl", _read_journal),
        ),
        Target(
            "history",
            [_write_history(directory / "history")],
            _read_through_file(directory / "history" / HISTORY, _read_history),
            cost=20,
            damage=damage_seed,
        ),
        Target(
            "memory",
            [json.dumps(MANAGER_STATE_KIND.encode(MANAGER)).encode()],
            _read_through_file(directory / "memory.json", _read_manager_state),
        ),
        Target("state in etcd", [_encode_shared_state()], _read_as_shared_state),
        Target("answer of etcd", [json.dumps(ETCD_ANSWER).encode()], _read_as_fleet_keys),
        Target(
            "run",
            [_write_run(directory / "run")],
            _read_through_file(directory / "run" / "run.json", lambda file: load_run(file.parent)),
        ),
        Target(
            "trial",
            [json.dumps(run_codec.TRIAL_KIND.encode(TRIAL)).encode()],
            _read_through_file(_write_trial(directory / "trial"), lambda file: load_run(file.parents[1])),
        ),
        Target(
            "experiment",
            [SPEC.encode(), (SPEC + EVENTS).encode()],
            _read_through_file(path, lambda file: load_experiment(file, SPEC_FLEET, SPEC_TASKS)),
        ),
        Target(
            "inventory",
            [INVENTORY.encode(), SECRETS.encode()],
            _read_through_file(path, lambda file: load_inventory_and_tasks(file, good_tasks)),
        ),
        Target(
            "sheet of a map",
            [ROS1.encode(), ROS2.encode()],
            lambda data: parse_map_metadata("map.yaml", data),
        ),
        Target(
            "image of a map", [encode_pgm(draw_room()), encode_png(a_grey_image(draw_room()))], _read_as_map
        ),
        Target(
            "fleet with a liar",
            [b"0"],
            lambda data: run_against_liar(directory / "fleet", data),
            cost=30,
            damage=lambda chance, _seeds: str(chance.random()).encode(),
        ),
        Target(
            "tasks",
            [TASKS.encode()],
            _read_through_file(path, lambda file: load_inventory_and_tasks(good_inventory, file)),
        ),
        *_build_import_targets(directory),
    ]


def _build_import_targets(directory: Path) -> Iterator[Target]:
    """Files of other tools; each is read under a name of its kind."""
    for name, seeds in (
        ("x.launch", ("robots.launch", "rosparam.launch", "eval.launch")),
        ("x.launch.xml", ("params.launch.xml", "conditions.launch.xml")),
        ("x.launch.yaml", ("full.launch.yaml",)),
    ):
        yield Target(
            f"import of {name}",
            [(CORPUS / seed).read_bytes() for seed in seeds],
            _read_through_file(
                directory / name,
                lambda file: import_ros(
                    [str(file)], {}, [str(CORPUS)], by_file=False, refuse_exposed=refuse_exposed_files
                ),
            ),
        )
    hosts = _read_through_file(directory / "hosts", lambda file: import_ansible(str(file)))
    yield Target("import of Ansible", [HOSTS_INI.encode()], hosts)
    paper = _read_through_file(directory / "task_req.yaml", lambda file: import_paper(str(file)))
    yield Target("import of the paper", [REQUIREMENTS.encode()], paper)


def _read_as_map(data: bytes) -> object:
    return compute_ssim(
        MapImage(name="map", data=data, metadata=a_map_metadata()), a_map_image(draw_room(), a_map_metadata())
    )


def _read_through_file(path: Path, read: Callable[[Path], object]) -> Read:
    def from_bytes(data: bytes) -> object:
        path.write_bytes(data)
        return read(path)

    return from_bytes


# -- replies of hosts
# -----------------------------------------------------------------------------------------------------------------

MARK = b"@MARK@"


def _build_documents() -> list[bytes]:
    given_up = a_task(
        state="crashloop",
        last_exit=1,
        log_tail=["one", "two"],
        limits="enforced",
        fields={"command": "0123abcd"},
        metrics={"fps": 29.5, "map/loss": -1e300},
    )
    tasks = {"slam": a_task(), "camera": given_up}
    whole = a_document(tasks=tasks, checks={"slam": {"exit": 0, "timed_out": False, "output": "x"}})
    return [
        json.dumps(document).encode()
        for document in (
            whole,
            whole,
            whole,
            {"error": {"kind": "k", "message": "m", "hint": "h"}},
            {"missing": True},
        )
    ]


def _frame_reply(payload: bytes) -> bytes:
    """Frame a reply as a host sends it, surrounded by noise; the marker of the request is inserted later."""
    return b"Last login: today\r%s %d %s\n%s\r\nbye" % (
        MARK,
        len(payload),
        hashlib.sha256(payload).hexdigest().encode(),
        payload,
    )


class _AnsweringSession:
    """Session to a host that answers every request with one text."""

    python = "python3"

    def __init__(self, answer: bytes) -> None:
        self.answer = answer

    def run(self, command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        asked = re.search(rb"([0-9a-f]{32}) [0-9a-f]{64} [0-9]+ [0-9]+ ", stdin)
        assert asked is not None
        return Reply(stdout=self.answer.replace(MARK, b"\nedgectl-frame " + asked[1]), stderr=b"", status=0)

    def stream(self, command: str, stdin: bytes, *, idle_timeout: float) -> Iterator[bytes]:
        raise NotImplementedError

    def exchange(self, command: str, stdin: bytes, *, timeout: float) -> Exchange:
        raise NotImplementedError

    def close(self) -> None:
        return

    def __enter__(self) -> "_AnsweringSession":
        return self

    def __exit__(self, *exc: object) -> None:
        return


def _read_as_payload(data: bytes) -> object:
    return _read_as_frame(_frame_reply(data))


def _read_as_frame(data: bytes) -> object:
    document = call_agent(_AnsweringSession(data), {"op": "probe", "host": "edge1"}, timeout=1.0)
    sample = decode_host_sample(
        document,
        ReplyContext(host=an_edge("edge1"), answered_at=NOW, robots=("robot1",), checked=frozenset({"slam"})),
    )
    _use_sample(sample)
    return sample


def _use_sample(sample: HostSample) -> None:
    """Go on as a command does: plan, write what is saved, show every form. Nothing that a host sends breaks it."""
    inventory = an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot("robot1"))
    tasks = some_tasks(builders.a_task("slam", robots=["robot1"]), builders.a_task("camera"))
    snapshot = a_snapshot(edge1=sample, edge2=a_sample(), robot1=a_sample(role=Role.ROBOT))
    memory = ManagerState(placements={"slam": Placement(host="edge1", since=NOW)})
    assignment = assign(inventory, tasks, snapshot, memory, tasks.policy, NOW)
    plan = plan_from_assignment(inventory, tasks, snapshot, memory, assignment)
    dump_document(PLAN_KIND.encode(plan)).encode()
    after = update_manager_state(memory, plan, tasks, Results(revision=1, actions=(), seconds=0.0), {}, NOW)
    dump_document(MANAGER_STATE_KIND.encode(after)).encode()
    list(describe_claims(inventory, tasks, snapshot, memory))
    for view in (PlanView(plan), SnapshotView(snapshot), StatusView(snapshot, inventory, tasks)):
        for form in view.formats:
            shown = render_view(view, form, PLAIN).encode().decode()
            assert all(char.isprintable() or char == "\n" for char in shown)


METRICS = b"fps 29.97\nloss 0.03125\nmap/ssim 0.93\n" * 3
PIECE = {"op": "fetch", "size": 3, "mark": "1-2-3", "data": "YWJj"}


def _read_as_metrics(data: bytes) -> object:
    """Pass the output of a task through the agent's parser to the manager's decoder."""
    said = fast_json.loads(fast_json.dumps(metrics.parse_metrics(data)))
    return decode_host_sample(
        json.loads(json.dumps(a_document(tasks={"slam": a_task(metrics=said)}))),
        ReplyContext(host=an_edge("edge1"), answered_at=NOW),
    )


class _AnsweringTransport:
    """Transport to a host that answers every request with one text."""

    def __init__(self, answer: bytes) -> None:
        self.answer = answer

    def connect(self, host: Host, *, timeout: float) -> _AnsweringSession:
        return _AnsweringSession(self.answer)

    def address(self, host: Host) -> str:
        return host.host


def _read_as_piece(data: bytes) -> object:
    return fetch_file(
        _AnsweringTransport(_frame_reply(data)), an_edge("edge1"), builders.a_task(), "map.pgm", timeout=0.2
    )


def _read_as_facts(data: bytes) -> object:
    document = call_agent(
        _AnsweringSession(_frame_reply(data)), {"op": "doctor", "host": "edge1"}, timeout=1.0
    )
    return decode_host_facts(
        document,
        ReplyContext(host=an_edge("edge1"), answered_at=NOW),
        SentRequest(began=NOW, addresses={"robot1": "10.0.0.21"}),
    )


def _read_as_graph(data: bytes) -> object:
    host = an_edge("edge1")
    document = call_agent(
        _AnsweringSession(_frame_reply(data)), {"op": "graph", "host": "edge1"}, timeout=1.0
    )
    graph = decode_graph(HostReply(host=host, document=document, seconds=0.1))
    return render_file(build_live_tasks({"edge1": graph}, "lab", ["robot1"], {})[0])


# -- files of the manager
# ---------------------------------------------------------------------------------------------------------


def _write_journals(directory: Path) -> list[bytes]:
    directory.mkdir()
    with journal.Journal.open(directory, clock=lambda: NOW) as written:
        for revision in (1, 2):
            written.append("begin", revision=revision, plan=f"p{revision}", actions=1)
            written.append(
                "intent", task="slam", action="move", host="edge1", previous_host="edge2", generation=revision
            )
            written.append("phase", task="slam", phase="hold", host="robot1")
            written.append(
                "commit", task="slam", outcome="done", located="edge1", error="", downtime_s=1.5, phases=[]
            )
            written.append("end", revision=revision, interrupted=False)
    return [written.path.read_bytes()]


def _read_journal(path: Path) -> object:
    """Read the journal, and open it as the next apply does: a torn line is cut off, a damaged file set aside
    and a new one started.
    """
    try:
        log = journal_reader.read_journal(path)
        journal.Journal.open(path.parent, clock=lambda: NOW).close()
        assert not journal_reader.read_journal(path).broken
        return log.revision, log.begun, log.applied, log.unfinished, log.held, log.generations
    finally:
        for left in path.parent.glob("journal.jsonl*"):
            left.unlink()


def _write_history(directory: Path) -> bytes:
    directory.mkdir()
    with Store.open(directory) as store:
        for second in range(4):
            tasks = {
                "slam": TaskSample(
                    state=TaskState.READY,
                    started_at=NOW,
                    instance=f"i{second // 2}",
                    spec_hash="s",
                    metrics={"fps": second},
                )
            }
            link = {"robot1": LinkSample(capacity_bytes_per_s=1e7, used_bytes_per_s=1e6, rtt_ms=1.5)}
            store.record_snapshot(
                a_snapshot(taken_at=NOW + second, edge1=a_sample(tasks=tasks, links=link), edge2=silent())
            )
        moved = ActionResult(
            task="slam",
            action=Action.MOVE,
            outcome=Outcome.DONE,
            host="edge1",
            previous_host="edge2",
            downtime_s=1.0,
        )
        store.record_results(PLAN, Results(revision=1, actions=(moved,), seconds=1.0), NOW)
        store.record_plan(PLAN)
    return (directory / HISTORY).read_bytes()


def _read_history(path: Path) -> object:
    """Use the history as the next command does: problems are reported, and a usable history exists
    afterwards.
    """
    said: list[str] = []
    try:
        with Store.open(path.parent, warn=said.append) as store:
            found = (
                store.host_points(),
                store.link_points(),
                store.task_points(limit=2),
                store.handoffs(),
                store.events(),
                store.steady_usages("slam", {"edge1"}, "s", min_age_s=0.0, limit=9),
            )
            store.record_snapshot(a_snapshot(taken_at=NOW + 60, edge9=a_sample()))
            store.prune(NOW + 60)
            store.host_points("edge9")
            list(store.stream(store_rows.METRICS, "metric_samples", "at"))
        if said:
            raise StateError(said[0])
        return found
    finally:
        for left in path.parent.iterdir():
            left.unlink()


def _write_run(directory: Path) -> bytes:
    save_run(directory, RUN)
    return (directory / "run.json").read_bytes()


def _write_trial(directory: Path) -> Path:
    """Return the path of the trial of a valid run."""
    save_run(directory, RUN)
    save_trial(directory, TRIAL)
    (path,) = (directory / "trials").iterdir()
    return path


def _encode_shared_state() -> bytes:
    """The document in etcd, before it is compressed."""
    starts = {"slam": PendingStart(host="edge1", generation=7)}
    return zlib.decompress(encode_shared_state(SharedState(manager=MANAGER, ignored=("i1",), starts=starts)))


def _read_as_shared_state(data: bytes) -> object:
    """What is decoded can be installed."""
    state = decode_shared_state(zlib.compress(data, 1))
    return compute_state_digest(state), encode_shared_state(state)


def _read_as_fleet_keys(data: bytes) -> object:
    try:
        document = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise StateError("not the answer of an etcd") from error
    return parse_fleet_keys(document, "lab")


def _read_manager_state(path: Path) -> object:
    try:
        return load_manager_state(path.parent)
    finally:
        for left in path.parent.glob("memory.json.*"):
            left.unlink()
