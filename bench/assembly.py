"""Assembly of parts by their shapes and the page of instructions alone, as a person would assemble them.

Holes and codes are read from the STL files of the parts (`bench.connectors.part_reader`), and the page is
read as text. In each step, two bodies are joined at the faces that have the codes of the step, in every way
in which the pins fit. The result is compared with the report of the decomposition. Then each body is tried at
the faces of every other step, where it must not fit.

Usage: python -m bench.assembly FOLDER... [--json]

Each FOLDER was written by `farm decompose --pins filament --marks`.
"""

from __future__ import annotations

import argparse
import html
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import permutations, product
from pathlib import Path

import numpy as np

from bench.connectors.part_reader import CodedFace, read_part
from decompose.arrays import Bools, Floats
from decompose.files.names import INSTRUCTIONS, REPORT, find_part_number

PLAY_MM = 0.7  # maximum distance between two holes that one pin joins, slots included
COPLANAR_TOLERANCE_MM = 0.3  # maximum offset between faces in one plane
MIN_COSINE = 0.99  # minimum cosine of the angle between arrows, or normals, that agree
MAX_ERROR_MM, MAX_ROTATION_ERROR = 1.5, 0.05  # of the translation and the rotation of a correct placement


PlacedFace = tuple[CodedFace, str, Floats, Floats]
"""Face, number of its part, and rotation and translation of the part."""


@dataclass(frozen=True, slots=True)
class PageStep:
    """Step of the page: parts, codes, parts with a face without a code, and the lengths of pins and keys."""

    moved_parts: tuple[str, ...]
    fixed_parts: tuple[str, ...]
    codes: tuple[tuple[str, str], ...]
    blank_parts: tuple[str, ...]
    pins_mm: tuple[float, ...]
    keys_mm: tuple[float, ...]

    @property
    def is_located(self) -> bool:
        """True if the step has at least two pins or keys."""
        return len(self.pins_mm) + len(self.keys_mm) > 1


@dataclass(frozen=True, slots=True, eq=False)
class MatingFace:
    """Glued face of a body: holes and grooves (n, 3), their reaches (see `Hole`), normals and arrows."""

    positions_mm: Floats
    reaches_mm: Floats
    normals: Floats
    arrows: dict[str, Floats]
    is_groove: Bools


@dataclass(slots=True)
class Outcome:
    """Outcome of a job: numbers of steps assembled correctly, wrongly, in several ways, or not at all.

    Steps with fewer than two pins are not assembled.

    Attributes
    ----------
    misread
        Codes of the page that were not found on their parts.
    wrong_fits
        Pairs of bodies of different steps that fit each other with all their pins, codes ignored.
    least_gap_mm
        Smallest gap that remains in a joint if its long pin goes into a short hole.
    """

    folder: str
    steps: int = 0
    correct: int = 0
    wrong: int = 0
    ambiguous: int = 0
    unsolved: int = 0
    without_pins: int = 0
    misread: int = 0
    wrong_fits: int = 0
    least_gap_mm: float = float("inf")


def read_page(page: str) -> tuple[float, list[PageStep]]:
    """Read the diameter of the pins and the steps from the page."""
    diameter = re.search(r"pins of ([\d.]+) mm, from", page)
    steps = []
    for section in re.findall(r'<section class="step".*?</section>', page, re.S):
        bodies = re.search(r"Glue <strong>(.*?)</strong> onto <strong>(.*?)</strong>", section)
        codes = re.findall(r'class="mark"[^>]*>([^<]*)</span> on ([0-9A-Za-z]+)', section)
        blank = ", ".join(re.findall(r"no mark on ([0-9A-Za-z, ]+)<", section))
        dot_parts = [part for text, part in codes if "-" not in text]
        pins = re.findall(r">pin ([\d.]+) mm<", section)
        keys = re.findall(r">key ([\d.]+) × [\d.]+ mm<", section)
        moved_parts, fixed_parts = (
            (tuple(name.split(", ")) for name in bodies.groups()) if bodies else ((), ())
        )
        part_codes = ((part, html.unescape(text).removesuffix(" ↑")) for text, part in codes)
        blank_parts = (*filter(None, blank.split(", ")), *dot_parts)
        lengths_mm = tuple(map(float, pins)), tuple(map(float, keys))
        steps.append(PageStep(moved_parts, fixed_parts, tuple(part_codes), blank_parts, *lengths_mm))
    return float(diameter[1]) if diameter else 0.0, steps


