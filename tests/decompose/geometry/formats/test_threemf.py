"""3MF: units, build items, components, other parts, and hostile files."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st

from decompose.errors import DecomposeError, ModelEmpty, ModelTooDetailed, ModelUnreadable
from decompose.geometry import load_model
from decompose.geometry.formats.threemf import model_part, package, read_3mf
from model_files.make_3mf import (
    pack_3mf,
    write_components_xml,
    write_mesh_xml,
    write_model_xml,
    write_object_xml,
)

BOX = write_mesh_xml(trimesh.creation.box((10, 20, 30)))
OTHER_MODEL = "3D/Objects/other.model"


def read_bounds_mm(data: bytes) -> list[list[float]]:
    triangles, _ = read_3mf("a.3mf", data)
    return [triangles.min(axis=(0, 1)).tolist(), triangles.max(axis=(0, 1)).tolist()]


def compute_volume_mm3(data: bytes) -> float:
    triangles, _ = read_3mf("a.3mf", data)
    return float(np.linalg.det(triangles).sum() / 6)


def read_refusal(data: bytes, kind: type[DecomposeError] = ModelUnreadable) -> str:
    with pytest.raises(kind) as error:
        read_3mf("a.3mf", data)
    text = str(error.value)
    assert text.startswith("a.3mf: ") and len(text) < 250 and "\n" not in text
    return text


@pytest.mark.parametrize(("unit", "factor"), [(None, 1.0), *model_part.MM_PER_UNIT.items()])
def test_unit_of_a_3mf_file_is_converted_to_mm(unit: str | None, factor: float) -> None:
    data = pack_3mf(write_model_xml([write_object_xml(1, BOX)], ['objectid="1"'], unit))
    triangles, notes = read_3mf("a.3mf", data)
    np.testing.assert_allclose(np.ptp(triangles, axis=(0, 1)), np.array([10, 20, 30]) * factor)
    assert any(f"unit {unit}" in note for note in notes) is (factor != 1.0)


def test_only_objects_placed_by_the_build_are_read() -> None:
    items = ['objectid="1" transform="1 0 0 0 1 0 0 0 1 100 0 5"', 'objectid="1"']
    data = pack_3mf(write_model_xml([write_object_xml(1, BOX), write_object_xml(2, BOX)], items))
    assert read_bounds_mm(data) == [[-5, -10, -15], [105, 10, 20]]
    _, notes = read_3mf("a.3mf", data)
    assert notes == (
        "Read 2 objects as one model, placed as in the file.",
        "Left out objects that the build of the file does not place: 1.",
    )


def test_transform_is_applied_to_points_as_row_vectors() -> None:
    """Use the matrix 0 1 0 -1 0 0 0 0 1, which exchanges x and y according to the specification."""
    items = ['objectid="1" transform="0 1 0 -1 0 0 0 0 1 0 0 0"']
    triangles, _ = read_3mf("a.3mf", pack_3mf(write_model_xml([write_object_xml(1, BOX)], items)))
    np.testing.assert_allclose(np.ptp(triangles, axis=(0, 1)), [20, 10, 30])
    box = trimesh.creation.box((10, 20, 30))
    np.testing.assert_allclose(
        triangles, box.triangles @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], dtype=float)
    )


def test_components_of_components_are_placed_by_all_their_transforms() -> None:
    inner_components = write_components_xml('objectid="1" transform="1 0 0 0 1 0 0 0 1 0 0 7"')
    outer_components = write_components_xml(
        'objectid="2" transform="2 0 0 0 2 0 0 0 2 0 0 0"', 'objectid="1"'
    )
    objects = [
        write_object_xml(1, BOX),
        write_object_xml(2, inner_components),
        write_object_xml(3, outer_components),
    ]
    data = pack_3mf(write_model_xml(objects, ['objectid="3" transform="1 0 0 0 1 0 0 0 1 1 0 0"']))
    assert read_bounds_mm(data) == [[-9, -20, -16], [11, 20, 44]]  # the inner box: (z + 7) * 2, then x + 1


def test_mirrored_object_is_not_inside_out() -> None:
    items = ['objectid="1" transform="-1 0 0 0 1 0 0 0 1 0 0 0"']
    assert compute_volume_mm3(pack_3mf(write_model_xml([write_object_xml(1, BOX)], items))) == pytest.approx(
        6000
    )


def test_objects_of_other_parts_keep_their_own_numbers() -> None:
    """Read objects from two model files in the package, as each of them numbers its objects from 1."""
    small_box = write_mesh_xml(trimesh.creation.box((2, 2, 2)))
    components = write_components_xml(
        f'p:path="/{OTHER_MODEL}" objectid="1" transform="1 0 0 0 1 0 0 0 1 50 0 0"'
    )
    root = write_model_xml(
        [write_object_xml(1, BOX), write_object_xml(2, components)], ['objectid="1"', 'objectid="2"']
    )
    data = pack_3mf(root, {OTHER_MODEL: write_model_xml([write_object_xml(1, small_box)], [])})
    assert read_bounds_mm(data) == [[-5, -10, -15], [51, 10, 15]]


def test_supports_and_unprinted_items_are_left_out() -> None:
    objects = [write_object_xml(1, BOX), write_object_xml(2, BOX, "support"), write_object_xml(3, BOX)]
    items = ['objectid="1"', 'objectid="2"', 'objectid="3" printable="0"']
    triangles, notes = read_3mf("a.3mf", pack_3mf(write_model_xml(objects, items)))
    assert len(triangles) == 12
    assert len(notes) == 3 and "type support" in notes[1]


@pytest.mark.parametrize(
    "settings_text",
    [
        '<part id="2" subtype="negative_part"/>',
        '<metadata type="volume" key="volume_type" value="ParameterModifier"/>',
    ],
)
def test_modifiers_of_a_slicer_cause_a_warning(settings_text: str) -> None:
    model = write_model_xml([write_object_xml(1, BOX)], ['objectid="1"'])
    plain_settings = {"Metadata/model_settings.config": '<part id="1" subtype="normal_part"/>'}
    marked_settings = {"Metadata/model_settings.config": settings_text}
    assert read_3mf("a.3mf", pack_3mf(model, plain_settings))[1] == ()
    assert "modifiers" in read_3mf("a.3mf", pack_3mf(model, marked_settings))[1][0]


def test_file_of_another_program_gives_the_same_solid(tmp_path: Path) -> None:
    """Read a file with `load_model`, using a scale in addition to the unit."""
    path = tmp_path / "ball.3mf"
    ball = write_mesh_xml(trimesh.creation.icosphere(2, 1.0))
    path.write_bytes(pack_3mf(write_model_xml([write_object_xml(1, ball)], ['objectid="1"'], "inch")))
    model = load_model(path, scale=2.0)
    assert model.extents_mm.max() == pytest.approx(2 * 2 * 25.4)
    assert model.repairs == ("Converted from the unit inch.",)
    assert model.scale == 2.0


def compute_determinant(matrix: list[float]) -> float:
    """Compute the determinant by products; `numpy.linalg.det` would divide by values close to 0."""
    x, y, z = np.reshape(matrix, (3, 3))
    return float(x @ np.cross(y, z))


@given(
    st.lists(st.floats(-3, 3), min_size=9, max_size=9).filter(lambda m: abs(compute_determinant(m)) > 0.1),
    st.lists(st.floats(-100, 100), min_size=3, max_size=3),
)
@example([3.0, 5e-324, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0])
@settings(max_examples=50, deadline=None)
def test_any_transform_scales_the_volume_by_its_determinant(
    matrix: list[float], shift_mm: list[float]
) -> None:
    transform = " ".join(map(repr, [*matrix, *shift_mm]))
    data = pack_3mf(write_model_xml([write_object_xml(1, BOX)], [f'objectid="1" transform="{transform}"']))
    assert compute_volume_mm3(data) == pytest.approx(6000 * abs(compute_determinant(matrix)))


# -- hostile files ------------------------------------------------------------------------------------


def test_invalid_package_is_refused() -> None:
    read_refusal(b"junk" * 100)
    data = pack_3mf(write_model_xml([write_object_xml(1, BOX)], ['objectid="1"']))
    for length in range(0, len(data), 97):
        read_refusal(data[:length] or b"x")


def test_missing_parts_and_objects_are_named() -> None:
    model = write_model_xml([write_object_xml(1, BOX)], ['objectid="1"'])
    assert "_rels/.rels is missing" in read_refusal(pack_3mf(model, relations=None))
    assert "3D/3dmodel.model is missing" in read_refusal(pack_3mf(None))
    assert "name no 3D model" in read_refusal(pack_3mf(model, relations="<Relationships/>"))
    assert "object 7 is missing" in read_refusal(pack_3mf(write_model_xml([], ['objectid="7"'])))
    missing_component = write_components_xml(f'p:path="/{OTHER_MODEL}" objectid="1"')
    assert "other.model is missing" in read_refusal(
        pack_3mf(write_model_xml([write_object_xml(1, missing_component)], ['objectid="1"']))
    )
    read_refusal(pack_3mf(write_model_xml([write_object_xml(1, BOX)], [])), ModelEmpty)


def test_paths_stay_inside_the_package(tmp_path: Path) -> None:
    secret = tmp_path / "secret.model"
    secret.write_text(write_model_xml([write_object_xml(1, BOX)], ['objectid="1"']))
    for path in (str(secret), f"/../../../../../../..{secret}", f"file://{secret}", "..\\..\\secret.model"):
        components = write_components_xml(f'p:path="{path}" objectid="1"')
        read_refusal(pack_3mf(write_model_xml([write_object_xml(1, components)], ['objectid="1"'])))


def test_entities_and_document_types_are_refused() -> None:
    bomb = '<!DOCTYPE m [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
    doctype = '<!DOCTYPE m [<!ENTITY x SYSTEM "file:///etc/passwd">]>'
    for head in (bomb, doctype, '<!DOCTYPE m SYSTEM "http://127.0.0.1:1/x.dtd">'):
        model = write_model_xml([write_object_xml(1, BOX)], ['objectid="1"'], head=head)
        assert "document type" in read_refusal(pack_3mf(model))


def test_objects_that_contain_themselves_are_refused() -> None:
    loop_objects = [
        write_object_xml(1, write_components_xml('objectid="2"')),
        write_object_xml(2, write_components_xml('objectid="1"')),
    ]
    assert "contains itself" in read_refusal(pack_3mf(write_model_xml(loop_objects, ['objectid="1"'])))
    deep_objects = [write_object_xml(n, write_components_xml(f'objectid="{n + 1}"')) for n in range(1, 5000)]
    assert "deep" in read_refusal(
        pack_3mf(write_model_xml([*deep_objects, write_object_xml(5000, BOX)], ['objectid="1"']))
    )


def test_components_that_multiply_are_counted_before_they_are_placed() -> None:
    """Nest twenty levels of ten components: 1e20 boxes, or as many empty objects."""
    for leaf, kind in ((BOX, ModelTooDetailed), (BOX.partition("<triangles>")[0] + "</mesh>", ModelEmpty)):
        levels = [
            write_object_xml(n, write_components_xml(*[f'objectid="{n - 1}"'] * 10)) for n in range(2, 22)
        ]
        read_refusal(pack_3mf(write_model_xml([write_object_xml(1, leaf), *levels], ['objectid="21"'])), kind)
    many_items = write_model_xml([write_object_xml(1, BOX)], ['objectid="1"'] * 10_001)
    assert "10000 objects" in read_refusal(pack_3mf(many_items), ModelTooDetailed)


def test_package_that_unpacks_to_gigabytes_is_refused_before_it_is_read(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(package, "MAX_UNCHECKED_BYTES", 2**16)
    padded_model = write_model_xml([write_object_xml(1, BOX)], ['objectid="1"']).replace(
        "<build>", " " * 2**22 + "<build>"
    )
    assert "unpacks from" in read_refusal(pack_3mf(padded_model))
    assert "entries" in read_refusal(pack_3mf(padded_model) + package._ENTRY_SIGNATURE * 20_000)


def test_entry_with_a_false_size_is_read_up_to_that_size() -> None:
    data = bytearray(pack_3mf(write_model_xml([write_object_xml(1, BOX)], ['objectid="1"'])))
    index = data.rindex(b"PK\x01\x02")
    data[index + 24 : index + 28] = (100).to_bytes(4, "little")
    read_refusal(bytes(data))


def test_unknown_compression_is_refused() -> None:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("_rels/.rels", "<a/>")
    assert "uses a compression" in read_refusal(file.getvalue())


def test_overlong_tag_and_too_many_tags_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    model = write_model_xml([write_object_xml(1, BOX)], ['objectid="1"'])
    long_tag = model.replace("<build>", f'<metadata name="{"a" * 2**22}"/><build>')
    assert "tag of more than" in read_refusal(pack_3mf(long_tag))
    monkeypatch.setattr(model_part, "MAX_OTHER_TAGS", 1000)
    assert "tags beside" in read_refusal(pack_3mf(model.replace("<build>", "<a/>" * 1001 + "<build>")))


@pytest.mark.parametrize(
    ("old_text", "new_text"),
    [
        ('<vertex x="', '<vertex w="'),
        ('<vertex x="-5.0', '<vertex x="five'),
        ('v1="1"', 'v1="-1"'),
        ('v1="1"', 'v1="8"'),
        ('v1="1"', f'v1="{10**30}"'),
        ('objectid="1"', 'transform="1 0 0"'),
        ('objectid="1"', 'objectid="1" transform="1 0 0 0 1 0 0 0 1 0 0 nan"'),
        ("</resources>", write_object_xml(1, BOX) + "</resources>"),
        ("<model ", '<model unit="furlong" '),
        ("<model ", '<model requiredextensions="b" xmlns:b="http://x/beamlattice/2017/02" '),
        ("<model ", "<mo del "),
        ("http://schemas.microsoft.com/3dmanufacturing/core", "http://elsewhere"),
    ],
)
def test_broken_model_is_refused_with_a_one_line_message(old_text: str, new_text: str) -> None:
    model = write_model_xml([write_object_xml(1, BOX)], ['objectid="1"'])
    assert old_text in model
    read_refusal(pack_3mf(model.replace(old_text, new_text, 1)))


def test_more_triangles_than_memory_allows_are_refused_while_they_are_read() -> None:
    data = pack_3mf(write_model_xml([write_object_xml(1, BOX)], ['objectid="1"']))
    with pytest.raises(ModelTooDetailed):
        read_3mf("a.3mf", data, 11)


@given(st.data())
@settings(max_examples=150, deadline=None)
def test_flipped_bytes_are_refused_with_a_one_line_message(data: st.DataObject) -> None:
    package = pack_3mf(write_model_xml([write_object_xml(1, BOX)], ['objectid="1"']))
    index = data.draw(st.integers(0, len(package) - 1))
    broken_package = bytearray(package)
    broken_package[index] ^= data.draw(st.integers(1, 255))
    try:
        read_3mf("a.3mf", bytes(broken_package))
    except DecomposeError as error:
        assert str(error).startswith("a.3mf: ")
