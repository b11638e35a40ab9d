# SPDX-License-Identifier: Apache-2.0
"""Make an instance active or inactive on its host, at once or prepared and then let go."""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping

from edgectl.agent.link import protocol
from edgectl.errors import ConnectError, HostError, RefusedError
from edgectl.executor import host_requests
from edgectl.executor.action_phases import PlannedPhase
from edgectl.executor.host_requests import Request
from edgectl.executor.step_run import StepRun
from edgectl.model.result import Phase
from edgectl.model.standby import is_standby_entry
from edgectl.model.text import clean_text
from edgectl.state.lock import describe_manager

# Of the text of a reply in a message, characters.
_MAX_DETAIL = 500
_DONE_STATES = {
    protocol.OP_ACTIVATE: protocol.ROLE_ACTIVE,
    protocol.OP_DEACTIVATE: protocol.ROLE_STANDBY,
}


class SwitchError(HostError):
    """The host answered that the instance did not become what was asked for.

    ``active``: it is proven to be active again; ``inactive``: proven to be inactive again.
    """

    def __init__(
        self, message: str, *, hint: str = "", host: str, active: bool = False, inactive: bool = False
    ) -> None:
        super().__init__(message, hint=hint, host=host)
        self.active = active
        self.inactive = inactive


def switch_instance(act: StepRun, planned: PlannedPhase, variables: Mapping[str, str]) -> None:
    """Carry out a phase that activates or deactivates, at once.

    Raises:
        SwitchError: its command failed.
        HostError: the host refused, or its reply is lost.
    """
    body = _fill_request(act, planned, variables)
    with act.phase(planned.phase, planned.host.name):
        _check_answer(act, planned, _ask(act, planned, body))
    _note_active(act, body)


@contextlib.contextmanager
def prepare_switch(
    act: StepRun, planned: PlannedPhase, variables: Mapping[str, str], *, await_go_s: float
) -> Iterator[Callable[[], None]]:
    """Have the host prepare the phase, for ``await_go_s`` at most; what is yielded carries it out.

    The intent is in the journal before: nothing is written between the end of one and the beginning of the
    other instance.

    Raises:
        HostError: the host cannot do it; nothing was touched.
    """
    body, host = _fill_request(act, planned, variables), planned.host
    seconds = planned.requests[0].timeout_s + act.run.options.call_s
    held = {**body, "await_go_s": await_go_s}
    act.run.record("phase", task=act.name, phase=planned.phase.value, host=host.name)
    with act.run.hold(host, held, timeout=seconds) as go_on:

        def carry_out() -> None:
            with act.phase(planned.phase, host.name, side_effect=False):
                _check_answer(act, planned, _go_on_or_ask(act, planned, body, go_on))
            _note_active(act, body)

        yield carry_out


def _go_on_or_ask(
    act: StepRun, planned: PlannedPhase, body: Request, go_on: Callable[[], Request]
) -> Request:
    """Let the prepared request go on; where its session was lost, or it waited too long, ask once more."""
    try:
        answer = go_on()
    except ConnectError:
        try:
            return _ask(act, planned, body)
        except RefusedError as error:
            # The first one may have been carried out, so nobody knows that nothing was done.
            raise HostError(error.message, hint=error.hint, host=planned.host.name) from error
    return _ask(act, planned, body) if answer.get("state") == protocol.NOT_ASKED else answer


def name_instance(planned: PlannedPhase, instance: str) -> PlannedPhase:
    """The phase of an instance that was not known when it was planned."""
    request = planned.requests[0]
    named = dataclasses.replace(request, body={**request.body, "instance": instance})
    return dataclasses.replace(planned, requests=(named,))


def _fill_request(act: StepRun, planned: PlannedPhase, variables: Mapping[str, str]) -> Request:
    request = planned.requests[0]
    # What is restored takes a generation of its own.
    generation = act.generation + (planned.phase is Phase.RESTORE)
    return host_requests.fill_start_request(
        request.body,
        instance=str(request.body["instance"]),
        generation=min(protocol.MAX_GENERATION, generation),
        manager=describe_manager(),
        variables=variables,
    )


def _ask(act: StepRun, planned: PlannedPhase, body: Request) -> Request:
    return act.run.ask(planned.host, body, timeout=planned.requests[0].timeout_s + act.run.options.call_s)


def _check_answer(act: StepRun, planned: PlannedPhase, answer: Request) -> None:
    """Raise what a reply says that is no proof."""
    op, state = str(planned.requests[0].body["op"]), answer.get("state")
    if state == _DONE_STATES[op]:
        return
    what = "deactivated" if op == protocol.OP_DEACTIVATE else "activated"
    why = clean_text(answer.get("detail"), _MAX_DETAIL) or f"its state is {clean_text(state, _MAX_DETAIL)}"
    raise SwitchError(
        f"{act.name} was not {what} on {planned.host.name}: {why}",
        hint=f"edgectl logs {act.name}",
        host=planned.host.name,
        active=answer.get("active_again") is True,
        inactive=is_standby_entry(answer),
    )


def _note_active(act: StepRun, body: Request) -> None:
    """What becomes active counts as started: it is waited for."""
    if body["op"] == protocol.OP_ACTIVATE:
        act.started = str(body["instance"])
