"""What the files of a decomposition are called. It loads nothing, for those who only look for them."""

REPORT, PICTURE, ASSEMBLY = "decomposition.json", "assembly.png", "assembly.glb"
