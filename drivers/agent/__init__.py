"""The process that owns one printer's serial port, and goes on printing whatever becomes of the daemon.

`journal` is its memory of prints, `spool` its own copies of their files, `board` the port with link and
session, `server` its socket, `loop` the one select loop over them; `__main__` is the process.
"""
