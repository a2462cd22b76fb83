"""STEP files of boxes for tests, written without a library (ISO 10303-21, AP214)."""

_HEADER = """ISO-10303-21;
HEADER;
FILE_DESCRIPTION(('a box'),'2;1');
FILE_NAME('box.step','2026-01-01T00:00:00',(''),(''),'','','');
FILE_SCHEMA(('AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }'));
ENDSEC;
DATA;
"""
_FACES = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))


def write_step_text(size_mm, unit_mm=1.0):
    """Return a STEP file of a box with one corner at the origin, in a unit of `unit_mm`."""
    records = []

    def add_record(text):
        records.append(text)
        return f"#{len(records)}"

    def write_vector(kind, values):
        return add_record(f"{kind}('',({','.join(f'{value:.6f}' for value in values)}))")

    millimetre = add_record("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))")
    unit = millimetre
    if unit_mm != 1.0:
        exponents = add_record("DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.)")
        measure = add_record(f"LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE({unit_mm}),{millimetre})")
        unit = add_record(f"(CONVERSION_BASED_UNIT('UNIT',{measure})LENGTH_UNIT()NAMED_UNIT({exponents}))")
    angle = add_record("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
    solid_angle = add_record("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
    accuracy = add_record(
        f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-05),{unit},'distance_accuracy_value','')"
    )
    context = add_record(
        f"(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT(({accuracy}))"
        f"GLOBAL_UNIT_ASSIGNED_CONTEXT(({unit},{angle},{solid_angle}))REPRESENTATION_CONTEXT('','3D'))"
    )
    x, y, z = (side / unit_mm for side in size_mm)
    corners = [(0, 0, 0), (x, 0, 0), (x, y, 0), (0, y, 0), (0, 0, z), (x, 0, z), (x, y, z), (0, y, z)]
    vertices = [
        add_record(f"VERTEX_POINT('',{write_vector('CARTESIAN_POINT', corner)})") for corner in corners
    ]

    def write_direction(start, end):
        steps = [b - a for a, b in zip(corners[start], corners[end], strict=True)]
        length = sum(step * step for step in steps) ** 0.5
        return [step / length for step in steps]

    edges = {}

    def write_edge(start, end):
        if (end, start) in edges:
            return add_record(f"ORIENTED_EDGE('',*,*,{edges[end, start]},.F.)")
        vector = add_record(f"VECTOR('',{write_vector('DIRECTION', write_direction(start, end))},1.)")
        line = add_record(f"LINE('',{write_vector('CARTESIAN_POINT', corners[start])},{vector})")
        edges[start, end] = add_record(f"EDGE_CURVE('',{vertices[start]},{vertices[end]},{line},.T.)")
        return add_record(f"ORIENTED_EDGE('',*,*,{edges[start, end]},.T.)")

    faces = []
    for side in _FACES:
        ring = [write_edge(a, b) for a, b in zip(side, (*side[1:], side[0]), strict=True)]
        u, v = write_direction(side[0], side[1]), write_direction(side[1], side[2])
        normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
        place = add_record(
            f"AXIS2_PLACEMENT_3D('',{write_vector('CARTESIAN_POINT', corners[side[0]])},"
            f"{write_vector('DIRECTION', normal)},{write_vector('DIRECTION', u)})"
        )
        loop = add_record(f"EDGE_LOOP('',({','.join(ring)}))")
        bound = add_record(f"FACE_OUTER_BOUND('',{loop},.T.)")
        plane = add_record(f"PLANE('',{place})")
        faces.append(add_record(f"ADVANCED_FACE('',({bound}),{plane},.T.)"))
    shell = add_record(f"CLOSED_SHELL('',({','.join(faces)}))")
    solid = add_record(f"MANIFOLD_SOLID_BREP('box',{shell})")
    shape = add_record(f"ADVANCED_BREP_SHAPE_REPRESENTATION('',({solid}),{context})")
    application = add_record("APPLICATION_CONTEXT('automotive design')")
    add_record(
        f"APPLICATION_PROTOCOL_DEFINITION('international standard','automotive_design',2000,{application})"
    )
    product_context = add_record(f"PRODUCT_CONTEXT('',{application},'mechanical')")
    product = add_record(f"PRODUCT('box','box','',({product_context}))")
    formation = add_record(f"PRODUCT_DEFINITION_FORMATION('','',{product})")
    definition_context = add_record(f"PRODUCT_DEFINITION_CONTEXT('part definition',{application},'design')")
    definition = add_record(f"PRODUCT_DEFINITION('design','',{formation},{definition_context})")
    definition_shape = add_record(f"PRODUCT_DEFINITION_SHAPE('','',{definition})")
    add_record(f"SHAPE_DEFINITION_REPRESENTATION({definition_shape},{shape})")
    lines = "".join(f"#{number}={record};\n" for number, record in enumerate(records, 1))
    return f"{_HEADER}{lines}ENDSEC;\nEND-ISO-10303-21;\n"
