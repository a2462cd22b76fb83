"""Record all settings that Cura computes for a selection of printers, nozzles, materials and qualities.

Cura's own container stacks, formulas and material reader compute them; its application, which needs a
window, is replaced by a stub. The script needs Debian's packages, unpacked into one
folder and not installed. On Debian 12::

    apt-get download cura fdm-materials python3-uranium python3-pyqt5 python3-pyqt5.sip python3-savitar \
        libqt5core5a libqt5gui5 libqt5qml5 libqt5qmlmodels5 libqt5network5 libqt5quick5 libqt5widgets5 \
        libqt5dbus5 libdouble-conversion3 libmd4c0 libpcre2-16-0
    for package in *.deb; do dpkg -x $package ROOT; done
    LD_LIBRARY_PATH=ROOT/usr/lib/x86_64-linux-gnu /usr/bin/python3 tests/slicing/record_cura_settings.py \
        ROOT tests/slicing/fixtures/cura-4.13.json.gz

For Cura 5.0, use Debian 13's cura, fdm-materials and python3-uranium, and PyQt6 with its libraries.
"""

import gzip
import importlib
import json
import sys
from enum import IntEnum
from pathlib import Path
from types import ModuleType, SimpleNamespace

PLUS_MODEL, EXTENDED_PLUS_MODEL = "ultimaker2_plus", "ultimaker2_extended_plus"
PLAIN_MODEL, EXTENDED_MODEL, GO_MODEL = "ultimaker2", "ultimaker2_extended", "ultimaker2_go"
MARLIN_FLAVOUR = {"machine_gcode_flavor": "RepRap (Marlin/Sprinter)", "machine_firmware_retract": False}
SUPPORT_VALUES = {
    "support_enable": True,
    "support_type": "everywhere",
    "adhesion_type": "brim",
    "brim_width": 8.0,
}
PAPER_SETTINGS = {
    **MARLIN_FLAVOUR,
    **SUPPORT_VALUES,
    "layer_height": 0.25,
    "infill_sparse_density": 5.0,
    "infill_pattern": "zigzag",
    "support_angle": 45.0,
    "material_bed_temperature": 50.0,
}
GLUE_SETTINGS = {
    **MARLIN_FLAVOUR,
    **SUPPORT_VALUES,
    "layer_height": "=round(max(extruderValues('machine_nozzle_size')) / 2, 2)",
    "infill_sparse_density": 10.0,
    "top_layers": "=max(4, math.ceil(round(top_thickness / resolveOrValue('layer_height'), 4)))",
}
ODD_SETTINGS = {"infill_pattern": "cubic", "wall_thickness": 1.3, "adhesion_type": "skirt", "xy_offset": 0.1}
# For a plain Ultimaker 2, Cura leaves the material to the printer's menu; here, the stack contains it.
COMBINATIONS = [  # printer, nozzle, material, quality, the user's changes
    (PLUS_MODEL, "0.4 mm", "generic_pla", "fast", {}),
    (PLUS_MODEL, "0.4 mm", "generic_pla", "fast", PAPER_SETTINGS),
    (PLUS_MODEL, "0.4 mm", "generic_pla", "fast", GLUE_SETTINGS),
    (PLUS_MODEL, "0.4 mm", "generic_pla", "normal", ODD_SETTINGS),
    (PLUS_MODEL, "0.25 mm", "generic_pla", "high", {}),
    (PLUS_MODEL, "0.6 mm", "generic_abs", "fast", {}),
    (PLUS_MODEL, "0.8 mm", "generic_pla", "draft", GLUE_SETTINGS),
    (PLUS_MODEL, "0.8 mm", "generic_pp", "slightlycoarse", {}),
    (PLUS_MODEL, "0.4 mm", "generic_tpu", "normal", {}),
    (PLUS_MODEL, "0.25 mm", "generic_tpu", "high", {}),
    (EXTENDED_PLUS_MODEL, "0.4 mm", "ultimaker_abs_black", "high", {}),
    (EXTENDED_PLUS_MODEL, "0.4 mm", "generic_nylon", "fast", GLUE_SETTINGS),
    (EXTENDED_PLUS_MODEL, "0.6 mm", "generic_cpe_plus", "draft", {}),
    (EXTENDED_PLUS_MODEL, "0.4 mm", "generic_pc", "draft", PAPER_SETTINGS),
    (EXTENDED_PLUS_MODEL, "0.8 mm", "generic_cpe", "draft", ODD_SETTINGS),
    (PLAIN_MODEL, "0.4 mm", "generic_pla", "fast", {}),
    (PLAIN_MODEL, "0.4 mm", "generic_abs", "normal", GLUE_SETTINGS),
    (EXTENDED_MODEL, "0.4 mm", "generic_pla", "draft", PAPER_SETTINGS),
    (GO_MODEL, "0.4 mm", "generic_pla", "high", {}),
]


