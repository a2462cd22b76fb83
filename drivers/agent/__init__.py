"""The process that owns one printer's serial port, and goes on printing whatever becomes of the daemon.

`journal` is its memory of prints, `record` keeps that in step with the board, `spool` has the files; `board`
is the port with link and session, `idle` what it watches for without one; `server` is its socket, `loop` the
one select loop over them, `inhibit` what keeps the host up; `__main__` is the process.
"""
