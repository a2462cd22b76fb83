"""Network for tests of clusters: frames on the switch, and hosts in network namespaces."""

import random
import subprocess
import sys

import pytest

from hosts import virtual_network
from hosts.virtual_network import Network, Wires, find_obstacle

OBSTACLE = find_obstacle()
MAC_A, MAC_B, BROADCAST = b"\x02aaaaa", b"\x02bbbbb", b"\xff" * 6


def make_frame(destination, sender, text=b""):
    return destination + sender + text


def list_arrivals(wires, now_s=0.0):
    return list(wires.deliver(now_s))


def test_frames_go_to_the_port_where_their_destination_was_last_seen():
    wires = Wires(3, random.Random(1))
    wires.send(make_frame(MAC_B, MAC_A), 0, 0.0)  # the port of B is unknown
    assert list_arrivals(wires) == [(1, make_frame(MAC_B, MAC_A)), (2, make_frame(MAC_B, MAC_A))]
    wires.send(make_frame(MAC_A, MAC_B), 1, 0.0)
    wires.send(make_frame(BROADCAST, MAC_B), 1, 0.0)
    assert list_arrivals(wires) == [
        (0, make_frame(MAC_A, MAC_B)),
        (0, make_frame(BROADCAST, MAC_B)),
        (2, make_frame(BROADCAST, MAC_B)),
    ]


def test_simultaneous_networks_have_different_addresses(monkeypatch):
    lines = "1: farm1n0 inet 198.18.7.1/24 scope global\n2: farm2n0 inet 198.18.8.1/24 scope global\n"
    listing = subprocess.CompletedProcess([], 0, lines)
    monkeypatch.setattr(virtual_network.subprocess, "run", lambda *_, **__: listing)
    monkeypatch.setattr(virtual_network.os, "getpid", lambda: 256 + 7)
    assert virtual_network.find_free_network() == 9


def test_delays_add_up_and_frames_keep_their_order():
    wires = Wires(2, random.Random(1), delays_s={0: 0.3, 1: 0.1})
    wires.send(make_frame(BROADCAST, MAC_A, b"1"), 0, 0.0)
    wires.send(make_frame(BROADCAST, MAC_A, b"2"), 0, 0.0)
    assert wires.compute_wait_s(0.1) == pytest.approx(0.3)
    assert list_arrivals(wires, 0.39) == []
    assert [content[-1:] for _, content in list_arrivals(wires, 0.41)] == [b"1", b"2"]
    assert wires.compute_wait_s(0.5) is None


def test_cut_port_transmits_nothing_and_a_lossy_one_loses_its_share():
    wires = Wires(3, random.Random(1), cut_ports={1}, loss_shares={2: 0.25})
    for _ in range(1000):
        wires.send(make_frame(BROADCAST, MAC_A), 0, 0.0)
    ports = [port for port, _ in list_arrivals(wires)]
    assert set(ports) == {2} and 700 < len(ports) < 800
    wires.send(make_frame(BROADCAST, MAC_B), 1, 0.0)
    assert list_arrivals(wires) == []


CONNECT_SCRIPT = "import socket, sys; socket.create_connection((sys.argv[1], 9), timeout=float(sys.argv[2]))"
TIME_LIMIT_S = 60.0
CUT_TIME_OUT_S = 0.3  # a cut host never answers


@pytest.mark.system
@pytest.mark.skipif(OBSTACLE is not None, reason=str(OBSTACLE))
def test_hosts_reach_each_other_unless_cut_and_end_with_the_network():
    network = Network(["a", "b"])

    def find_connection_error(source, target, time_out_s=TIME_LIMIT_S):
        """Return the error of a connection to a port where nothing listens: refused if the host answers."""
        arguments = [network.get_address(target), str(time_out_s)]
        command = network.make_command(source, [sys.executable, "-S", "-c", CONNECT_SCRIPT, *arguments])
        return subprocess.run(command, capture_output=True, text=True).stderr.splitlines()[-1]

    try:
        assert find_connection_error("a", "b").startswith("ConnectionRefusedError")
        network.set_faults("b", cut=True)
        assert find_connection_error("a", "b", CUT_TIME_OUT_S).startswith("TimeoutError")
        assert find_connection_error("a", "farm").startswith("ConnectionRefusedError")
        network.set_faults("b")
        process = subprocess.Popen(network.make_command("b", ["sleep", "600"]))
        while network.list_pids("b") != [process.pid]:
            assert process.poll() is None
    finally:
        network.close()
    assert process.wait() == -9
