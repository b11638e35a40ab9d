"""Operations ``activate`` and ``deactivate``: make an instance active or inactive, proven by its record."""

from ..link.errors import RefusalError
from ..link.fast_json import Document


def activate_task(request: Document) -> Document:
    """Make an inactive instance active."""
    raise RefusalError("unknown-op", "%s cannot be activated yet" % request["task"])


def deactivate_task(request: Document) -> Document:
    """Make an active instance inactive."""
    raise RefusalError("unknown-op", "%s cannot be deactivated yet" % request["task"])
