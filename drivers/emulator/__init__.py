"""A simulated printer on a pseudo-terminal: a process of its own that outlives its agent, as a printer does.

`launch` starts one or finds the one that is alive, `status` is what may be read of it from outside,
`__main__` is the process and `port` its pseudo-terminal. `faults` names what goes wrong on request. The rest
is pure: `firmware` is the board's program (bytes in, bytes out), with somebody at its display; `hardware` is
what is there physically: heaters, a bed, a wire and its noise.
"""
