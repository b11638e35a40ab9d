"""SSH host key that a host shows, beside what is known of it."""

from edgectl.dataclass import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class HostKeyReport:
    """Type and SHA256 fingerprint of the key of ``host``; ``state``: known, unknown, changed, revoked,
    or no answer; with the ``error`` and its ``hint`` where it cannot be recorded.
    """

    host: str
    key_type: str = ""
    fingerprint: str = ""
    state: str = ""
    error: str = ""
    hint: str = ""
