"""Cura's settings, resolved: two stacks of profiles over two definitions, and the formulas in them.

The rules are those of Cura 4.13 (``GlobalStack``, ``ExtruderStack``, ``CuraFormulaFunctions``):

- Layers, first wins: user, quality, material, variant, definition. The extruder's stack falls through to
  the global one.
- What is not settable per extruder is always asked of the global stack.
- The global stack tries ``resolve`` (unless a layer of it sets the value), then the extruder, where
  ``limit_to_extruder`` says so, then its own value. In a definition a ``value`` beats any ``default_value``.
- A formula's names are looked up in the stack that was asked, even where the formula comes from the other.

One extruder, as the Ultimaker 2+ has.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from slicing.errors import BadSetting, DefinitionError, nearest
from slicing.formula import Formula, evaluate

Layer = Mapping[str, Any]
"""A profile: a value or a Formula for each key that it sets."""


class Scope(StrEnum):
    """Which stack is asked."""

    GLOBAL = "global"
    EXTRUDER = "extruder"


class SettingType(StrEnum):
    """The types of Cura's settings."""

    BOOL = "bool"
    INT = "int"
    FLOAT = "float"
    STR = "str"
    ENUM = "enum"
    EXTRUDER = "extruder"
    OPTIONAL_EXTRUDER = "optional_extruder"
    INTS = "[int]"
    POLYGON = "polygon"
    POLYGONS = "polygons"


_LISTS = (SettingType.INTS, SettingType.POLYGON, SettingType.POLYGONS)
_EXTRUDERS = (SettingType.EXTRUDER, SettingType.OPTIONAL_EXTRUDER)


@dataclass(frozen=True, slots=True)
class Setting:
    """What a definition says of one setting. Limits and scope may be formulas."""

    key: str
    type: SettingType
    default: Any
    value: Formula | None = None
    resolve: Formula | None = None
    limit_to_extruder: Formula | None = None
    per_extruder: Any = True
    minimum: Any = None
    maximum: Any = None
    options: tuple[str, ...] = ()


def _formula(raw: Any) -> Formula | None:
    return None if raw is None else Formula(str(raw))


def _limit(raw: Any) -> Any:
    return Formula(raw) if isinstance(raw, str) else raw


def merge(chain: Sequence[Mapping[str, Any]]) -> dict[str, Setting]:
    """The settings of a definition that inherits.

    Parameters
    ----------
    chain
        The parsed ``.def.json`` files, the one at the root of the inheritance first.
    """
    raw: dict[str, dict[str, Any]] = {}

    def collect(settings: Mapping[str, Any]) -> None:
        for key, entry in settings.items():
            if entry.get("type") != "category":
                raw[key] = {k: v for k, v in entry.items() if k != "children"}
            collect(entry.get("children", {}))

    for file in chain:
        collect(file.get("settings", {}))
        for key, override in file.get("overrides", {}).items():
            if key in raw:
                raw[key] = {**raw[key], **override}
    return {key: _setting(key, entry) for key, entry in raw.items()}


def _setting(key: str, entry: Mapping[str, Any]) -> Setting:
    try:
        kind = SettingType(entry["type"])
    except ValueError:
        raise DefinitionError(
            f"Cura's setting {key} has the unknown type {entry['type']!r}; Cura 4.13 is needed"
        ) from None
    return Setting(
        key=key,
        type=kind,
        default=entry.get("default_value"),
        value=_formula(entry.get("value")),
        resolve=_formula(entry.get("resolve")),
        limit_to_extruder=_formula(entry.get("limit_to_extruder")),
        per_extruder=_limit(entry.get("settable_per_extruder", True)),
        minimum=_limit(entry.get("minimum_value")),
        maximum=_limit(entry.get("maximum_value")),
        options=tuple(entry.get("options", ())),
    )


def parse_value(setting: Setting, raw: Any) -> Any:
    """A value as a profile or a person writes it, in the setting's own type.

    Raises
    ------
    BadSetting
        Where it is of another type, not finite, or not one of the options.
    """
    text = str(raw).strip()
    try:
        match setting.type:
            case SettingType.BOOL:
                return {"true": True, "false": False}[text.lower()]
            case SettingType.INT | SettingType.FLOAT:
                number = float(text)
                whole = setting.type is SettingType.INT
                if not math.isfinite(number) or (whole and not number.is_integer()):
                    raise ValueError
                return int(number) if whole else number
            case SettingType.ENUM if text not in setting.options:
                hint = nearest(text, setting.options) or f"; one of {', '.join(setting.options)}"
                raise BadSetting(f"{setting.key}={raw}: there is no such choice{hint}")
            case kind if kind in _EXTRUDERS:
                if text not in ("0", "-1"):
                    raise ValueError
                return text
            case kind if kind in _LISTS:
                items = ast.literal_eval(text)
                if not isinstance(items, list):
                    raise ValueError
                return items
    except (KeyError, ValueError, SyntaxError):
        raise BadSetting(f"{setting.key}={raw}: not a value of type {setting.type}") from None
    return str(raw)


