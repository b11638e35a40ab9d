"""The figures of docs/concepts/quality.md: ``make quality``; some minutes."""

from tests.quality.measures import (
    count_losing_fleets,
    count_proven_fleets,
    count_short_fleets,
    measure_shortfalls,
)


def print_figures() -> None:
    """Print one line per figure, as soon as it is known."""
    for edges, tasks, fleets in ((5, 20, 100), (10, 50, 60)):
        short = count_short_fleets(edges, tasks, range(fleets))
        print(
            f"{edges} x {tasks}, 88 to 95 % full: {short} of {fleets} fleets leave a task unplaced",
            flush=True,
        )
    for fill in (0.6, 0.75, 0.9):
        lost = count_losing_fleets(5, 20, range(100), fill)
        print(f"5 x 20, {fill:.0%} full, one edge 10 % larger: {lost} of 100 leave more unplaced", flush=True)
    for edges, tasks, fleets in ((5, 20, 20), (10, 50, 6)):
        plain, rebalanced, gap, proven = measure_shortfalls(edges, tasks, range(fleets), 0.7, 60.0)
        for name, found in (("plain", plain), ("--rebalance", rebalanced)):
            print(
                f"{edges} x {tasks}, 70 % full, {name}: below the best {found.mean:.1%} on average, "
                f"{found.most:.1%} at most; up to {found.seconds:.3f} s",
                flush=True,
            )
        print(f"{edges} x {tasks}, 70 % full, --optimal: {proven} proven; mean gap {gap:.2%}", flush=True)
    for fill in (0.6, 0.75):
        proven = count_proven_fleets(50, 200, range(20), fill, 20, 10.0)
        print(f"50 x 200, {fill:.0%} full, 20 newcomers: {proven} of 20 proven in both levels", flush=True)


if __name__ == "__main__":
    print_figures()
