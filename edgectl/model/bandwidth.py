"""What links were measured to carry by sending over them."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """What one link carried in bytes/s; None with the ``error`` where it could not be measured."""

    edge: str
    robot: str
    bytes_per_s: float | None
    error: str = ""
