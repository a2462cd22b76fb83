"""Names of files and parts of a decomposition, in a module whose import loads nothing else."""

REPORT, PICTURE, ASSEMBLY = "decomposition.json", "assembly.png", "assembly.glb"
INSTRUCTIONS = "instructions.html"


def find_part_number(part: str) -> str:
    """Return the number in a part's id: 7 for p07."""
    return part.lstrip("p").lstrip("0") or part
