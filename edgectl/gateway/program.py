# SPDX-License-Identifier: Apache-2.0
"""Run one program of the user on a host, without a shell."""

from collections.abc import Sequence

from edgectl.agent.link import protocol
from edgectl.gateway.replies import ProgramReply, decode_reply
from edgectl.model.inventory import Host
from edgectl.transport.agent_client import ask_host
from edgectl.transport.base import Transport

# Time for the agent besides the program.
_MARGIN_S = 10.0


def run_program_on_host(
    transport: Transport, host: Host, argv: Sequence[str], *, timeout: float
) -> ProgramReply:
    """Run ``argv`` on ``host`` as the user of the login; it is killed with its group after ``timeout`` s.

    What it leaves running when it ends before goes on.

    Raises:
        RefusedError: there is no such program.
        HostError: the host did not answer.
    """
    request = {
        "op": protocol.OP_RUN,
        "fleet": host.fleet,
        "host": host.name,
        "argv": list(argv),
        "timeout_s": timeout,
    }
    reply = ask_host(transport, host, request, timeout=timeout + _MARGIN_S, connect_timeout=_MARGIN_S)
    return decode_reply(ProgramReply, reply)
