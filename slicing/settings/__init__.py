"""Settings of CuraEngine, resolved from Cura's files, the farm's qualities and a person's overrides."""

from slicing.settings.engine_settings import EngineSettings
from slicing.settings.layer_heights import LayerFit
from slicing.settings.plate_settings import DEFAULT_PART, PartSettings, SettingsRequest, resolve_settings
from slicing.settings.qualities import DEFAULT_QUALITY, FARM_QUALITIES, SMALL_OVERHANG_MM2
from slicing.settings.resources import (
    INSTALLATION_FOLDER,
    OWN_MATERIALS_VARIABLE,
    Resources,
    find_engine,
    find_resources,
)

__all__ = [
    "DEFAULT_PART",
    "DEFAULT_QUALITY",
    "FARM_QUALITIES",
    "INSTALLATION_FOLDER",
    "OWN_MATERIALS_VARIABLE",
    "SMALL_OVERHANG_MM2",
    "EngineSettings",
    "LayerFit",
    "PartSettings",
    "Resources",
    "SettingsRequest",
    "find_engine",
    "find_resources",
    "resolve_settings",
]
