"""The same call to many hosts at once."""

import queue
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

Item = TypeVar("Item")
Value = TypeVar("Value")


def fan_out(
    function: Callable[[Item], Value], items: Sequence[Item], *, workers: int
) -> Iterator[tuple[int, Value]]:
    """Yield (position, value) as each call ends; at most ``workers`` run at once. ``function`` must not raise what is not a bug.

    The threads are daemons, so that Ctrl-C need not wait for a host that hangs.
    """
    waiting: queue.SimpleQueue[int | None] = queue.SimpleQueue()
    ended: queue.SimpleQueue[tuple[int, Value | None, BaseException | None]] = queue.SimpleQueue()

    def work() -> None:
        while (position := waiting.get()) is not None:
            try:
                ended.put((position, function(items[position]), None))
            except BaseException as error:  # handed to the caller's thread
                ended.put((position, None, error))

    count = min(workers, len(items))
    for position in (*range(len(items)), *[None] * count):
        waiting.put(position)
    for _ in range(count):
        threading.Thread(target=work, daemon=True).start()
    for _ in items:
        position, value, error = ended.get()
        if error is not None:
            raise error
        yield position, value  # type: ignore[misc]