class Registry:
    """Stub of the part of Cura's registry that its containers use."""

    def __init__(self, folder):
        self.folder, self.containers, self.load = folder, {}, None

    def isLoaded(self, name):
        return name in self.containers

    def isReadOnly(self, name):
        return True

    def setExplicitReadOnly(self, name):
        pass

    def addContainer(self, container):
        self.containers[container.getId()] = container

    def findContainers(self, **expected):
        return [self.containers[expected["id"]]] if expected.get("id") in self.containers else []

    findInstanceContainers = findContainers

    def findDefinitionContainers(self, **expected):
        return [self.load(expected["id"])]

    def findInstanceContainersMetadata(self, **expected):
        return []

    findContainersMetadata = findInstanceContainersMetadata

    def findDefinitionContainersMetadata(self, **expected):
        path = self.folder / "definitions" / f"{expected['id']}.def.json"
        return [json.loads(path.read_text()).get("metadata", {})] if path.is_file() else []


def make_stub_module(name, **content):
    module = sys.modules[name] = ModuleType(name)
    module.__dict__.update(content)
    return module


class Cura:
    """Cura's own classes, with one printer and a stub of the application."""

    def __init__(self, root):
        self.folder = root / "usr/share/cura/resources"
        sys.path[:0] = [str(root / "usr/lib/python3/dist-packages"), str(root / "usr/lib/cura/plugins")]
        self.registry = Registry(self.folder)
        self.registry.load = self.load_definition
        self.machine = None
        managers = SimpleNamespace(defaultExtruderPosition="0")
        application = SimpleNamespace(
            getMachineManager=lambda: managers,
            getExtruderManager=lambda: SimpleNamespace(
                getActiveExtruderStacks=lambda: managers.activeMachine.extruderList
            ),
            callLater=lambda call, *args, **named: None,
            getCuraFormulaFunctions=lambda: None,
        )
        self.managers = managers
        application_class = type(
            "CuraApplication", (), {"SettingVersion": 19, "getInstance": staticmethod(lambda: application)}
        )
        app = make_stub_module(
            "UM.Application",
            Application=type(
                "Application",
                (),
                {
                    "getInstance": staticmethod(lambda: application),
                    "getInstallPrefix": staticmethod(lambda: "/"),
                },
            ),
        )
        import UM

        UM.Application = app
        import cura

        cura.CuraApplication = make_stub_module("cura.CuraApplication", CuraApplication=application_class)
        connection_types = IntEnum(
            "ConnectionType",
            {"NotConnected": 0, "UsbConnection": 1, "NetworkConnection": 2, "CloudConnection": 3},
        )
        make_stub_module("cura.PrinterOutput.PrinterOutputDevice", ConnectionType=connection_types)
        make_stub_module("cura.Settings.ExtruderManager", ExtruderManager=object)

        def import_name(module, name):
            return getattr(importlib.import_module(module), name)

        self.Definition = import_name("UM.Settings.DefinitionContainer", "DefinitionContainer")
        self.Instance = import_name("UM.Settings.InstanceContainer", "InstanceContainer")
        self.Function = import_name("UM.Settings.SettingFunction", "SettingFunction")
        self.Global = import_name("cura.Settings.GlobalStack", "GlobalStack")
        self.Extruder = import_name("cura.Settings.ExtruderStack", "ExtruderStack")
        resources = import_name("UM.Resources", "Resources")
        paths = {
            path.name: str(path)
            for kind in ("definitions", "extruders")
            for path in (self.folder / kind).glob("*.json")
        }
        resources.getPath = classmethod(lambda cls, kind, *name: paths[Path(*name).name])
        import_name("UM.Settings.ContainerRegistry", "ContainerRegistry").getInstance = staticmethod(
            lambda: self.registry
        )
        for module in ("UM.Settings.InstanceContainer", "UM.Settings.ContainerStack"):
            importlib.import_module(module).setContainerRegistry(self.registry)
        self.Material = import_name("XmlMaterialProfile.XmlMaterialProfile", "XmlMaterialProfile")
        products = json.loads(
            (root / "usr/lib/cura/plugins/XmlMaterialProfile/product_to_id.json").read_text()
        )
        self.Material.getProductIdMap = classmethod(
            lambda cls: {name: [item] for name, item in products.items()}
        )
        # The files are of this version, so they need no upgrade.
        import_name("UM.Settings.Interfaces", "ContainerInterface")._updateSerialized = classmethod(
            lambda cls, text, name=None, **rest: text
        )
        # Add the properties and types that CuraApplication adds.
        definition = import_name("UM.Settings.SettingDefinition", "SettingDefinition")
        kind = import_name("UM.Settings.SettingDefinition", "DefinitionPropertyType")
        for name, default in {
            "settable_per_mesh": True,
            "settable_per_extruder": True,
            "settable_per_meshgroup": True,
            "settable_globally": True,
        }.items():
            definition.addSupportedProperty(name, kind.Any, default=default, read_only=True)
        definition.addSupportedProperty("limit_to_extruder", kind.Function, default="-1", depends_on="value")
        definition.addSupportedProperty("resolve", kind.Function, default=None, depends_on="value")
        # From 5.0 on, extruder numbers are integers.
        convert = getattr(importlib.import_module("UM.Settings.SettingDefinition"), "toIntConversion", str)
        for name in ("extruder", "optional_extruder"):
            definition.addSettingType(name, None, convert, None)
        definition.addSettingType("[int]", None, str, None)
        functions = import_name("cura.Settings.CuraFormulaFunctions", "CuraFormulaFunctions")(application)
        for name, call in {
            "defaultExtruderPosition": "getDefaultExtruderPosition",
            "extruderValue": "getValueInExtruder",
            "extruderValues": "getValuesInAllExtruders",
            "resolveOrValue": "getResolveOrValue",
            "valueFromContainer": "getValueFromContainerAtIndex",
            "extruderValueFromContainer": "getValueFromContainerAtIndexInExtruder",
        }.items():
            self.Function.registerOperator(name, getattr(functions, call))

    def load_definition(self, name, kind="definitions"):
        if name not in self.registry.containers:
            container = self.Definition(name)
            container.deserialize((self.folder / kind / f"{name}.def.json").read_text())
            self.registry.addContainer(container)
        return self.registry.containers[name]

    def load_profile(self, path, definition):
        container = self.Instance(path.name)
        container.setDefinition(definition)
        container.deserialize(path.read_text(), path.name)
        container.getDefinition = lambda: self.load_definition(definition)
        return container

    def make_empty_container(self, name):
        container = self.Instance(name)
        container.setMetaDataEntry("type", name)
        return container

    def list_profiles(self, kind, definition):
        return [
            self.load_profile(path, definition)
            for path in sorted((self.folder / kind).rglob("*.inst.cfg"))
            if f"\ndefinition = {definition}\n" in path.read_text()
        ]

    def find_material(self, name, machine, hotend):
        """Return the most specific container of a material, as Cura's VariantNode does."""
        if name not in self.registry.containers:
            container = self.Material(name)
            self.registry.addContainer(container)
            container.deserialize((self.folder / "materials" / f"{name}.xml.fdm_material").read_text(), name)
        names = (f"{name}_{machine}_{hotend.replace(' ', '_')}", f"{name}_{machine}", name)
        return next(self.registry.containers[item] for item in names if item in self.registry.containers)

    def record_settings(self, machine, hotend, material, quality, user_changes):
        definition = self.load_definition(machine)
        metadata = definition.getMetaData()
        quality_definition = metadata.get("quality_definition", machine)
        qualities = [
            item
            for item in self.list_profiles("quality", quality_definition)
            if item.getMetaDataEntry("quality_type") == quality
        ]
        global_quality = next(item for item in qualities if item.getMetaDataEntry("global_quality") == "True")
        variant, own_quality = self.make_empty_container("variant"), global_quality
        kind = self.find_material(material, machine, hotend).getMetaDataEntry("material")
        if metadata.get("has_variants"):
            variant = next(
                item for item in self.list_profiles("variants", machine) if item.getName() == hotend
            )
            fitting_qualities = [item for item in qualities if item.getMetaDataEntry("variant") == hotend]
            own_quality = next(
                (item for item in fitting_qualities if item.getMetaDataEntry("material") == material), None
            ) or next(
                item
                for item in fitting_qualities
                if self.find_material(item.getMetaDataEntry("material"), machine, hotend).getMetaDataEntry(
                    "material"
                )
                == kind
            )
        global_stack = self.Global("global")
        extruder_stack = self.Extruder("extruder")
        self.managers.activeMachine = global_stack
        extruder_definition = self.load_definition(metadata["machine_extruder_trains"]["0"], "extruders")
        self.fill_stack(
            global_stack,
            [None, None, None, global_quality, None, None, None, definition],
            user_changes,
            machine,
        )
        self.fill_stack(
            extruder_stack,
            [
                None,
                None,
                None,
                own_quality,
                self.find_material(material, machine, hotend),
                variant,
                None,
                extruder_definition,
            ],
            user_changes,
            machine,
        )
        extruder_stack.setMetaDataEntry("position", "0")
        extruder_stack.setNextStack(global_stack)
        global_stack._extruders["0"] = extruder_stack
        keys = sorted(definition.getAllKeys() | extruder_definition.getAllKeys())
        settings = [
            key
            for key in keys
            if (definition.findDefinitions(key=key) or extruder_definition.findDefinitions(key=key))[0].type
            != "category"
        ]
        return {
            "global": {
                key: str(global_stack.getProperty(key, "value"))
                for key in settings
                if definition.findDefinitions(key=key)
            },
            "extruder": {
                key: str(extruder_stack.getProperty(key, "value"))
                for key in settings
                if extruder_stack.getProperty(key, "settable_per_extruder")
            },
        }

    def fill_stack(self, stack, containers, user_changes, machine):
        names = (
            "user",
            "quality_changes",
            "intent",
            "quality",
            "material",
            "variant",
            "definition_changes",
            "",
        )
        stack._containers = [
            item or self.make_empty_container(name) for item, name in zip(containers, names, strict=True)
        ]
        changes = self.Instance("changes")
        changes.getDefinition = lambda: self.load_definition(machine)
        changes.setDefinition(machine)
        for key, value in user_changes.items():
            is_formula = isinstance(value, str) and value.startswith("=")
            changes.setProperty(key, "value", self.Function(value[1:]) if is_formula else value, None, False)
        stack._containers[0] = changes


def main():
    root, path = Path(sys.argv[1]).resolve(), Path(sys.argv[2])
    cura = Cura(root)
    records = [cura.record_settings(*combination) for combination in COMBINATIONS]
    tables = {}
    for scope in ("global", "extruder"):
        keys = sorted({key for item in records for key in item[scope]})
        tables[scope] = {key: [item[scope].get(key) for item in records] for key in keys}
    content = json.dumps({"combinations": COMBINATIONS, **tables}, indent=0)
    path.write_bytes(gzip.compress(content.encode(), 9, mtime=0))


if __name__ == "__main__":
    main()