def assemble(folder: Path) -> Outcome:
    """Assemble the parts of a folder according to its page, and judge each step by the folder's report."""
    pin_mm, steps = read_page((folder / INSTRUCTIONS).read_text(encoding="utf-8"))
    true_poses = {
        part["id"]: np.array(part["to_model"]) for part in json.loads((folder / REPORT).read_text())["parts"]
    }
    numbers = {part: find_part_number(part) for part in true_poses}
    faces = {
        part: read_part(folder / f"{part}.stl", number, set(numbers.values()) - {number}, pin_mm)
        for part, number in numbers.items()
    }
    outcome = Outcome(folder.name, steps=len(steps))
    poses = {part: np.eye(4) for part in true_poses}  # pose of each part in the frame of its body
    face_pairs: list[tuple[MatingFace, MatingFace]] = []
    for step in steps:
        lettered_codes = [(part, text) for part, text in step.codes if "-" in text]
        read_codes = {
            (numbers[part], text) for part in true_poses for face in faces[part] for text in face.codes
        }
        outcome.misread += sum(code not in read_codes for code in lettered_codes)
        fixed_face, moved_face = (
            find_mating_face(body, step, faces, poses, numbers)
            for body in (step.fixed_parts, step.moved_parts)
        )
        has_pins = step.is_located
        placements = (
            list(find_placements(fixed_face, moved_face, step.pins_mm, step.keys_mm)) if has_pins else []
        )
        true_placement = find_true_placement(step, true_poses, poses)
        if not has_pins:
            outcome.without_pins += 1
        elif not placements:
            outcome.unsolved += 1
        elif len(placements) > 1:
            outcome.ambiguous += 1
        elif are_different(placements[0], true_placement):
            outcome.wrong += 1
        else:
            outcome.correct += 1
        if has_pins:
            face_pairs.append((fixed_face, moved_face))
            outcome.least_gap_mm = min(
                outcome.least_gap_mm, measure_gap_mm(fixed_face, moved_face, step.pins_mm)
            )
        placement = placements[0] if len(placements) == 1 else true_placement
        for part in step.moved_parts:
            poses[part] = placement @ poses[part]
    outcome.wrong_fits = sum(
        any(True for _ in find_placements(fixed_face, moved_face, None))
        for (a, (fixed_face, _)), (b, (_, moved_face)) in product(enumerate(face_pairs), repeat=2)
        if a != b
    )
    return outcome


def find_mating_face(
    body: Sequence[str],
    step: PageStep,
    faces: dict[str, list[CodedFace]],
    poses: dict[str, Floats],
    numbers: dict[str, str],
) -> MatingFace:
    """Find the glued face of a body: its faces that carry the codes of a step, or are coplanar with one."""
    own_numbers = {numbers[part] for part in body}
    step_codes = {(part, text) for part, text in step.codes if part in own_numbers}
    placed_faces = [
        (face, numbers[part], poses[part][:3, :3], poses[part][:3, 3])
        for part in body
        for face in faces[part]
    ]
    planes = [
        compute_plane(face, rotation, translation)
        for face, number, rotation, translation in placed_faces
        if any((number, text) in step_codes for text in face.codes)
        or (face.holes and number in step.blank_parts)
    ]
    coplanar_faces = [
        (face, number, rotation, translation)
        for face, number, rotation, translation in placed_faces
        for plane in [compute_plane(face, rotation, translation)]
        if any(
            plane[:3] @ other[:3] > MIN_COSINE and abs(plane[3] - other[3]) < COPLANAR_TOLERANCE_MM
            for other in planes
        )
    ]
    holes = list_open_holes(coplanar_faces, placed_faces)
    arrows = {
        "-".join(sorted((number, text.split("-")[1]))): rotation @ arrow
        for face, number, rotation, _ in coplanar_faces
        for text, arrow in face.codes.items()
        if arrow is not None and (number, text) in step_codes
    }
    return MatingFace(
        np.array([position_mm for position_mm, _, _, _ in holes]).reshape(-1, 3),
        np.array([reach_mm for _, reach_mm, _, _ in holes]),
        np.array([normal for _, _, normal, _ in holes]).reshape(-1, 3),
        arrows,
        np.array([is_groove for _, _, _, is_groove in holes], dtype=np.bool_),
    )


