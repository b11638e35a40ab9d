# SPDX-License-Identifier: Apache-2.0
"""Protocol between manager and agent: operations, states, limits, name rules; what both sides run.

Valid for Python 3.6, without imports: the agent loads it on the host, the manager loads the same file. The
keys of the documents are in ``document_keys.py``.
"""

# Version of the documents of OP_PROBE, OP_STATUS, OP_LOGS and OP_DOCTOR (key ``v``).
VERSION = 1

# Operations: key ``op`` of a request.
OP_ACTIVATE = "activate"
OP_ADOPT = "adopt"
OP_CHECK = "check"
OP_CONVERSE = "converse"
OP_COUNTERS = "counters"
OP_DEACTIVATE = "deactivate"
OP_DOCTOR = "doctor"
OP_DROP_STATE = "drop-state"
OP_FETCH = "fetch"
OP_FOLLOW = "follow"
OP_FORGET = "forget"
OP_GRAPH = "graph"
OP_HEAR = "hear"
OP_LEASE = "lease"
OP_LOAD_STATE = "load-state"
OP_LOGS = "logs"
OP_MARK = "mark"
OP_PROBE = "probe"
OP_PROFILER_RUN = "profiler-run"
OP_PROFILER_START = "profiler-start"
OP_PROFILER_STATUS = "profiler-status"
OP_PROFILER_STOP = "profiler-stop"
OP_PULL = "pull"
OP_READINGS = "readings"
OP_READ_STATE = "read-state"
OP_RUN = "run"
OP_SAMPLE_LINK = "sample-link"
OP_SAVE_STATE = "save-state"
OP_SEND = "send"
OP_SINK = "sink"
OP_START = "start"
OP_STATUS = "status"
OP_STOP = "stop"
OP_SUPERVISE = "supervise"
OP_TAKE_OVER = "takeover"
OP_WAIT = "wait"
OP_WRITE_STATE = "write-state"

# Operations that change tasks or robots. While a manager holds the fleet they carry its ``lease``
# (SIGNATURE_KEYS); a probe may carry a claim of it (CLAIM_KEYS).
STATE_OPS = (OP_SAVE_STATE, OP_WRITE_STATE, OP_LOAD_STATE, OP_DROP_STATE)
CHANGING_OPS = (
    *(OP_START, OP_STOP, OP_MARK, OP_CHECK, OP_TAKE_OVER, OP_FORGET),
    *(OP_ACTIVATE, OP_DEACTIVATE),
    *STATE_OPS,
)
# Those among them that may wait for ``go``.
HELD_OPS = (OP_ACTIVATE, OP_DEACTIVATE)
# Those that a conversation carries (`frames.py`): each may be carried out twice without harm.
CONVERSED_OPS = (OP_LEASE, OP_LOGS, OP_PROBE, OP_READINGS, OP_STATUS, OP_WAIT)
# Those that one carries where many are expected: the same one twice is one, and it goes on to its end.
CONVERSED_CHANGES = (OP_MARK, OP_START, OP_STOP)
# A host says at least so often (s) that a reading is as it was.
READING_SAID_S = 4.0
SIGNATURE_KEYS = ("holder", "session", "epoch")
# Name of the record of the lease in the directory of the fleet.
LEASE_FILE = "lease"
CLAIM_KEYS = ("holder", "session", "manager", "revision", "who", "verb", "ttl_s", "watch", "take_over")

# States of a task: key ``state`` of its entry. An entry is never STOPPED: a stopped task is left out.
STARTING = "starting"
RUNNING = "running"
READY = "ready"
UNHEALTHY = "unhealthy"
COMPLETED = "completed"
FAILED = "failed"
CRASHLOOP = "crashloop"
STOPPED = "stopped"
ALIVE_STATES = (STARTING, RUNNING, READY, UNHEALTHY)
FAILED_STATES = (FAILED, CRASHLOOP)
FINAL_STATES = (COMPLETED, FAILED, CRASHLOOP, STOPPED)

# Role of an instance of a task with ``activation``: key ``role`` of its entry; empty without one.
ROLE_ACTIVE, ROLE_STANDBY = "active", "standby"
# States of the replies to OP_ACTIVATE and OP_DEACTIVATE besides these two: without ``go`` nothing was done;
# the command failed, and ``role`` says what the instance counts as now.
NOT_ASKED = "not-asked"
ACTIVATE_FAILED, DEACTIVATE_FAILED = "activate-failed", "deactivate-failed"
# A request that waits for ``go`` prints this word and its marker on a line of its own once it is prepared;
# then the line GO_LINE on its standard input lets it go on.
HELD_WORD, GO_LINE = "edgectl-held", b"go\n"

