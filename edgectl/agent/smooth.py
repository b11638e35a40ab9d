"""A smoothed value that forgets by time, not by sample: late and early readings weigh what they stand for."""

ALPHA = 0.3


def weight(seconds: float, period: float) -> float:
    """Weight of a reading that covers ``seconds``: ALPHA for one nominal ``period``, and two halves of it weigh as much as one whole."""
    return 1.0 - (1.0 - ALPHA) ** (seconds / period)


def smoothed(old, new, share: float):
    """``new`` with every number moved from ``old`` by ``share`` of the way; numbers that ``old`` lacks are taken as they are."""
    if isinstance(new, dict):
        before = old if isinstance(old, dict) else {}
        return {name: smoothed(before.get(name), value, share) for name, value in new.items()}
    if new is None or old is None:
        return new
    return old + share * (new - old)
