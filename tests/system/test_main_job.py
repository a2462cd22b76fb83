"""Complete jobs in real processes: CuraEngine, pyserial on pseudo-terminals, SQLite, agents, emulators."""

from __future__ import annotations

import base64
import json
import os
import re
import signal
from pathlib import Path

import pytest

from drivers.emulator.launch import Command, control
from farms.real_farm import find_free_port, wait_for
from hosts.fake_camera import make_png, run_camera

pytestmark = pytest.mark.system


def is_printing(farm):
    """Return True while every plate of job 1 is being extruded."""
    job = farm.read_job()
    states = [p["prints"][-1]["state"] if p["prints"] else "" for p in job["parts"]]
    return bool(states) and all(state == "printing" for state in states) and (job["elapsed_s"] or 0) > 0


def is_extruding(farm, name):
    return farm.read_emulator_status(name).bed_clear is False


def test_all_parts_of_a_model_are_printed(farm, bar):
    result = farm.run("submit", bar, "--wait", "--json")
    assert result.returncode == 0, (result.stderr, farm.read_log())
    answer = json.loads(result.stdout)
    assert answer["schema"] == 1
    job = answer["job"]
    assert job["state"] == "printed"
    assert [part["prints"][-1]["state"] for part in job["parts"]] == ["done", "done"]
    assert {part["prints"][-1]["printer"] for part in job["parts"]} == {"one", "two"}
    # On a busy computer, a delay of a second is minutes of farm time; `bench/fleets/job_times.py`
    # measures the difference.
    assert job["starved_share"] < 0.25
    assert job["elapsed_s"] == pytest.approx(job["estimated_s"], rel=0.25)
    assert 1.0 < job["speedup"] < 2.0
    assert 0.5 < job["utilisation"] <= 1.0
    for part in job["parts"]:
        assert Path(part["file"]).is_file()
    assert {path.name for path in Path(job["folder"]).iterdir()} == {
        *("p01.stl", "p02.stl", "plate-01.gcode", "plate-02.gcode"),
        *("assembly.png", "assembly.glb", "decomposition.json", "instructions.html"),
    }
    for name in ("one", "two"):
        printer = farm.read_printer(name)
        assert (printer["bed"], printer["filament"], printer["heaters_off"]) == ("not_clear", "parked", True)
        emulator = farm.read_emulator_status(name)
        assert (emulator.nozzle_target_c, emulator.bed_target_c, emulator.bed_clear) == (0.0, 0.0, False)
        assert emulator.filament_mm > 0
    todo = farm.read_status()["todo"]
    assert [item["code"] for item in todo] == ["clear"]
    text = farm.run_checked("status")
    assert re.search(r"clear 2 beds: (one|two) \(1/p0[12]\) (one|two) \(1/p0[12]\)", text)
    assert "printed 2/2" in text
    farm.run_checked("cleared", "all")
    assert farm.read_status()["todo"] == []
    # No printer prints, so the farm shuts down on request, with its simulated printers.
    farm.run_checked("down")
    assert farm.run("status").returncode == 3


def test_print_completes_despite_wrong_checksums(make_farm, bar):
    model = "ultimaker2_plus"
    farm = make_farm(
        {"one": (model, f"sim://{model}?seed=3&checksum=0.002"), "two": (model, f"sim://{model}?seed=4")}
    )
    farm.up()
    result = farm.run("submit", bar, "--wait")
    assert result.returncode == 0, (result.stderr, farm.read_log())
    assert farm.read_emulator_status("one").errors > 0


