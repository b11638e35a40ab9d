"""The live view of ``edgectl top -i``. Needs the extra edgectl[tui]; nothing else imports this room before it is asked for."""

from edgectl.tui.run import run

__all__ = ["run"]
