"""An Ultimaker 2+ on a pseudo-terminal: a process of its own that outlives its agent, as a printer does.

`launch` starts one or finds the one that is alive, `status` is what may be read of it from outside,
`__main__` is the process and `port` its pseudo-terminal. The rest is pure: `firmware` (bytes in, bytes
out) with its `receiver`, `machine` and `commands` (what a command does), `planner` (how long a move takes),
`thermal` and `board` (what is there physically), `wire` (what bytes take), `wording` (the firmware's own
words); and what goes wrong on request: `faults` (their names), `noise` (a bad cable), `mishaps` (once, at a
line of its own), `person` (somebody at the display).
"""
