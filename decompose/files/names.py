"""Names of the files and parts of a decomposition; this module imports no other packages."""

REPORT, PICTURE, ASSEMBLY = "decomposition.json", "assembly.png", "assembly.glb"
INSTRUCTIONS = "instructions.html"


def find_part_number(part: str) -> str:
    """Find the number in the id of a part, such as 7 in p07."""
    return part.lstrip("p").lstrip("0") or part
