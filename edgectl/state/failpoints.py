"""Named moments of an apply (RELIABILITY section 6). Each call does nothing; a test harness may install a hook.

No environment variable and no option can arm a hook: only code in the same process.
"""

from collections.abc import Callable

_hooks: list[Callable[[str], None]] = []


def hit_failpoint(point: str) -> None:
    """Say that the run has come to ``point``."""
    for hook in _hooks:
        hook(point)


def install_hook(hook: Callable[[str], None]) -> Callable[[], None]:
    """Call ``hook`` at each point until the returned function is called."""
    _hooks.append(hook)
    return lambda: _hooks.remove(hook)
