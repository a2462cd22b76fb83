"""The program of an emulated board: bytes and the time in, bytes out. Pure.

`firmware` is its main loop, `listener` reads lines, `commands` and `machine` execute them, `reports` answers
queries, `planner` computes the times of moves, `wording` has the messages, `person` acts at the display, and
`dialects` has the differences between firmwares.
"""
