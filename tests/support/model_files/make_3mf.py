"""Minimal 3MF files for tests, written without a library."""

import io
import zipfile

CORE_NAMESPACE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
PRODUCTION_NAMESPACE = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
RELATIONS_XML = (
    '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    '<Relationship Id="r0" Target="/3D/3dmodel.model" '
    'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
)


def write_mesh_xml(mesh):
    """Write a mesh as the XML of a 3MF object."""
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in mesh.vertices)
    faces = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in mesh.faces)
    return f"<mesh><vertices>{vertices}</vertices><triangles>{faces}</triangles></mesh>"


def write_object_xml(number, content, kind="model"):
    return f'<object id="{number}" type="{kind}">{content}</object>'


def write_components_xml(*references):
    """Write the components of an object from their attributes."""
    return f"<components>{''.join(f'<component {reference}/>' for reference in references)}</components>"


def write_model_xml(objects, items, unit=None, head=""):
    """Write a model part from the XML of its objects and the attributes of its build items."""
    unit = f' unit="{unit}"' if unit else ""
    build = "".join(f"<item {item}/>" for item in items)
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>{head}<model{unit} xml:lang="en-US" xmlns="{CORE_NAMESPACE}" '
        f'xmlns:p="{PRODUCTION_NAMESPACE}"><resources>{"".join(objects)}</resources><build>{build}</build></model>'
    )


def pack_3mf(model, parts=None, relations=RELATIONS_XML):
    """Pack a 3MF file from the XML of its model, and other parts by their names."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as package:
        if relations is not None:
            package.writestr("_rels/.rels", relations)
        if model is not None:
            package.writestr("3D/3dmodel.model", model)
        for name, content in (parts or {}).items():
            package.writestr(name, content)
    return file.getvalue()
