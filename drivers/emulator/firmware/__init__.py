"""The program of an emulated board: bytes and the time in, bytes out. Pure.

`firmware` is its main loop, `listener` and `receiver` take lines in, `commands` and `machine` carry them out,
`planner` says how long moves take, `wording` has the words, `person` is somebody at the display.
"""
