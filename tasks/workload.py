"""A synthetic task: uses as much CPU, memory and network as its arguments state.

    python3 workload.py --cpu 0.09 --memory 102Mi --rate 1.78MB/s [--peer ADDRESS ..] [--grown 440Mi]

It sends over TCP to a receiver of its own, bound to each peer's address (default: $EDGECTL_ROBOT_HOST;
without one nothing is sent). TERM ends it. USR1 makes its memory grow to --grown, as a map grows. It prints a
line per second. Python >= 3.6, standard library only.
"""

import argparse
import os
import re
import signal
import socket
import sys
import threading
import time
from pathlib import Path

TICK = 0.05
PAGE = 4096
CHUNK = 65536
UNITS = {"": 1, "k": 10**3, "M": 10**6, "G": 10**9, "Ki": 2**10, "Mi": 2**20, "Gi": 2**30}


class Load:
    """Memory to hold, and whether to go on; signals change both."""

    def __init__(self, memory: float, grown: float) -> None:
        self.memory = memory
        self.grown = grown
        self.running = True

    def end(self, _signal: int, _frame: object) -> None:
        """Leave at the next tick."""
        self.running = False

    def grow(self, _signal: int, _frame: object) -> None:
        """Hold more at the next tick."""
        self.memory = self.grown


def quantity(text: str) -> float:
    """Bytes, or bytes per second: 102Mi, 1.78MB/s."""
    match = re.match(r"([0-9.]+)([kMG]?i?)(?:B)?(?:/s)?$", text)
    if match is None:
        raise argparse.ArgumentTypeError("write 102Mi or 1.78MB/s")
    return float(match.group(1)) * UNITS[match.group(2)]


def arguments() -> argparse.Namespace:
    """The parsed command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cpu", type=float, default=0.0, help="cores to use, up to 1")
    parser.add_argument("--memory", type=quantity, default=0.0, help="resident memory of this process")
    parser.add_argument("--grown", type=quantity, default=None, help="resident memory after USR1")
    parser.add_argument("--rate", type=quantity, default=0.0, help="bytes per second to each peer")
    parser.add_argument("--peer", action="append", help="address of a peer, repeatable")
    parser.add_argument("--seconds", type=float, default=None, help="end with success after this long")
    return parser.parse_args()


def say(text: str) -> None:
    """Print a line to the log and flush it."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def resident() -> int:
    """Resident memory of this process in bytes."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE


def hold(wanted: float) -> bytearray:
    """Memory that makes this process as large as wanted; touched, so that it is resident."""
    block = bytearray(max(0, int(wanted) - resident()))
    for position in range(0, len(block), PAGE):
        block[position] = 1
    return block


def receive(listener: socket.socket) -> None:
    """Take in whatever the one sender sends."""
    connection = listener.accept()[0]
    with connection, listener:
        while connection.recv(CHUNK):
            pass


def connected(address: str) -> socket.socket:
    """A connection to a receiver that stands at the peer's address."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.bind((address, 0))
    listener.listen(1)
    threading.Thread(target=receive, args=(listener,), daemon=True).start()
    return socket.create_connection(listener.getsockname(), timeout=5)


def burn(load: Load, until: float, behind: float) -> None:
    """Use the CPU for as long as this tick's share asks, and no longer than the tick."""
    target = time.process_time() + behind
    while load.running and time.process_time() < target and time.monotonic() < until:
        sum(range(500))


def serve(load: Load, peers: list, args: argparse.Namespace) -> None:
    """Tick until told to end: hold the memory, move the bytes, use the rest of the CPU share, sleep."""
    payload = bytes(CHUNK)
    began = second = last = time.monotonic()
    owed_cpu, owed_bytes, used = 0.0, 0.0, time.process_time()
    held, holding = bytearray(), 0.0
    while load.running and (args.seconds is None or time.monotonic() - began < args.seconds):
        if holding != load.memory:
            holding, held = load.memory, hold(load.memory + len(held))
            say(f"holds {resident() >> 20}Mi")
        now = time.monotonic()
        owed_bytes = min(owed_bytes + args.rate * (now - last), args.rate)
        while peers and owed_bytes >= 1 and load.running:
            part = payload[: int(min(owed_bytes, CHUNK))]
            for peer in peers:
                peer.sendall(part)
            owed_bytes -= len(part)
        owed_cpu = min(owed_cpu + args.cpu * (now - last), args.cpu) - (time.process_time() - used)
        used, last = time.process_time(), now
        burn(load, now + TICK, owed_cpu)
        if now - second >= 1.0:
            second = now
            say(f"alive {now - began:.0f}s cpu {args.cpu:.3f} memory {resident() >> 20}Mi peers {len(peers)}")
        time.sleep(max(0.0, now + TICK - time.monotonic()))


def main() -> int:
    """Run until TERM, or for --seconds."""
    args = arguments()
    load = Load(args.memory, args.grown or args.memory)
    signal.signal(signal.SIGTERM, load.end)
    signal.signal(signal.SIGINT, load.end)
    signal.signal(signal.SIGUSR1, load.grow)
    robot = os.environ.get("EDGECTL_ROBOT_HOST")
    addresses = (args.peer or ([robot] if robot else [])) if args.rate else []
    peers = [connected(address) for address in addresses]
    say(f"{os.environ.get('EDGECTL_TASK', 'workload')} on {os.environ.get('EDGECTL_HOST', 'no host')}")
    serve(load, peers, args)
    for peer in peers:
        peer.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
