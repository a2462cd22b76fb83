"""Simulated printer on a pseudo-terminal: a separate process that outlives its agent, as a printer does.

`launch` starts an emulator or finds the running one, `status` is its published state, `__main__` is the
process and `port` its pseudo-terminal. `faults` lists the faults that can be injected. The rest is pure:
`firmware` is the board's program (bytes in, bytes out) and the person at its display; `hardware` has the
heaters, the bed, the wire and its noise.
"""