def test_prints_continue_after_the_daemon_dies(farm, bar):
    farm.run_checked("submit", bar)
    wait_for("both printers to extrude", lambda: is_printing(farm) and is_extruding(farm, "one"))
    old_status = farm.read_status()
    agents = {p["name"]: p["agent_pid"] for p in old_status["printers"]}
    resets = {name: farm.read_emulator_status(name).resets for name in agents}
    moves = {name: farm.read_emulator_status(name).moves for name in agents}
    os.kill(old_status["daemon"]["pid"], signal.SIGKILL)
    wait_for("moves without a daemon", lambda: farm.read_emulator_status("one").moves > moves["one"])
    assert farm.run("status").returncode == 3
    farm.run_checked("up")
    assert farm.read_status()["daemon"]["pid"] != old_status["daemon"]["pid"]
    wait_for("the job to end", lambda: farm.read_job()["state"] == "printed")
    assert {p["name"]: p["agent_pid"] for p in farm.read_status()["printers"]} == agents
    assert {name: farm.read_emulator_status(name).resets for name in agents} == resets
    job = farm.read_job()
    # On a busy computer, a delay of a second is minutes of farm time; `bench/fleets/job_times.py`
    # measures the difference.
    assert job["elapsed_s"] == pytest.approx(job["estimated_s"], rel=0.25)
    assert [len(part["prints"]) for part in job["parts"]] == [1, 1]


def test_submit_wait_survives_a_restart_of_the_daemon(farm, bar, tmp_path):
    import subprocess

    from farms.real_farm import FARM_PROGRAM

    with (tmp_path / "out").open("w+") as path:
        command = [str(FARM_PROGRAM), "submit", str(bar), "--wait", "--json", "--state", str(farm.state)]
        wait_process = subprocess.Popen(command, stdout=path, stderr=subprocess.DEVNULL)
        wait_for("the plan", lambda: farm.read_status()["jobs"] and farm.read_job()["estimated_s"])
        farm.kill_daemon()
        farm.run_checked("up")
        assert wait_process.wait(240) == 0
        path.seek(0)
        assert json.load(path)["job"]["state"] == "printed"


@pytest.fixture
def watched_farm(make_farm):
    """Start a farm of two simulated printers with cameras, and a server for the network."""
    model = "ultimaker2_plus"
    with run_camera(lambda request: request.send(make_png())) as camera:
        farm = make_farm({"one": (model, f"sim://{model}?seed=1"), "two": (model, f"sim://{model}?seed=2")})
        farm.port = find_free_port()
        web = f"web: {{listen: '127.0.0.1:{farm.port}'}}\n"
        camera_url = f"defaults: {{camera: 'http://{camera.address}/{{printer}}.png'}}\n"
        farm.fleet.write_text(farm.fleet.read_text() + web + camera_url)
        farm.up()
        yield farm
        farm.end()


def have_final_stills(job):
    """Return True if each print of a job has the still of its end or failure, which arrives last."""
    return all(
        ("failure" if attempt["state"] == "failed" else "end")
        in {still["moment"] for still in attempt["stills"]}
        for part in job["parts"]
        for attempt in part["prints"]
    )


def check_stills(job):
    """Check the stills of a job's prints; return their number."""
    stills = [still for part in job["parts"] for attempt in part["prints"] for still in attempt["stills"]]
    # At 150 times real time, the first layer is so short that a busy machine may miss it.
    assert "first_layer" in {still["moment"] for still in stills}
    assert all(Path(still["file"]).read_bytes() == make_png() for still in stills)
    return len(stills)


def check_fetched_files(farm, folder, stills):
    """Check that another computer can fetch the files of job 1, and a report with its stills."""
    key = folder / "key"
    key.touch(mode=0o600)
    key.write_text(farm.run_checked("key", "add", "laptop", "--role", "look"))
    remote_environ = {"FARM_URL": f"http://127.0.0.1:{farm.port}", "FARM_KEY_FILE": str(key)}
    wait_for("the server", lambda: "closed" not in farm.run_checked("key").splitlines()[0])
    farm.run_checked("fetch", 1, "--out", folder / "job", **remote_environ)
    file_names = {path.name for path in (folder / "job").iterdir()}
    assert {"p01.stl", "p02.stl", "plate-01.gcode", "assembly.png", "instructions.html"} <= file_names
    assert sum(name.startswith("print-") for name in file_names) == stills
    report = (folder / "job" / "report.html").read_text()
    assert report.count(base64.b64encode(make_png()).decode()) == stills


