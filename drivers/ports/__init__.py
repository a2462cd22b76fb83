"""Serial ports of this host and of other hosts; the only package that uses pyserial."""

from drivers.ports.port import NET_PREFIX, NetPort, Port, identify_device, open_port
from drivers.ports.serial_port import Device, SerialPort, list_devices
from drivers.ports.wire_record import RecordedLine, WireRecord

__all__ = [
    "NET_PREFIX",
    "Device",
    "NetPort",
    "Port",
    "RecordedLine",
    "SerialPort",
    "WireRecord",
    "identify_device",
    "list_devices",
    "open_port",
]
