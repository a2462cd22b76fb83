"""Drivers of printers on serial ports: the process that owns a printer, its protocol, and an emulator.

Public interface: the names in the `__init__` of each package; `messages`, `clock`, `discovery` and `errors`,
and the files `locks` and `log_file` of processes. This file imports nothing: the emergency stop must start
quickly.
"""
