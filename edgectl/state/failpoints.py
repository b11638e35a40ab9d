# SPDX-License-Identifier: Apache-2.0
"""Named points of an apply where tests may inject a failure.

A call does nothing unless a hook is installed, which only code of the same process can do: no environment
variable or option arms one.
"""

from collections.abc import Callable

_hooks: list[Callable[[str], None]] = []


def hit_failpoint(point: str) -> None:
    """Mark that the run has reached ``point``."""
    for hook in _hooks:
        hook(point)


def install_hook(hook: Callable[[str], None]) -> Callable[[], None]:
    """Call ``hook`` at each point until the returned function is called."""
    _hooks.append(hook)
    return lambda: _hooks.remove(hook)
