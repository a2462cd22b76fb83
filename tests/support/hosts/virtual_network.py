"""Hosts in network namespaces, connected by a switch process that can lose, delay and cut their traffic.

Linux's netem does the same, but not every kernel has it. The hosts need root; see `find_obstacle`.
"""

import contextlib
import fcntl
import heapq
import json
import os
import random
import select
import shutil
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

_TUN_DEVICE = Path("/dev/net/tun")
_TUNSETIFF, _IFF_TAP, _IFF_NO_PI = 0x400454CA, 0x0002, 0x1000
_MULTICAST_BIT = 0x01  # bit that is set in the first byte of a multicast frame
_FRAME_BYTES = 65536
_NETWORK_PREFIX = "198.18"  # reserved for network tests by RFC 2544


def find_obstacle() -> str | None:
    """Return the reason why this computer cannot run these hosts; None if it can."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    if shutil.which("ip") is None:
        return "network namespaces need the command ip (iproute2)"
    if not os.access(_TUN_DEVICE, os.R_OK | os.W_OK):
        return f"the switch between network namespaces needs {_TUN_DEVICE}"
    probe = f"farm-probe-{os.getpid()}"
    if subprocess.run(["ip", "netns", "add", probe], capture_output=True).returncode:
        return "this computer allows no network namespaces"
    subprocess.run(["ip", "netns", "delete", probe], check=True)
    return None


@dataclass
class Wires:
    """Frames in transit between numbered ports. Pure: time and random numbers are arguments.

    Attributes
    ----------
    loss_shares, delays_s
        Share of frames lost, and seconds of delay, at each faulty port, in both directions.
    cut_ports
        Ports without a connection.
    """

    port_count: int
    rng: random.Random
    loss_shares: dict[int, float] = field(default_factory=dict)
    delays_s: dict[int, float] = field(default_factory=dict)
    cut_ports: set[int] = field(default_factory=set)
    _ports_by_address: dict[bytes, int] = field(default_factory=dict)
    _in_transit: list[tuple[float, int, int, bytes]] = field(default_factory=list)
    _count: int = 0

    def send(self, frame: bytes, port: int, now_s: float) -> None:
        """Send a frame from a port to the destination's port, or to all others if that port is unknown."""
        destination, sender = frame[:6], frame[6:12]
        self._ports_by_address[sender] = port
        port_out = None if destination[0] & _MULTICAST_BIT else self._ports_by_address.get(destination)
        ports_out = [out for out in range(self.port_count) if out != port]
        for out in ports_out if port_out is None else [port_out]:
            if self._lets_pass(port) and self._lets_pass(out):
                due_s = now_s + self.delays_s.get(port, 0.0) + self.delays_s.get(out, 0.0)
                self._count += 1
                heapq.heappush(self._in_transit, (due_s, self._count, out, frame))

    def deliver(self, now_s: float) -> Iterator[tuple[int, bytes]]:
        """Yield the frames that have arrived, with their ports, in order."""
        while self._in_transit and self._in_transit[0][0] <= now_s:
            _, _, port, frame = heapq.heappop(self._in_transit)
            yield port, frame

    def compute_wait_s(self, now_s: float) -> float | None:
        """Return the seconds until the next frame arrives; None if there is none."""
        return max(0.0, self._in_transit[0][0] - now_s) if self._in_transit else None

    def _lets_pass(self, port: int) -> bool:
        return port not in self.cut_ports and self.rng.random() >= self.loss_shares.get(port, 0.0)


