"""Who gets how much of something that is shared: a processor or a link."""

from collections.abc import Mapping


def fair(capacity: float, wanted: Mapping[str, float]) -> dict[str, float]:
    """Max-min fair shares: nobody gets more than wanted, nobody who wants more gets less than another, nothing is left while one wants.

    This is processor sharing, as a kernel's fair scheduler or flows on one bottleneck come close to it. ``capacity`` and ``wanted`` >= 0,
    in one unit.
    """
    shares = dict.fromkeys(wanted, 0.0)
    left, hungry = capacity, sorted(wanted, key=lambda name: (wanted[name], name))
    while hungry:
        share = left / len(hungry)
        name = hungry[0]
        if wanted[name] >= share:
            return shares | dict.fromkeys(hungry, share)
        shares[name] = wanted[name]
        left -= wanted[name]
        hungry.pop(0)
    return shares
