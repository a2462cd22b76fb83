"""Signs that a G-code file is whole: in its comments, its slicer's figures, and the filament of its moves."""

from slicing.own_gcode.completeness.comments import CompletenessReader, read_layer_number
from slicing.own_gcode.completeness.figures import StatedFigures, StatedFilament
from slicing.own_gcode.completeness.layer_gaps import LayerGaps

__all__ = ["CompletenessReader", "LayerGaps", "StatedFigures", "StatedFilament", "read_layer_number"]
