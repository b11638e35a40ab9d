# SPDX-License-Identifier: Apache-2.0
"""Gap of a move as the robot hears it: a watcher there begins before the old instance stops.

The watch is a measurement: whatever fails about it is said in the result, and the move goes on.
"""

import contextlib
import time

from edgectl.dataclass import dataclass
from edgectl.errors import EdgectlError, HostError
from edgectl.executor.host_requests import build_hear_request
from edgectl.executor.step_run import StepRun
from edgectl.model.inventory import Host
from edgectl.model.latency import HeardRule
from edgectl.model.result import Outcome, Phase
from edgectl.model.task import Task
from edgectl.model.text import clean_text

# How long the robot may take until it hears the old instance: a listener has to find its graph first.
_FIRST_S = 5.0
_MAX_DETAIL = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class GapWatch:
    """A watcher on the robot ``host``; its ``name`` is of this action alone."""

    act: StepRun
    task: Task
    rule: HeardRule
    host: Host
    name: str

    def end(self, outcome: Outcome) -> float | None:
        """End the watcher; the gap in seconds, None where it is not known."""
        if outcome is not Outcome.DONE:
            with contextlib.suppress(EdgectlError):
                self.ask("end", timeout_s=0.0)
            return None
        with (
            contextlib.suppress(HostError),
            self.act.phase(Phase.HEARD, self.host.name, side_effect=False) as remarks,
        ):
            answer = self.ask("end", timeout_s=self.rule.within)
            if answer.get("heard") is True:
                seconds = answer.get("silence_s")
                return float(seconds) if isinstance(seconds, int | float) else None
            remarks.append(_describe_silence(answer, self.rule))
        return None

    def ask(self, action: str, *, timeout_s: float) -> dict[str, object]:
        """Ask the watcher to begin or to end."""
        run, silent_since = self.act.run, self.act.old_ended
        after_s = 0.0 if silent_since is None else time.monotonic() - silent_since
        body = build_hear_request(
            self.task,
            self.rule,
            self.host,
            run.hosts,
            watch=self.name,
            action=action,
            after_s=after_s,
            timeout_s=timeout_s,
        )
        return run.ask(self.host, body, timeout=timeout_s + run.options.call_s)


def begin_gap_watch(act: StepRun, task: Task) -> None:
    """Begin to watch on the task's first robot that is probed, where the task states how it is heard."""
    host = next(
        (act.run.hosts[name] for name in task.robots if name in act.run.hosts and act.run.hosts[name].probe),
        None,
    )
    if task.heard is None or host is None:
        return
    name = act.instance(act.step.decision.host or "")
    watch = GapWatch(act=act, task=task, rule=task.heard, host=host, name=name)
    with contextlib.suppress(HostError), act.phase(Phase.HEARD, host.name, side_effect=False) as remarks:
        answer = watch.ask("begin", timeout_s=min(task.heard.within, _FIRST_S))
        if answer.get("heard") is True:
            act.end_gap_watch = watch.end
        else:
            remarks.append(f"the old instance is not heard: {_describe_silence(answer, task.heard)}")
            watch.end(Outcome.SKIPPED)


def _describe_silence(answer: dict[str, object], rule: HeardRule) -> str:
    why = clean_text(answer.get("detail"), _MAX_DETAIL)
    what = f"topic {rule.topic}" if rule.topic else "the command"
    return "gap not known: " + (why or f"{what} was not heard in time")
