"""Limits and names of the files of models and decompositions, in modules that import no other packages."""