def list_open_holes(
    faces: Sequence[PlacedFace], body: Sequence[PlacedFace]
) -> list[tuple[Floats, float, Floats, bool]]:
    """List the holes of faces, except those in joints that are already closed.

    The result has the position, reach, normal and kind of each hole.
    """
    openings = [
        (rotation @ hole.position_mm + translation, rotation @ face.normal)
        for face, _, rotation, translation in body
        for hole in face.holes
    ]

    def is_open(position_mm: Floats, normal: Floats) -> bool:
        return not any(
            np.linalg.norm(position_mm - other_mm) < PLAY_MM and normal @ other_normal < -MIN_COSINE
            for other_mm, other_normal in openings
        )

    return [
        (rotation @ hole.position_mm + translation, hole.reach_mm, rotation @ face.normal, hole.is_groove)
        for face, _, rotation, translation in faces
        for hole in face.holes
        if is_open(rotation @ hole.position_mm + translation, rotation @ face.normal)
    ]


def compute_plane(face: CodedFace, rotation: Floats, translation: Floats) -> Floats:
    """Compute the plane (4,), normal and offset, of a face of a part that is rotated and translated."""
    normal = rotation @ face.normal
    return np.append(normal, face.offset_mm + float(normal @ translation))


def find_placements(
    fixed_face: MatingFace,
    moved_face: MatingFace,
    pins_mm: Sequence[float] | None,
    keys_mm: Sequence[float] = (),
) -> Iterator[Floats]:
    """Find all placements (4, 4) of a body against another in which the pins go into their holes.

    Parameters
    ----------
    fixed_face, moved_face
        Glued faces of the two bodies.
    pins_mm
        Lengths of the pins; None for a pin in every hole, with codes ignored.
    keys_mm
        Lengths of the keys.
    """
    placements: list[Floats] = []
    pairs = list(permutations(range(len(moved_face.positions_mm)), 2))
    for i, j in permutations(range(len(fixed_face.positions_mm)), 2):
        fixed_offset_mm = fixed_face.positions_mm[j] - fixed_face.positions_mm[i]
        for k, m in pairs:
            moved_offset_mm = moved_face.positions_mm[m] - moved_face.positions_mm[k]
            if abs(np.linalg.norm(fixed_offset_mm) - np.linalg.norm(moved_offset_mm)) > PLAY_MM:
                continue
            placement = compute_placement(fixed_face, moved_face, (i, j), (k, m))
            if placement is None or not pins_fit(fixed_face, moved_face, placement, pins_mm, keys_mm):
                continue
            if all(are_different(placement, earlier) for earlier in placements):
                placements.append(placement)
                yield placement


def are_different(placement: Floats, other: Floats) -> bool:
    """Check whether two placements (4, 4) differ by more than the play of the pins."""
    differences = np.abs(placement - other)
    return bool(differences[:3, 3].max() > MAX_ERROR_MM or differences[:3, :3].max() > MAX_ROTATION_ERROR)