class Network:
    """Hosts by name, each in a network namespace; the host ``farm`` is in the namespace of this process.

    The switch removes the namespaces and ends their processes in `close`, and when this process ends.
    """

    def __init__(self, names: Sequence[str], seed: int = 0) -> None:
        self.names, number = ["farm", *names], find_free_network()
        self._namespaces = {name: f"farm-{os.getpid()}-{name}" for name in names}
        self._addresses = {
            name: f"{_NETWORK_PREFIX}.{number}.{1 + index}" for index, name in enumerate(self.names)
        }
        hosts = [[self._addresses[name], self._namespaces.get(name)] for name in self.names]
        self._switch = subprocess.Popen(
            [sys.executable, __file__, json.dumps(hosts), str(seed)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        self._send_order()

    def get_address(self, name: str) -> str:
        """Return the address of a host."""
        return self._addresses[name]

    def make_command(self, name: str, command: Sequence[str]) -> list[str]:
        """Return a command that runs another one on a host, in the same process."""
        return ["ip", "netns", "exec", self._namespaces[name], *command]

    def list_pids(self, name: str) -> list[int]:
        """Return the ids of the processes of a host."""
        command = ["ip", "netns", "pids", self._namespaces[name]]
        return [int(pid) for pid in subprocess.run(command, capture_output=True, check=True).stdout.split()]

    def set_faults(self, *names: str, loss: float = 0.0, delay_s: float = 0.0, cut: bool = False) -> None:
        """Replace the faults of hosts; without a fault, the hosts are repaired."""
        ports = [self.names.index(name) for name in names]
        self._send_order({"ports": ports, "loss": loss, "delay_s": delay_s, "cut": cut})

    def close(self) -> None:
        """End the switch and the remaining processes on the hosts."""
        self._switch.communicate()

    def _send_order(self, order: dict[str, object] | None = None) -> None:
        """Send an order to the switch, and wait for its confirmation."""
        assert self._switch.stdin is not None and self._switch.stdout is not None
        if order is not None:
            self._switch.stdin.write(json.dumps(order).encode() + b"\n")
            self._switch.stdin.flush()
        if not self._switch.stdout.readline():
            raise OSError(f"the switch between namespaces ended ({self._switch.wait()})")


def find_free_network() -> int:
    """Return a third byte for addresses that no other test on this computer uses."""
    result = subprocess.run(["ip", "-o", "-4", "addr"], capture_output=True, text=True, check=True).stdout
    numbers = ((os.getpid() + step) % 256 for step in range(256))
    return next(number for number in numbers if f" {_NETWORK_PREFIX}.{number}.1/" not in result)


def _open_port(number: int, address: str, namespace: str | None) -> int:
    """Make a network interface with an address in a namespace; return its other end."""
    port = os.open(_TUN_DEVICE, os.O_RDWR | os.O_NONBLOCK)
    name = f"farm{os.getppid()}n{number}"
    fcntl.ioctl(port, _TUNSETIFF, struct.pack("16sH22x", name.encode(), _IFF_TAP | _IFF_NO_PI))
    prefix = ["ip"]
    if namespace is not None:
        subprocess.run(["ip", "netns", "add", namespace], check=True)
        subprocess.run(["ip", "link", "set", name, "netns", namespace], check=True)
        prefix = ["ip", "-n", namespace]
        subprocess.run([*prefix, "link", "set", "lo", "up"], check=True)
    subprocess.run([*prefix, "addr", "add", f"{address}/24", "dev", name], check=True)
    subprocess.run([*prefix, "link", "set", name, "up"], check=True)
    return port


def _switch_frames(ports: list[int], rng: random.Random) -> None:
    """Switch frames between the ports and follow orders until the input ends."""
    wires = Wires(len(ports), rng)
    while True:
        ready, _, _ = select.select([0, *ports], [], [], wires.compute_wait_s(time.monotonic()))
        for number, port in enumerate(ports):
            if port in ready:
                with contextlib.suppress(OSError):
                    wires.send(os.read(port, _FRAME_BYTES), number, time.monotonic())
        for number, frame in wires.deliver(time.monotonic()):
            with contextlib.suppress(OSError):  # the queue is full, so the frame is lost
                os.write(ports[number], frame)
        if 0 in ready:
            line = sys.stdin.buffer.raw.readline()  # type: ignore[union-attr]
            if not line:
                return
            order = json.loads(line)
            for number in order["ports"]:
                wires.loss_shares[number], wires.delays_s[number] = order["loss"], order["delay_s"]
                (wires.cut_ports.add if order["cut"] else wires.cut_ports.discard)(number)
            _confirm()


def _confirm() -> None:
    """Report to the other process that the order is executed."""
    sys.stdout.write("done\n")
    sys.stdout.flush()


def _remove_namespace(namespace: str) -> None:
    """End the processes of a namespace, and remove it."""
    pids = subprocess.run(["ip", "netns", "pids", namespace], capture_output=True).stdout.split()
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):
            os.kill(int(pid), signal.SIGKILL)
    subprocess.run(["ip", "netns", "delete", namespace], capture_output=True)


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    hosts = json.loads(sys.argv[1])
    try:
        opened_ports = [
            _open_port(number, address, namespace) for number, (address, namespace) in enumerate(hosts)
        ]
        _confirm()
        _switch_frames(opened_ports, random.Random(int(sys.argv[2])))
    finally:
        for _, host in hosts:
            if host is not None:
                _remove_namespace(host)
