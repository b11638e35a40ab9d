"""Detection of hosts that kill users' processes at logout."""

import getpass
from pathlib import Path

import pytest

from edgectl.agent.link.errors import RefusalError
from edgectl.agent.supervise import logind


def test_default_is_no(tmp_path: Path) -> None:
    assert not logind.kills_users_processes(str(tmp_path))
    logind.check_survives_logout(str(tmp_path))


def test_drop_in_wins_and_lingering_helps(tmp_path: Path) -> None:
    folder = tmp_path / "etc" / "systemd"
    (folder / "logind.conf.d").mkdir(parents=True)
    (folder / "logind.conf").write_text("[Login]\n#KillUserProcesses=yes\nKillUserProcesses=no\n")
    assert not logind.kills_users_processes(str(tmp_path))
    (folder / "logind.conf.d" / "kill.conf").write_text("[Login]\nKillUserProcesses = yes\n")
    with pytest.raises(RefusalError) as caught:
        logind.check_survives_logout(str(tmp_path))
    assert "enable-linger" in caught.value.hint
    linger = tmp_path / "var" / "lib" / "systemd" / "linger"
    linger.mkdir(parents=True)
    (linger / getpass.getuser()).touch()
    logind.check_survives_logout(str(tmp_path))
