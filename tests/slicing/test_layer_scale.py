"""Layer heights that are not a whole number of micrometres, in files made by hand and in real slices."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from slicing.checks import read_toolpath
from slicing.errors import SliceRejected
from slicing.layer_scale import LayerScale
from slicing.plate import slice_plate

GCODE = b"""G1 F2400 Z20
;LAYER:0
G0 F4500 X1 Y2 Z0.27
;LAYER:1
G0 X1 Y2 Z0.478
G1 X2 Y2 E1.5
;TIME_ELAPSED:1.0
G0 X1 Z205 Y2
"""


@given(st.floats(0.15, 0.25), st.floats(0.0, 300.0), st.sampled_from([0.2, 0.27, 0.32]))
def test_heights_are_restored(layer_mm, height_mm, first_layer_mm):
    scale = LayerScale(first_layer_mm, round(layer_mm, 3) / layer_mm)
    scaled_mm = scale.scale_model(np.full((1, 3, 3), height_mm))[0, 0, 2]
    gcode = b"G28\n;LAYER:0\nG0 X1 Z%.5f Y3 ; Z9\n;TIME_ELAPSED:1\n" % scaled_mm
    restored = scale.restore_heights(gcode).splitlines()[2]
    assert restored.startswith(b"G0 X1 Z")
    assert restored.endswith(b" Y3 ; Z9")
    tolerance_mm = 0.0006 if height_mm > first_layer_mm else 0.0015  # the first layer is not scaled
    assert float(restored.split()[2][1:]) == pytest.approx(height_mm, abs=tolerance_mm)


def test_start_code_and_end_code_and_the_first_layer_stay():
    gcode = LayerScale(0.27, 0.208 / 0.207).restore_heights(GCODE)
    assert gcode == GCODE.replace(b"Z0.478", b"Z0.477").replace(b"Z0.27\n", b"Z0.270\n")
    with pytest.raises(SliceRejected, match="comments on layers"):
        LayerScale(0.27, 1.1).restore_heights(b"G1 Z3\n")


@pytest.mark.parametrize(
    "overrides",
    [{"layer_height": "0.207"}, {"layer_height": "0.2075", "adaptive_layer_height_enabled": "true"}],
)
def test_whole_micrometres_and_adaptive_layers_need_no_scale(make_settings, overrides):
    assert LayerScale.from_settings(make_settings(**overrides)) is None


def test_layers_of_a_real_slice_have_the_exact_height(make_request, make_settings):
    """Slice a pyramid: each layer has the outline of the model at its own height."""
    settings = make_settings(layer_height="0.2074", layer_height_0="0.27")
    scale = LayerScale.from_settings(settings)
    assert scale == LayerScale(0.27, pytest.approx(0.207 / 0.2074))
    height_mm = 0.27 + 150 * 0.2074
    corners = [(x, y, 0.0) for x in (-20, 20) for y in (-20, 20)]
    top = [(x, y, height_mm) for x in (-10, 10) for y in (-10, 10)]
    pyramid = trimesh.convex.convex_hull(np.array([*corners, *top]))
    result = slice_plate(make_request(pyramid, settings=settings))
    toolpath = read_toolpath(result.gcode.read_bytes())
    is_wall = toolpath.is_feature("WALL-OUTER") & (toolpath.extruded_mm > 0.0)
    layers = toolpath.layer[is_wall]
    assert layers.max() == 150
    assert toolpath.end[is_wall, 2] == pytest.approx(0.27 + 0.2074 * layers, abs=0.0006)
    for layer in (50, 100, 149):
        points = toolpath.end[is_wall][layers == layer, :2]
        middle_mm = 0.27 + (layer - 0.5) * 0.2074
        assert np.ptp(points, axis=0) == pytest.approx(40.0 - 20.0 * middle_mm / height_mm - 0.4, abs=0.03)
    assert f";MAXZ:{result.height_mm:g}\n" in result.gcode.read_text()[:300]
