"""The live view of ``edgectl top -i``. Needs the extra edgectl[tui]; nothing else imports this room before it is asked for."""

from edgectl.tui.run import run_top_view

__all__ = ["run_top_view"]