def test_printer_of_a_dead_agent_is_cooled(watched_farm, bar, tmp_path):
    farm = watched_farm
    farm.run_checked("submit", bar)
    wait_for("both printers to extrude", lambda: is_printing(farm) and is_extruding(farm, "one"))
    agent = farm.read_printer("one")["agent_pid"]
    assert farm.read_emulator_status("one").nozzle_target_c > 0
    resets = farm.read_emulator_status("one").resets
    os.kill(agent, signal.SIGKILL)

    def are_heaters_off():
        emulator = farm.read_emulator_status("one")
        return emulator.nozzle_target_c == 0 and emulator.bed_target_c == 0

    # The next agent resets the board; `test_agents_are_watched_often` limits the time until then.
    wait_for("heater targets of 0", are_heaters_off)
    assert farm.read_emulator_status("one").resets == resets + 1
    wait_for("the daemon to record the failure", lambda: farm.read_printer("one")["state"] == "look")
    printer = farm.read_printer("one")
    assert printer["bed"] == "not_clear"
    assert printer["agent_pid"] not in (None, agent)
    job = farm.read_job()
    failed_prints = [p for part in job["parts"] for p in part["prints"] if p["printer"] == "one"]
    assert [p["state"] for p in failed_prints] == ["failed"]
    assert "agent" in failed_prints[0]["reason"]
    # The other print continues; the failed plate then waits for a person, with the reason.
    wait_for(
        "the other part", lambda: any(p["prints"][-1]["state"] == "done" for p in farm.read_job()["parts"])
    )
    assert farm.read_job()["waits_for_person"]
    farm.run_checked("cleared", "one")
    wait_for("the second attempt", lambda: farm.read_job()["state"] == "printed")
    wait_for("the stills of all ended prints", lambda: have_final_stills(farm.read_job()))
    check_fetched_files(farm, tmp_path, check_stills(farm.read_job()))


def test_printer_that_a_person_reset_must_be_inspected_first(farm, bar):
    control(farm.get_emulator_folder("one"), Command.RESET)
    wait_for("the farm to notice", lambda: farm.read_printer("one")["look"])
    printer = farm.read_printer("one")
    assert (printer["bed"], printer["state"]) == ("unknown", "look")
    assert [item["code"] for item in farm.read_status()["todo"]] == ["look"]
    # After a restart, the daemon still knows that the bed is unknown.
    farm.kill_daemon()
    farm.run_checked("up")
    wait_for("the other printer", lambda: farm.read_printer("two")["state"] == "idle")
    assert farm.read_printer("one")["bed"] == "unknown"
    farm.run_checked("cleared", "one")
    wait_for("the printer to be ready", lambda: farm.read_printer("one")["state"] == "idle")
    assert farm.read_printer("one")["bed"] == "clear"


def test_farm_down_is_refused_during_a_print_without_an_option(farm, bar):
    farm.run_checked("submit", bar)
    wait_for("both printers to extrude", lambda: is_printing(farm))
    result = farm.run("down")
    assert result.returncode == 5
    assert "one two" in result.stderr
    farm.run_checked("down", "--now")
    assert farm.run("status").returncode == 3
    for name in ("one", "two"):
        emulator = farm.read_emulator_status(name)
        assert (emulator.nozzle_target_c, emulator.bed_target_c) == (0.0, 0.0)


def test_cancelled_job_ends_safely_and_is_not_repeated(farm, bar):
    farm.run_checked("submit", bar)
    wait_for("both printers to extrude", lambda: is_printing(farm))
    farm.run_checked("cancel", 1)
    wait_for("both prints to end", lambda: all(p["print"] is None for p in farm.read_status()["printers"]))
    job = farm.read_job()
    assert job["state"] == "cancelled"
    assert [part["prints"][-1]["state"] for part in job["parts"]] == ["cancelled", "cancelled"]
    for name in ("one", "two"):
        printer = farm.read_printer(name)
        assert (printer["bed"], printer["look"]) == ("not_clear", None)
        assert farm.read_emulator_status(name).nozzle_target_c == 0.0
    assert farm.run("submit", bar, "--wait", "--printers", "0").returncode == 2
