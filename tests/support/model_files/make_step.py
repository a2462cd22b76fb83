"""STEP files for tests, written by hand: boxes of planes and lines (ISO 10303-21, AP214)."""

_HEAD = """ISO-10303-21;
HEADER;
FILE_DESCRIPTION(('a box'),'2;1');
FILE_NAME('box.step','2026-01-01T00:00:00',(''),(''),'','','');
FILE_SCHEMA(('AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }'));
ENDSEC;
DATA;
"""
_SIDES = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))


def write_step_text(size_mm, unit_mm=1.0):
    """Write a box of this size, from the origin, in a file whose unit is `unit_mm` long."""
    records = []

    def add(text):
        records.append(text)
        return f"#{len(records)}"

    def write_vector(kind, values):
        return add(f"{kind}('',({','.join(f'{value:.6f}' for value in values)}))")

    metres = add("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))")
    unit = metres
    if unit_mm != 1.0:
        exponents = add("DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.)")
        measure = add(f"LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE({unit_mm}),{metres})")
        unit = add(f"(CONVERSION_BASED_UNIT('UNIT',{measure})LENGTH_UNIT()NAMED_UNIT({exponents}))")
    angle = add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
    solid_angle = add("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
    accuracy = add(
        f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-05),{unit},'distance_accuracy_value','')"
    )
    context = add(
        f"(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT(({accuracy}))"
        f"GLOBAL_UNIT_ASSIGNED_CONTEXT(({unit},{angle},{solid_angle}))REPRESENTATION_CONTEXT('','3D'))"
    )
    x, y, z = (side / unit_mm for side in size_mm)
    corners = [(0, 0, 0), (x, 0, 0), (x, y, 0), (0, y, 0), (0, 0, z), (x, 0, z), (x, y, z), (0, y, z)]
    vertices = [add(f"VERTEX_POINT('',{write_vector('CARTESIAN_POINT', corner)})") for corner in corners]

    def write_direction(start, end):
        steps = [b - a for a, b in zip(corners[start], corners[end], strict=True)]
        length = sum(step * step for step in steps) ** 0.5
        return [step / length for step in steps]

    edges = {}

    def write_edge(start, end):
        if (end, start) in edges:
            return add(f"ORIENTED_EDGE('',*,*,{edges[end, start]},.F.)")
        vector = add(f"VECTOR('',{write_vector('DIRECTION', write_direction(start, end))},1.)")
        line = add(f"LINE('',{write_vector('CARTESIAN_POINT', corners[start])},{vector})")
        edges[start, end] = add(f"EDGE_CURVE('',{vertices[start]},{vertices[end]},{line},.T.)")
        return add(f"ORIENTED_EDGE('',*,*,{edges[start, end]},.T.)")

    faces = []
    for side in _SIDES:
        ring = [write_edge(a, b) for a, b in zip(side, (*side[1:], side[0]), strict=True)]
        u, v = write_direction(side[0], side[1]), write_direction(side[1], side[2])
        normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
        place = add(
            f"AXIS2_PLACEMENT_3D('',{write_vector('CARTESIAN_POINT', corners[side[0]])},"
            f"{write_vector('DIRECTION', normal)},{write_vector('DIRECTION', u)})"
        )
        loop = add(f"EDGE_LOOP('',({','.join(ring)}))")
        bound = add(f"FACE_OUTER_BOUND('',{loop},.T.)")
        plane = add(f"PLANE('',{place})")
        faces.append(add(f"ADVANCED_FACE('',({bound}),{plane},.T.)"))
    shell = add(f"CLOSED_SHELL('',({','.join(faces)}))")
    solid = add(f"MANIFOLD_SOLID_BREP('box',{shell})")
    shape = add(f"ADVANCED_BREP_SHAPE_REPRESENTATION('',({solid}),{context})")
    application = add("APPLICATION_CONTEXT('automotive design')")
    add(f"APPLICATION_PROTOCOL_DEFINITION('international standard','automotive_design',2000,{application})")
    product_context = add(f"PRODUCT_CONTEXT('',{application},'mechanical')")
    product = add(f"PRODUCT('box','box','',({product_context}))")
    formation = add(f"PRODUCT_DEFINITION_FORMATION('','',{product})")
    definition_context = add(f"PRODUCT_DEFINITION_CONTEXT('part definition',{application},'design')")
    definition = add(f"PRODUCT_DEFINITION('design','',{formation},{definition_context})")
    definition_shape = add(f"PRODUCT_DEFINITION_SHAPE('','',{definition})")
    add(f"SHAPE_DEFINITION_REPRESENTATION({definition_shape},{shape})")
    lines = "".join(f"#{number}={record};\n" for number, record in enumerate(records, 1))
    return f"{_HEAD}{lines}ENDSEC;\nEND-ISO-10303-21;\n"
