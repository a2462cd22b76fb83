"""Files of models and of decompositions: limits and names, whose import loads nothing else."""
