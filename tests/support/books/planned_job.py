"""A planned job of two parts, whose files are in the file store of a farm."""

import hashlib

from books.make_books import make_plan_event
from farm.control import JobCommands, PrinterCommands
from farm.model import JobOptions
from farm.planning.plan import InspectedSubmission, Plan

INSPECTED_MODEL = InspectedSubmission("m.npz", ("closed 3 holes",), 1.0)
GCODE = b"G28\n"
CURVE = '{"curve": [{"printers": 1, "makespan_s": 9.0}, {"printers": 2, "makespan_s": 5.0}]}'


def submit_model(farm, user="ann", **options):
    """Submit a model; return the number of its job."""
    jobs = JobCommands(farm.controller, PrinterCommands(farm.controller))
    return jobs.submit(f"request-{user}", "m.stl", INSPECTED_MODEL, JobOptions(**options), user)[0]


def plan_job(farm, user="ann", glb=None, **options):
    """Submit a model and plan its job; return the number of the job."""
    number = submit_model(farm, user, **options)
    event = make_plan_event(number)
    files = {"picture": "a.png", "decomposition": "d.json", "instructions": "i.html"}
    contents = {"g.gcode": GCODE, "d.json": CURVE.encode(), "i.html": b"<h1>glue</h1>", "a.png": b"png"}
    if glb is not None:
        files["assembly"], contents["a.glb"] = "a.glb", glb
    for name, content in contents.items():
        (farm.state.files / name).write_bytes(content)
    sha256 = hashlib.sha256(GCODE).hexdigest()
    plates = tuple(plate.model_copy(update={"sha256": sha256}) for plate in event.plates)
    parts = event.parts
    if "copies" in options:
        parts, plates = copy_parts(parts, plates, options["copies"])
    farm.controller.on_plan(number, Plan(parts, plates, (), 1.0, 500.0, **files))
    return number


def copy_parts(parts, plates, copies):
    """Return the parts and plates of all copies, named as in planning."""
    numbers = range(1, copies + 1)
    names = [
        (n, part, {"id": f"{part.id}.{n}", "plate": f"{part.plate}.{n}"}) for n in numbers for part in parts
    ]
    copied_parts = [part.model_copy(update={**fields, "copy_number": n}) for n, part, fields in names]
    copied_plates = [
        plate.model_copy(
            update={"id": f"{plate.id}.{n}", "parts": tuple(f"{part_id}.{n}" for part_id in plate.parts)}
        )
        for n in numbers
        for plate in plates
    ]
    return tuple(copied_parts), tuple(copied_plates)
