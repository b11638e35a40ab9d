# SPDX-License-Identifier: Apache-2.0
"""Detection of hosts that kill users' processes at logout."""

import getpass
import os
import subprocess
import sys
from pathlib import Path

import pytest

from edgectl.agent.link.errors import RefusalError
from edgectl.agent.supervise import logind
from tests.pace import patience


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


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_a_uid_without_a_name_is_named_by_its_number() -> None:
    """Containers run as such: on the host and on the manager."""
    program = (
        "import os\nfrom edgectl.agent.supervise import logind\nfrom edgectl.state.lock import get_user_name\n"
        "from edgectl.transport import ssh_config\nos.setuid(4242)\nlogind.check_survives_logout()\n"
        "print(get_user_name(), ssh_config.get_user_name(), ssh_config.get_home_dir())\n"
    )
    words = [sys.executable, "-c", program]
    done = subprocess.run(
        words, env={"HOME": "/h"}, capture_output=True, text=True, timeout=patience(60), check=False, cwd="/"
    )
    assert (done.stdout, done.stderr) == ("4242 4242 /h\n", "")
