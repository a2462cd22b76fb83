"""Small G-code files of the same square tower in the dialects of several slicers."""

import math

FILAMENT_MM2 = math.pi * 2.85**2 / 4
PURGE_LINES = ["G1 X5 Y5 Z0.3 F3000", "G1 X5 Y100 E15 F1000"]
END_LINES = ["G1 F1500 E-6", "M104 S0", "M140 S0", "M107", "G91", "G1 Z10", "G90", "G28 X0 Y0", "M84"]


class TravelTimeEstimator:
    """Estimator of the time of moves that ignores acceleration."""

    def __init__(self):
        self._position, self._elapsed_s = (5.0, 50.0, 20.0, 0.0), 0.0

    def move(self, x, y, z, e, speed_mm_s):
        position = (x, y, z, e)
        distance_mm = math.dist(self._position[:3], position[:3]) or abs(e - self._position[3])
        self._position, self._elapsed_s = position, self._elapsed_s + distance_mm / speed_mm_s

    def wait(self, seconds):
        self._elapsed_s += seconds

    def measure_time_s(self, finish=False):
        return self._elapsed_s


def make_square(side_mm=20.0, at_mm=100.0, layers=3, layer_mm=0.2, e_per_mm=0.4 * 0.2 / FILAMENT_MM2):
    """Make the layers of a square, each a list of moves (x, y, z, fed filament) in mm; travels feed 0."""
    corners = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]
    path = [(at_mm + side_mm * x, at_mm + side_mm * y) for x, y in corners]
    result = []
    for layer in range(layers):
        z = layer_mm * (layer + 1)
        moves = [(*path[0], z, 0.0)]
        moves += [(*p, z, side_mm * e_per_mm) for p in path[1:]]
        result.append(moves)
    return result


def join_objects(first_object, second_object, travel_z_mm=30.0):
    """Join two objects, with a travel above both of them from the first to the second one."""
    (x, y, *_), *_ = second_object[0]
    return [*first_object, [(x, y, travel_z_mm, 0.0), *second_object[0]], *second_object[1:]]


def make_marlin(layers=None, *, start=None, comments=True, relative=False, tail=None, body=()):
    """Make G-code as Cura writes it for Marlin, with the lines `body` before the second layer."""
    lines = [";FLAVOR:Marlin", "M140 S60", "M104 S205", "M190 S60", "M109 S205", "G28", *PURGE_LINES]
    if not comments:  # as Slic3r does, without a purge line
        lines = ["G28", "M190 S60", "M109 S205"]
    lines = list(lines if start is None else start)
    lines += ["M83" if relative else "M82", "G92 E0"]
    e = 0.0
    for number, layer in enumerate(make_square() if layers is None else layers):
        if number == 1:
            lines += body
        if comments:
            lines.append(f";LAYER:{number}")
        for x, y, z, fed_mm in layer:
            if not fed_mm:
                lines.append(f"G0 F9000 X{x:.3f} Y{y:.3f} Z{z:.3f}")
                continue
            e += fed_mm
            lines.append(f"G1 F1800 X{x:.3f} Y{y:.3f} E{fed_mm if relative else e:.5f}")
    return lines + (END_LINES if tail is None else tail)


def make_ultigcode(layers=None, nozzle="0.4", body=()):
    """Make G-code as Cura writes it for the Ultimaker 2: E in mm3, retractions by G10, no heating."""
    lines = [";FLAVOR:UltiGCode", ";TIME:6666", ";MATERIAL:6666", ";MATERIAL2:0"]
    lines += [f";NOZZLE_DIAMETER:{nozzle}", ";Generated with Cura_SteamEngine 4.13.0", "M82", "G92 E0", "G10"]
    layers = make_square() if layers is None else layers
    lines.append(f";LAYER_COUNT:{len(layers)}")
    e = 0.0
    for number, layer in enumerate(layers):
        if number == 1:
            lines += body
        lines.append(f";LAYER:{number}")
        for x, y, z, fed_mm in layer:
            if not fed_mm:
                lines += [*(["G10"] if number else []), f"G0 F9000 X{x:.3f} Y{y:.3f} Z{z:.3f}", "G11"]
                continue
            e += fed_mm * FILAMENT_MM2
            lines.append(f"G1 F1800 X{x:.3f} Y{y:.3f} E{e:.5f}")
        lines.append(f";TIME_ELAPSED:{10 * number + 10}.0")
    return [*lines, "G10", "M107", ";End of Gcode"]


def encode_lines(lines, end=b"\n"):
    return [line.encode() + end for line in lines]
