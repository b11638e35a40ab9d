# SPDX-License-Identifier: Apache-2.0
"""Special cases of the user's own ssh program; the rest is in test_ssh, for both transports."""

from pathlib import Path

import pytest

from edgectl.errors import AuthError, ConnectError
from edgectl.model.inventory import Connection
from edgectl.transport.openssh import FIXED_OPTIONS, OpenSshTransport
from tests.pace import patience
from tests.sshd import Lab


def test_settings_of_the_user_that_would_spoil_a_session(lab: Lab, tmp_path: Path) -> None:
    """Each of these settings would print, hang, hide errors or leave something behind."""
    canary = tmp_path / "canary"
    lab.write_files(
        "RequestTTY force",
        "RemoteCommand echo something else",
        f"LocalForward {tmp_path}/forwarded 127.0.0.1:9",
        f"LocalCommand touch {canary}",
        "PermitLocalCommand yes",
        "ControlMaster auto",
        f"ControlPath {tmp_path}/master",
        "ControlPersist 60",
        "ForwardAgent yes",
        "ForwardX11 yes",
        "LogLevel QUIET",
        "VisualHostKey yes",
        "BatchMode no",
    )
    transport = OpenSshTransport()
    with transport.connect(lab.host("edge1", connection=Connection.OPENSSH), timeout=patience(10)) as session:
        assert (
            session.run("printf '\\377\\n'; tty; exit 0", b"", timeout=patience(30)).stdout
            == b"\xff\nnot a tty\n"
        )
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ConnectError, match="connection refused"):
        transport.connect(lab.host("edge1", port=1), timeout=patience(10)).run(
            "true", b"", timeout=patience(20)
        )


def test_nothing_of_the_manager_goes_along(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    """ssh_config asks for X11, delegated credentials and variables; the host gets none of them."""
    lab.write_files(
        "ForwardX11 yes",
        "GSSAPIDelegateCredentials yes",
        "SendEnv EDGECTL_CANARY_A EDGECTL_CANARY_*",
        "SendEnv HOME",
    )
    monkeypatch.setenv("EDGECTL_CANARY_A", "secret")
    monkeypatch.setenv("EDGECTL_CANARY_B", "secret")
    session = OpenSshTransport().connect(
        lab.host("edge1", connection=Connection.OPENSSH), timeout=patience(10)
    )
    said = session.run('env | grep -c EDGECTL_CANARY; echo "$DISPLAY"', b"", timeout=patience(30))
    assert said.stdout == b"0\n\n"
    assert b"".join(session.stream("env", b"", idle_timeout=patience(30))).count(b"CANARY") == 0
    assert {FIXED_OPTIONS["ForwardX11"], FIXED_OPTIONS["GSSAPIDelegateCredentials"]} == {"no"}


def test_address(lab: Lab) -> None:
    assert OpenSshTransport().address(lab.host("edge2")) == lab["edge2"].address


def test_passwords_are_not_for_it(lab: Lab) -> None:
    with pytest.raises(AuthError, match="keys only"):
        OpenSshTransport().connect(lab.host("edge1", password_command=("echo", "x")), timeout=patience(20))


def test_without_an_ssh_program(lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ConnectError, match="no ssh program"):
        OpenSshTransport().connect(lab.host("edge1"), timeout=patience(20))


def test_exit_statuses_are_the_commands_own(lab: Lab) -> None:
    with OpenSshTransport().connect(lab.host("edge1"), timeout=patience(20)) as session:
        assert [
            session.run(f"exit {status}", b"", timeout=patience(20)).status for status in (0, 1, 127)
        ] == [
            0,
            1,
            127,
        ]