class Resolver:
    """The value of every setting, for one combination of profiles.

    Parameters
    ----------
    machine, extruder
        The two definitions, merged.
    global_layers, extruder_layers
        Profiles by precedence, the user's first.
    """

    def __init__(
        self,
        machine: Mapping[str, Setting],
        extruder: Mapping[str, Setting],
        global_layers: Sequence[Layer],
        extruder_layers: Sequence[Layer],
    ) -> None:
        self._definitions = {Scope.GLOBAL: machine, Scope.EXTRUDER: extruder}
        self._layers = {Scope.GLOBAL: tuple(global_layers), Scope.EXTRUDER: tuple(extruder_layers)}
        self._memo: dict[tuple[Scope, str, frozenset[str]], Any] = {}
        self._active: set[tuple[Scope, str, frozenset[str]]] = set()
        self._resolving: frozenset[str] = frozenset()  # keys whose `resolve` is being worked out
        self._functions: dict[str, Callable[..., Any]] = {
            "extruderValue": lambda _, key: self._own(Scope.EXTRUDER, key),
            "extruderValues": lambda key: [self._own(Scope.EXTRUDER, key)],
            "resolveOrValue": lambda key: self.value(Scope.GLOBAL, key),
            "defaultExtruderPosition": lambda: "0",
        }

    def setting(self, key: str) -> Setting:
        """What the definitions say of a key. Raises BadSetting with the nearest keys where there is none."""
        machine, extruder = self._definitions[Scope.GLOBAL], self._definitions[Scope.EXTRUDER]
        found = machine.get(key) or extruder.get(key)
        if found is None:
            raise BadSetting(f"{key}: Cura has no such setting{nearest(key, (*machine, *extruder))}")
        return found

    def keys(self, scope: Scope) -> list[str]:
        """The keys that the engine wants in a scope: all of the machine's, or what an extruder may set."""
        machine, extruder = self._definitions[Scope.GLOBAL], self._definitions[Scope.EXTRUDER]
        if scope is Scope.GLOBAL:
            return list(machine)
        return [key for key in {**machine, **extruder} if self._per_extruder(key)]

    def value(self, scope: Scope, key: str) -> Any:
        """The value of a setting as one of the stacks has it.

        Raises
        ------
        KeyError
            Where no definition has the key.
        DefinitionError
            Where a formula cannot be worked out.
        """
        if scope is Scope.EXTRUDER:
            return self._own(scope, key) if self._per_extruder(key) else self.value(Scope.GLOBAL, key)
        setting = self._definitions[Scope.GLOBAL].get(key)
        if setting is None:
            raise KeyError(key)
        if setting.resolve and key not in self._resolving and not self._is_set_globally(key):
            outer = self._resolving
            self._resolving = outer | {key}
            try:
                return self._evaluate(Scope.GLOBAL, key, setting.resolve)
            finally:
                self._resolving = outer
        if setting.limit_to_extruder and self._per_extruder(key):
            return self._own(Scope.EXTRUDER, key)
        return self._own(Scope.GLOBAL, key)

    def check_range(self, key: str) -> None:
        """Raise BadSetting where the value of a key is below its least or above its greatest."""
        setting = self.setting(key)
        value = self.value(Scope.EXTRUDER, key)
        if isinstance(value, bool) or not isinstance(value, int | float):
            return
        least = self._limit(key, setting.minimum)
        greatest = self._limit(key, setting.maximum)
        if (least is not None and value < least) or (greatest is not None and value > greatest):
            bounds = " and ".join(
                f"{word} {bound:g}"
                for word, bound in (("least", least), ("greatest", greatest))
                if bound is not None
            )
            raise BadSetting(f"{key}={value:g} is out of range; {bounds}")

    def _limit(self, key: str, raw: Any) -> float | None:
        limit = self._evaluate(Scope.EXTRUDER, key, raw) if isinstance(raw, Formula) else raw
        return None if limit is None else float(limit)

    def _per_extruder(self, key: str) -> bool:
        machine, extruder = self._definitions[Scope.GLOBAL], self._definitions[Scope.EXTRUDER]
        setting = extruder.get(key) or machine.get(key)
        if setting is None:
            raise KeyError(key)
        raw = setting.per_extruder
        return bool(self._evaluate(Scope.GLOBAL, key, raw) if isinstance(raw, Formula) else raw)

    def _is_set_globally(self, key: str) -> bool:
        return any(key in layer for layer in self._layers[Scope.GLOBAL])

    def _raw(self, scope: Scope, key: str) -> Any:
        """The first value or formula on the way down a stack."""
        for layer in self._layers[scope]:
            if key in layer:
                return layer[key]
        setting = self._definitions[scope].get(key)
        if setting is not None:
            return setting.default if setting.value is None else setting.value
        if scope is Scope.EXTRUDER:
            return self._raw(Scope.GLOBAL, key)
        raise KeyError(key)

    def _own(self, scope: Scope, key: str) -> Any:
        """A stack's own value, its formula worked out in that stack."""
        raw = self._raw(scope, key)
        if not isinstance(raw, Formula):
            return raw
        step = (scope, key, self._resolving)
        if step in self._memo:
            return self._memo[step]
        if step in self._active:
            raise DefinitionError(f"Cura's setting {key} depends on itself")
        self._active.add(step)
        try:
            self._memo[step] = self._evaluate(scope, key, raw)
        finally:
            self._active.discard(step)
        return self._memo[step]

    def _evaluate(self, scope: Scope, key: str, formula: Formula) -> Any:
        try:
            return evaluate(formula, lambda name: self.value(scope, name), self._functions)
        except DefinitionError as error:
            raise DefinitionError(f"{key}: {error}") from error
