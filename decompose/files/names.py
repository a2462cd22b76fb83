"""File names of a decomposition, apart so that reading them loads nothing else."""

REPORT, PICTURE, ASSEMBLY = "decomposition.json", "assembly.png", "assembly.glb"
INSTRUCTIONS = "instructions.html"
