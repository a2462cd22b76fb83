"""Limits and names of the files of models and decompositions; these modules import no other packages."""
