# SPDX-License-Identifier: Apache-2.0
"""Child process that evaluates one launch file: JSON on standard input, JSON on standard output.

What the file itself prints goes to standard error.
"""

import json
import os
import resource
import sys
import traceback
from typing import Any

MAX_MEMORY_BYTES = 2**30
MAX_CPU_S = 10


def main() -> None:
    """Evaluate the file of the request and write what it starts, or what is wrong with it."""
    out = os.dup(1)
    os.dup2(2, 1)
    request = json.load(sys.stdin)
    here = os.path.dirname(os.path.abspath(__file__))  # noqa: PTH100, PTH120 - pathlib costs 10 ms here
    sys.path[:0] = [here]
    sys.path += [request["root"], *request["path"]]
    sys.dont_write_bytecode = True
    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY_BYTES, MAX_MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (MAX_CPU_S, MAX_CPU_S))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    reply = json.dumps(evaluate_request(request)).encode()
    with os.fdopen(out, "wb") as stream:
        stream.write(reply)
        stream.flush()
    os._exit(0)


def evaluate_request(request: dict[str, Any]) -> dict[str, Any]:
    """What the file starts, or its fault with its place."""
    import _edgectl_recorder as recorder

    context = recorder.CONTEXT = recorder.Context(
        request["arguments"], request["packages"], runs_exposed=request["runs_exposed"]
    )
    try:
        recorder.evaluate(recorder.load_description(context, request["file"], (request["file"], 1)), context)
    except recorder.LaunchError as error:
        return describe_fault(error.message, error.place, error.hint)
    except SyntaxError as error:
        return describe_fault(
            f"not Python: {error.msg}", (error.filename or request["file"], error.lineno or 1)
        )
    except BaseException as error:
        return describe_failure(error, request["file"])
    return {"processes": context.processes, "notes": context.notes, "declared": context.declared}


def describe_fault(message: str, place: tuple[str, int], hint: str = "") -> dict[str, Any]:
    """A fault as it is sent."""
    return {"fault": {"message": message, "file": place[0], "line": place[1], "hint": hint}}


def describe_failure(error: BaseException, file: str) -> dict[str, Any]:
    """An exception of the file, at the innermost line that is not of a library."""
    own = os.path.dirname(file)  # noqa: PTH120
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename.startswith(own)]
    place = (frames[-1].filename, frames[-1].lineno or 1) if frames else (file, 1)
    if isinstance(error, ModuleNotFoundError):
        hint = "import with --group file, or add its directory to PYTHONPATH"
        return describe_fault(f"the module {error.name} is not on this machine", place, hint)
    text = str(error).partition("\n")[0]
    return describe_fault(f"{type(error).__name__}: {text}" if text else type(error).__name__, place)


if __name__ == "__main__":
    main()
