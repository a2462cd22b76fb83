"""Tests of the script that installs CuraEngine and its settings, with stand-ins for the programs of apt."""

import pytest

from hosts.apt_host import Host, create_resources


class TestInstall:
    @pytest.mark.parametrize("version", ["4.13", "5.0"])
    def test_engine_and_settings_of_one_version_are_installed(self, tmp_path, version):
        host = Host(tmp_path, apt=version)
        code, output, calls = host.run()
        assert (code, output.splitlines()[-1]) == (
            0,
            f"install: CuraEngine {version} and Cura's settings are in place.",
        )
        assert "install -y -qq --no-install-recommends cura-engine" in calls
        assert "install cura\n" not in calls
        assert (host.settings / "materials" / "generic_pla.xml.fdm_material").is_file()
        assert host.run()[0] == 0
        assert (host.state / "calls").read_text() == calls  # the second run does not call apt-get

    def test_empty_package_lists_are_refreshed_once(self, tmp_path):
        code, _, calls = Host(tmp_path, apt="5.0", has_lists=False).run()
        assert code == 0
        assert calls.count("update") == 1

    @pytest.mark.parametrize("version", ["4.13", "5.0", "5.2"])
    def test_configured_engine_of_a_supported_version_is_used(self, tmp_path, version):
        host = Host(tmp_path)
        engine = host.add_engine(version, tmp_path / "mine")
        engine_files = create_resources(tmp_path / "cura", version)
        code, output, calls = host.run(FARM_CURA_ENGINE=str(engine), FARM_CURA_RESOURCES=str(engine_files))
        assert (code, output, calls) == (0, "", "")

    @pytest.mark.parametrize(
        ("engine", "settings", "message"),
        [
            ("4.8", "4.13", "is not CuraEngine 4.13 or 5"),
            ("5.0", "4.13", "CuraEngine is 5.0, and FARM_CURA_RESOURCES="),
            ("4.13", "5.0", "CuraEngine is 4.13, and FARM_CURA_RESOURCES="),
            ("5.0", None, "is not Cura's resources folder"),
        ],
    )
    def test_configured_engine_of_another_version_is_refused(self, tmp_path, engine, settings, message):
        host = Host(tmp_path)
        folder = create_resources(tmp_path / "cura", settings) if settings else tmp_path
        program = host.add_engine(engine, tmp_path / "mine")
        code, output, _ = host.run(FARM_CURA_ENGINE=str(program), FARM_CURA_RESOURCES=str(folder))
        assert code == 1
        assert message in output

    def test_settings_of_another_version_are_replaced(self, tmp_path):
        host = Host(tmp_path, apt="5.0")
        host.add_engine("5.0")
        create_resources(host.settings, "4.13")
        code, _, calls = host.run()
        assert code == 0
        assert "cura-engine" not in calls
        assert '"setting_version": 20' in (host.settings / "definitions" / "fdmprinter.def.json").read_text()

    def test_packages_of_another_version_are_not_used(self, tmp_path):
        host = Host(tmp_path, apt="5.0")
        host.add_engine("4.13")
        code, output, _ = host.run()
        assert code == 1
        assert "apt has no version 4.13 of: cura fdm-materials" in output
        assert not host.settings.exists()

    @pytest.mark.parametrize(
        ("host", "message"),
        [
            ({}, "There is no apt here"),
            ({"apt": "4.8"}, "apt has no version 4.13 or 5"),
            ({"apt": "5.0", "packaged_version": "4.13"}, "does not have the settings of CuraEngine 5.0"),
        ],
    )
    def test_unavailable_engine_is_reported_with_its_requirements(self, tmp_path, host, message):
        code, output, _ = Host(tmp_path, **host).run()
        assert code == 1
        assert message in output
        assert "FARM_CURA_ENGINE" in output