def compute_placement(
    fixed_face: MatingFace, moved_face: MatingFace, fixed_holes: tuple[int, int], moved_holes: tuple[int, int]
) -> Floats | None:
    """Compute the placement (4, 4) that moves two holes onto two others; None if their faces do not meet."""
    frames = []
    for face, (a, b), sign in ((fixed_face, fixed_holes, 1.0), (moved_face, moved_holes, -1.0)):
        direction = face.positions_mm[b] - face.positions_mm[a]
        normal = sign * face.normals[a]
        direction = direction - (direction @ normal) * normal
        length_mm = np.linalg.norm(direction)
        if length_mm < 1.0:
            return None
        frames.append(np.stack([direction / length_mm, np.cross(normal, direction / length_mm), normal]))
    placement = np.eye(4)
    placement[:3, :3] = frames[0].T @ frames[1]
    midpoints_mm = (
        fixed_face.positions_mm[list(fixed_holes)].mean(axis=0),
        moved_face.positions_mm[list(moved_holes)].mean(axis=0),
    )
    placement[:3, 3] = midpoints_mm[0] - placement[:3, :3] @ midpoints_mm[1]
    return placement


def pins_fit(
    fixed_face: MatingFace,
    moved_face: MatingFace,
    placement: Floats,
    pins_mm: Sequence[float] | None,
    keys_mm: Sequence[float] = (),
) -> bool:
    """Check that each pin and key has a hole on both sides that is deep enough, and that the arrows agree."""
    moved_positions_mm = moved_face.positions_mm @ placement[:3, :3].T + placement[:3, 3]
    distances_mm = np.linalg.norm(fixed_face.positions_mm[:, None] - moved_positions_mm[None], axis=2)
    is_opposite = fixed_face.normals @ (moved_face.normals @ placement[:3, :3].T).T < -MIN_COSINE
    is_joined = (
        (distances_mm < PLAY_MM) & is_opposite & (fixed_face.is_groove[:, None] == moved_face.is_groove[None])
    )
    if pins_mm is None:
        return bool(is_joined.any(axis=1).all() and is_joined.any(axis=0).all())
    if any(
        fixed_face.arrows[code] @ (placement[:3, :3] @ moved_face.arrows[code]) < MIN_COSINE
        for code in fixed_face.arrows.keys() & moved_face.arrows
    ):
        return False
    spaces_mm = fixed_face.reaches_mm[:, None] + moved_face.reaches_mm[None]
    return all(
        has_space_for_all(spaces_mm[is_joined & (fixed_face.is_groove[:, None] == is_key)], lengths_mm)
        for is_key, lengths_mm in ((False, pins_mm), (True, keys_mm))
    )


def has_space_for_all(spaces_mm: Floats, lengths_mm: Sequence[float]) -> bool:
    """Check whether each length has a space of its own that is longer."""
    sorted_spaces_mm = sorted(spaces_mm, reverse=True)
    pairs_mm = zip(sorted_spaces_mm, sorted(lengths_mm, reverse=True), strict=False)
    return len(sorted_spaces_mm) >= len(lengths_mm) and all(space > length for space, length in pairs_mm)


def measure_gap_mm(fixed_face: MatingFace, moved_face: MatingFace, pins_mm: Sequence[float]) -> float:
    """Measure the gap of a joint if its longest pin is put into a deep hole and meets a shallow one."""
    longest_mm = max(pins_mm, default=0.0)
    gaps_mm = [
        longest_mm - a - b
        for a, b in product(
            fixed_face.reaches_mm[~fixed_face.is_groove], moved_face.reaches_mm[~moved_face.is_groove]
        )
        if min(a, b) < longest_mm / 2.0 < max(a, b)
    ]
    return float(min(gaps_mm, default=np.inf))


def find_true_placement(step: PageStep, true_poses: dict[str, Floats], poses: dict[str, Floats]) -> Floats:
    """Compute the true placement (4, 4) of the moved body in the frame of the fixed one."""
    a, b = step.fixed_parts[0], step.moved_parts[0]
    return np.asarray(poses[a] @ np.linalg.inv(true_poses[a]) @ true_poses[b] @ np.linalg.inv(poses[b]))


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    outcomes = [asdict(assemble(folder)) for folder in options.folders]
    if options.json:
        print(json.dumps({"schema": 1, "jobs": outcomes}))
    else:
        for outcome in outcomes:
            print("  ".join(f"{key} {value}" for key, value in outcome.items()))


if __name__ == "__main__":
    main()
