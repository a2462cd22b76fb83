"""Files of models and of decompositions: limits and names, apart so that reading them loads nothing else."""