# ``partial`` of a link and of a task in the reply to OP_PROBE: what its traffic lacks; empty where nothing.
UDP_UNSEEN = "udp unseen"
# The same of a task whose links have counters, and which is in no control group of its own.
UDP_BY_LINK = "udp counted by link only"
# ``source`` of a link there: the bytes of TCP connections, or counters of all protocols.
SOURCE_TCP, SOURCE_COUNTERS = "tcp", "counters"
# ``counters`` there and ``state`` in the reply to OP_COUNTERS: empty without an installation, this, or why
# they cannot be read.
COUNTERS_INSTALLED = "installed"
# The rules of the counters of a fleet: this file says that there is an installation.
COUNTERS_FILE = "/etc/edgectl/counters_%s.nft"

# ``exit`` in the reply to OP_CHECK where the ROS graph was to be asked and nobody could be.
UNKNOWN_EXIT = 2

# States of the replies to OP_START, OP_STOP, OP_PULL and OP_PROFILER_*.
STARTED = "started"
TAKEN_OVER = "taken-over"
ALREADY_RUNNING = "already-running"
NOT_RUNNING = "not-running"
STOP_INCOMPLETE = "stop-incomplete"
PULLED = "pulled"
PRESENT = "present"
PULLING = "pulling"
REPLACED = "replaced"
STALLED = "stalled"

# Obstacle of a disk whose state directory is something else; the manager derives its hint from it.
NO_DIRECTORY = "the path exists and is not a directory"

# The state of a task travels in pieces of so many bytes; the first byte of a chunk of OP_READ_STATE says
# whether the rest of it is compressed. OP_WRITE_STATE has its ``bytes`` after the request.
STATE_PIECE_BYTES = 1 << 20
STATE_PLAIN, STATE_PACKED = b"r", b"z"

# Size of a reply with the noise of a login shell around it.
MAX_REPLY_BYTES = 1 << 20
# Application metrics of one task, and of all tasks of a host: a reply has room for this many.
MAX_TASK_METRICS, MAX_HOST_METRICS = 32, 2048

# The highest generation, in the year 2242 as seconds since 1970. Managers neither believe nor send a higher
# one, so that a host that reports it takes no number away from the others.
MAX_GENERATION = 1 << 33

# Names of hosts, tasks and instances, safe as file names; as a pattern and, without module re, as
# ``is_name``.
MAX_NAME_LENGTH = 63
NAME_PATTERN = "[a-z0-9][a-z0-9._-]{0,62}"
_NAME_FIRST = frozenset("abcdefghijklmnopqrstuvwxyz0123456789")
_NAME_LETTERS = _NAME_FIRST | frozenset("._-")
# Names of application metrics, in the same two ways.
METRIC_NAME_PATTERN = "[A-Za-z_][A-Za-z0-9_.:/-]{0,62}"
_METRIC_FIRST = frozenset("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz_")
_METRIC_LETTERS = _METRIC_FIRST | frozenset("0123456789.:/-")


def is_name(text: object) -> bool:
    """Whether ``text`` is a string that matches NAME_PATTERN."""
    return (
        isinstance(text, str)
        and 0 < len(text) <= MAX_NAME_LENGTH
        and text[0] in _NAME_FIRST
        and _NAME_LETTERS.issuperset(text)
    )


def is_metric_name(text: str) -> bool:
    """Whether ``text`` matches METRIC_NAME_PATTERN."""
    return 0 < len(text) <= MAX_NAME_LENGTH and text[0] in _METRIC_FIRST and _METRIC_LETTERS.issuperset(text)


# Sources the files of its arguments, then becomes the rest of them. It has no text of the user, and what it
# sources sees no arguments: set-up files of ROS 1 take theirs for options.
_SOURCE_FILES = """_edgectl_count=$1; shift
_edgectl_files=("${@:1:_edgectl_count}"); shift "$_edgectl_count"; _edgectl_command=("$@"); set --
for _edgectl_file in "${_edgectl_files[@]}"; do
  case $_edgectl_file in "~/"*) _edgectl_file=$HOME/${_edgectl_file:2};; esac
  [ -r "$_edgectl_file" ] || { echo "edgectl: set-up file $_edgectl_file cannot be read" >&2; exit 126; }
  . "$_edgectl_file"
done
exec "${_edgectl_command[@]}"
"""


def build_sourced_argv(setup: "list[str]", argv: "list[str]") -> "list[str]":
    """Build the argument vector that sources the files and becomes ``argv``; only bash can source them."""
    return ["/bin/bash", "-c", _SOURCE_FILES, "edgectl", str(len(setup)), *setup, *argv]
