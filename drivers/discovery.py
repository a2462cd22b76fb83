"""Serial devices on USB, and the check that a pulse of DTR resets a printer's board."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from drivers import messages as m
from drivers.agent import SD_PRINT_REASON, IdleWatch
from drivers.clock import Clock
from drivers.errors import AgentError, DriverError, PortError
from drivers.firmware import Firmware
from drivers.link import BoardConnected, Link, Report, UnknownLine
from drivers.link.dialogue import exchange
from drivers.locks import AGENT_LOCK, acquire_lock
from drivers.ports import Device, Port, identify_device, list_devices, open_port
from drivers.printers import PROFILES
from drivers.records import JOURNAL, Journal
from drivers.remote import AgentClient

SYMLINKS_FOLDER = Path("/dev/serial/by-path")
_BOARD_TIMEOUT_S = 40.0  # wall seconds for the board to answer
_AGENT_TIMEOUT_S = 60.0  # wall seconds for the agent to report the result


@dataclass(frozen=True, slots=True)
class PluggedDevice:
    """Serial device on USB, with its port as written in `fleet.yaml`.

    Attributes
    ----------
    port
        Stable path that names the USB socket, if there is one, else the path of the device.
    device
        Path of the device.
    description
        Description by its maker.
    printer
        Printer of the fleet at this port, if any.
    """

    port: Path
    device: Path
    description: str
    printer: str | None


def list_plugged_devices(
    fleet: Iterable[tuple[str, str]],
    devices: list[Device] | None = None,
    symlinks_folder: Path = SYMLINKS_FOLDER,
) -> list[PluggedDevice]:
    """List all serial devices on USB, without opening them.

    Parameters
    ----------
    fleet
        Name and port of each printer.
    devices, symlinks_folder
        Devices to list (default: all devices of the host), and the folder of symbolic links named after USB
        sockets. Tests replace both.

    Returns
    -------
    list[PluggedDevice]
        The devices, in the order of `devices`.
    """
    printer_by_path = {Path(port).resolve(): name for name, port in fleet if port.startswith("/")}
    symlinks = {path.resolve(): path for path in sorted(symlinks_folder.glob("*"), reverse=True)}
    result = []
    for device in list_devices() if devices is None else devices:
        path = device.path.resolve()
        result.append(
            PluggedDevice(
                symlinks.get(path, device.path), path, device.description, printer_by_path.get(path)
            )
        )
    return result


def verify_reset(
    url: str, folder: Path | None, firmware: Firmware, timeout_s: float = _BOARD_TIMEOUT_S
) -> str:
    """Pulse DTR on the port of an idle printer, and verify that its board restarts.

    Parameters
    ----------
    url
        The port; not in use by an agent, and not simulated.
    folder
        The agent's folder, to whose journal the result is written; None for a printer outside the fleet.
    firmware
        Firmware of the printer.
    timeout_s
        Wall seconds within which the board must answer, before the pulse and after it.

    Returns
    -------
    str
        The printer's model, as reported by its firmware.

    Raises
    ------
    DriverError
        The port is in use, the printer is not idle, or its board did not restart.
    """
    lock = None
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        lock = acquire_lock(folder / AGENT_LOCK)
        if lock is None:
            raise PortError(f"{url}: its agent owns the port: send the request to the agent")
    try:
        port = open_port(url, Path(), Clock(), firmware.baud_rate)
        try:
            _verify_idle(port, url, firmware, timeout_s)
            port.reset()
            identity = _await_restart(port, url, firmware, timeout_s)
        finally:
            port.close()
        if folder is not None:
            journal = Journal(folder / JOURNAL)
            journal.write(time.time(), reset_verified=url, opened=identify_device(url))
    finally:
        if lock is not None:
            os.close(lock)
    return find_model(identity)


def verify_reset_through_agent(folder: Path) -> None:
    """Verify the reset through the agent of this folder, which owns the port.

    Raises
    ------
    DriverError
        The agent refused, or the board did not restart.
    """
    asyncio.run(_request_verification(folder))


async def _request_verification(folder: Path) -> None:
    """Send the request to the agent, and wait for the result. Raises DriverError if the check fails."""
    client = AgentClient(folder)
    try:
        await client.connect()
        reply = await client.request(m.Commission(id=0))
        if reply.error is not None or reply.snapshot is None:
            raise AgentError(reply.error or "its agent has another version: restart it")
        if reply.snapshot.link is not m.LinkState.CONNECTING:
            raise AgentError(reply.snapshot.reason or "its board was not reset")
        is_current = False  # snapshots from before the reply are old
        async with asyncio.timeout(_AGENT_TIMEOUT_S):
            async for snapshot in client.receive_snapshots():
                if snapshot.link is m.LinkState.CONNECTING:
                    is_current = True
                elif is_current and snapshot.reset_verified:
                    return
                elif is_current:
                    raise AgentError(snapshot.reason or "it does not answer")
    except TimeoutError as error:
        raise AgentError(f"its board did not answer in {_AGENT_TIMEOUT_S:g} s") from error
    finally:
        await client.close()


def find_model(identity: bytes) -> str:
    """Return the printer model that sends this banner, or this answer to the identity query.

    Raises
    ------
    DriverError
        No known model matches.
    """
    for profile in PROFILES.values():
        firmware = profile.firmware
        if firmware.version_pattern is None:
            matches = firmware.identity_text in identity and profile.machine_text in identity
        else:
            matches = firmware.read_suffix(identity) == profile.banner_suffix
        if matches:
            return profile.model
    labels = (b"Vers:", b"MACHINE_TYPE:")
    version = next((line for line in identity.split(b"\n") if any(label in line for label in labels)), b"")
    raise DriverError(f"the board restarted, but its firmware version is unknown: {version!r}")


def _verify_idle(port: Port, url: str, firmware: Firmware, timeout_s: float) -> None:
    """Verify that a printer is idle.

    It is idle if opening the port reset its board; otherwise it may be printing from the SD card.
    """
    link, idle_watch = Link(firmware), IdleWatch()
    for now_s, event in exchange(port, link, timeout_s):
        if isinstance(event, BoardConnected):
            if event.has_restarted:
                return
            link.send(now_s, b"M27")
            link.poll_soon(now_s + 0.5)
        elif isinstance(event, UnknownLine):
            idle_watch.judge_answer(event.text)
        elif isinstance(event, Report):
            if idle_watch.is_printing_from_card or not event.targets_off:
                cause = SD_PRINT_REASON if idle_watch.is_printing_from_card else "a heater is on"
                raise PortError(f"{url}: its printer is not idle: {cause}; wait until it is")
            return
    raise PortError(f"{url}: its printer does not report that it is idle; switch it off and on")


def _await_restart(port: Port, url: str, firmware: Firmware, timeout_s: float) -> bytes:
    """Wait until the board restarts; return its banner, or its identity if the banner lacks the model."""
    link, identity = Link(firmware), b""
    for now_s, event in exchange(port, link, timeout_s):
        if isinstance(event, BoardConnected):
            if not event.has_restarted:
                break
            if firmware.version_pattern is not None:
                return event.banner
            link.send(now_s, firmware.identity_query)
            link.poll_soon(now_s + 0.5)
        elif isinstance(event, UnknownLine):
            identity += event.text + b"\n"
        elif isinstance(event, Report):
            return identity
    raise PortError(
        f"{url}: no `start` after a pulse of DTR: check the USB cable. "
        "Without a working reset, the printer prints only while somebody is present"
    )
