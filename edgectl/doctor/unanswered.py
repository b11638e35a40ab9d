"""Hosts that could not be asked: one finding that names the first thing that is wrong."""

from edgectl.model.finding import Finding, Level, NoAnswer
from edgectl.model.inventory import Connection, Host

# HostError.kind -> the check that failed.
_CHECKS = {"connect": "reachability", "deadline": "reachability", "host-key": "host key", "auth": "login", "no-python": "python"}
_INSTALL = "on {name}: sudo apt-get install python3   (3.6 or later)"


def unanswered(host: Host, answer: NoAnswer) -> Finding:
    """The finding of a host that did not answer."""
    check = _CHECKS.get(answer.kind, "agent")
    return Finding(host=host.name, check=check, level=Level.FAILED, message=answer.error, mend=_mend(host, answer))


def _mend(host: Host, answer: NoAnswer) -> str:
    """A command or an edit; where the error knows better than the rule, its own."""
    name = host.name
    by_kind = {
        "connect": f"switch {name} on and see that sshd runs there, or correct its host: ({host.host}) in the inventory",
        "deadline": f"see what keeps it from answering: {_ssh(host)} uptime; a slow link needs: edgectl doctor {name} --timeout 60s",
        "auth": f"let it know your key: {_copy_id(host)}; or name the right one: identity_file: in the inventory",
        "no-python": _INSTALL.format(name=name),
    }
    if answer.kind == "host-key":
        return answer.hint or f"compare the fingerprint, then: edgectl trust {name}"
    return by_kind.get(answer.kind, "") or answer.hint or f"look at what it says: {_ssh(host)} python3 --version"


def _target(host: Host) -> str:
    return f"{host.user}@{host.host}" if host.user else host.host


def _options(host: Host) -> str:
    jump = f" -J {host.proxy_jump}" if host.proxy_jump else ""
    return (f" -p {host.port}" if host.port else "") + (f" -i {host.identity_file}" if host.identity_file else "") + jump


def _ssh(host: Host) -> str:
    """The login by hand."""
    return "" if host.connection is Connection.LOCAL else f"ssh{_options(host)} {_target(host)}"


def _copy_id(host: Host) -> str:
    jump = f" -o ProxyJump={host.proxy_jump}" if host.proxy_jump else ""
    port = f" -p {host.port}" if host.port else ""
    key = f" -i {host.identity_file}" if host.identity_file else ""
    return f"ssh-copy-id{port}{key}{jump} {_target(host)}"
