"""Optional packages: imported on demand, with an install hint if missing."""

import contextlib
from collections.abc import Iterator

from edgectl.errors import UsageError


@contextlib.contextmanager
def require_extra(name: str) -> Iterator[None]:
    """Import the packages of the extra ``name`` inside the block.

    Raises:
        UsageError: one of its packages is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing in ("", "edgectl"):
            raise
        raise UsageError(
            f"this needs {missing}, which is not installed",
            hint=f'uv tool install "edgectl[{name}]", or pipx, or pip',
        ) from None
