"""Resolution of Cura's settings: two stacks of profiles over two definitions, and the formulas in them.

The rules are those of Cura 4.13 (``GlobalStack``, ``ExtruderStack``, ``CuraFormulaFunctions``):

- The first of these profiles takes precedence: user, quality, material, variant, definition. The extruder's
  stack falls through to the global one.
- A setting that is not settable per extruder is always looked up in the global stack.
- The global stack tries ``resolve`` (unless the user has set the value), then the extruder, if
  ``limit_to_extruder`` says so, then its own value. In a definition ``value`` takes precedence over
  ``default_value``.
- A formula's names are looked up in the same stack, even if the formula comes from the other.

Only one extruder is supported, as in the Ultimaker 2 family.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import IntEnum, StrEnum
from typing import Any

from slicing.errors import BadSetting, DefinitionError, suggest_names
from slicing.settings.definitions import Setting
from slicing.settings.formula import Formula, evaluate_formula

ProfileValues = Mapping[str, Any]
"""Values of a profile: a value or a Formula for each key that it sets."""


class Scope(StrEnum):
    """Stack of profiles."""

    GLOBAL = "global"
    EXTRUDER = "extruder"


class ProfileIndex(IntEnum):
    """Index of a profile in a stack, as Cura numbers them (``_ContainerIndexes``)."""

    USER = 0
    QUALITY = 3
    MATERIAL = 4
    VARIANT = 5


class Resolver:
    """Values of all settings, for one combination of profiles.

    Parameters
    ----------
    machine, extruder
        The two definitions, merged.
    profiles
        The profiles of each stack, by their index.
    """

    def __init__(
        self,
        machine: Mapping[str, Setting],
        extruder: Mapping[str, Setting],
        profiles: Mapping[Scope, Mapping[ProfileIndex, ProfileValues]],
    ) -> None:
        self._definitions = {Scope.GLOBAL: machine, Scope.EXTRUDER: extruder}
        self._profiles = {scope: sorted(profiles.get(scope, {}).items()) for scope in Scope}
        self._memo: dict[tuple[Scope, str, frozenset[str], int], Any] = {}
        self._active_lookups: set[tuple[Scope, str, frozenset[str], int]] = set()
        self._resolving_keys: frozenset[str] = frozenset()  # keys whose `resolve` is being computed
        self._first_index = 0  # index at which the look-up begins
        self._functions: dict[str, Callable[..., Any]] = {
            "extruderValue": lambda _, key: self._compute_own_value(Scope.EXTRUDER, key),
            "extruderValues": lambda key: [self._compute_own_value(Scope.EXTRUDER, key)],
            "resolveOrValue": lambda key: self.compute_value(Scope.GLOBAL, key),
            "defaultExtruderPosition": lambda: "0",
            # functions of Cura 5
            "anyExtruderWithMaterial": lambda _: "0",
            "anyExtruderNrWithOrDefault": lambda _: "0",
            "valueFromContainer": lambda key, index: self._compute_value_below(index, Scope.GLOBAL, key),
            "extruderValueFromContainer": lambda _, key, index: self._compute_value_below(
                index, Scope.EXTRUDER, key
            ),
        }

    def find_setting(self, key: str) -> Setting:
        """Find the definition of a key; raises BadSetting with similar keys if there is none."""
        machine, extruder = self._definitions[Scope.GLOBAL], self._definitions[Scope.EXTRUDER]
        setting = machine.get(key) or extruder.get(key)
        if setting is None:
            raise BadSetting(f"{key}: Cura has no such setting{suggest_names(key, (*machine, *extruder))}")
        return setting

    def list_keys(self, scope: Scope) -> list[str]:
        """List the keys that the engine needs: all of the machine's, or those that an extruder may set."""
        machine, extruder = self._definitions[Scope.GLOBAL], self._definitions[Scope.EXTRUDER]
        if scope is Scope.GLOBAL:
            return list(machine)
        return [key for key in {**machine, **extruder} if self.is_per_extruder(key)]

    def compute_value(self, scope: Scope, key: str) -> Any:
        """Compute the value of a setting in one of the stacks.

        Parameters
        ----------
        scope
            The stack.
        key
            Cura's name of the setting.

        Raises
        ------
        KeyError
            If no definition has the key.
        DefinitionError
            If a formula cannot be computed.
        """
        if scope is Scope.EXTRUDER:
            return (
                self._compute_own_value(scope, key)
                if self.is_per_extruder(key)
                else self.compute_value(Scope.GLOBAL, key)
            )
        setting = self._definitions[Scope.GLOBAL].get(key)
        if setting is None:
            raise KeyError(key)
        if setting.resolve and key not in self._resolving_keys and not self._is_user_set(key):
            outer = self._resolving_keys
            self._resolving_keys = outer | {key}
            try:
                return self._evaluate_formula(Scope.GLOBAL, key, setting.resolve)
            finally:
                self._resolving_keys = outer
        if self._is_limited(setting) and self.is_per_extruder(key):
            return self._compute_own_value(Scope.EXTRUDER, key)
        return self._compute_own_value(Scope.GLOBAL, key)

    def compute_bounds(self, scope: Scope, key: str) -> tuple[float | None, float | None]:
        """Compute the minimum and the maximum of a key from its definition; None if there is no limit."""
        setting = self.find_setting(key)
        return self._read_bound(scope, key, setting.minimum), self._read_bound(scope, key, setting.maximum)

    def is_enabled(self, key: str) -> bool:
        """Check whether a setting has an effect with the values of the others; Cura hides it otherwise."""
        raw_value = self.find_setting(key).enabled
        try:
            return bool(
                self._evaluate_formula(Scope.EXTRUDER, key, raw_value)
                if isinstance(raw_value, Formula)
                else raw_value
            )
        except DefinitionError:  # a formula that only Cura's user interface needs
            return True

    def is_per_extruder(self, key: str) -> bool:
        """Check whether the extruder has its own value."""
        machine, extruder = self._definitions[Scope.GLOBAL], self._definitions[Scope.EXTRUDER]
        setting = extruder.get(key) or machine.get(key)
        if setting is None:
            raise KeyError(key)
        raw_value = setting.per_extruder
        return bool(
            self._evaluate_formula(Scope.GLOBAL, key, raw_value)
            if isinstance(raw_value, Formula)
            else raw_value
        )

    def _read_bound(self, scope: Scope, key: str, raw_value: Any) -> float | None:
        bound = self._evaluate_formula(scope, key, raw_value) if isinstance(raw_value, Formula) else raw_value
        return None if bound is None else float(bound)

    def _is_limited(self, setting: Setting) -> bool:
        """Check whether the global stack uses the extruder's value; the text "-1" means that it does not."""
        if setting.limit_to_extruder is None:
            return False
        return bool(self._evaluate_formula(Scope.GLOBAL, setting.key, setting.limit_to_extruder) != "-1")

    def _is_user_set(self, key: str) -> bool:
        return any(
            key in profile for index, profile in self._profiles[Scope.GLOBAL] if index is ProfileIndex.USER
        )

    def _find_raw_value(self, scope: Scope, key: str) -> Any:
        """Find the first value or formula of a key in a stack, from the top down."""
        for index, profile in self._profiles[scope]:
            if key in profile and index >= self._first_index:
                return profile[key]
        setting = self._definitions[scope].get(key)
        if setting is not None:
            return setting.default if setting.value is None else setting.value
        if scope is Scope.EXTRUDER:
            return self._find_raw_value(Scope.GLOBAL, key)
        raise KeyError(key)

    def _compute_value_below(self, index: int, scope: Scope, key: str) -> Any:
        """Compute a value without the profiles above an index."""
        outer, self._first_index = self._first_index, index
        try:
            return self.compute_value(scope, key)
        finally:
            self._first_index = outer

    def _compute_own_value(self, scope: Scope, key: str) -> Any:
        """Compute a stack's own value; the names in its formula are looked up in the same stack."""
        raw_value = self._find_raw_value(scope, key)
        if not isinstance(raw_value, Formula):
            return raw_value
        lookup = (scope, key, self._resolving_keys, self._first_index)
        if lookup in self._memo:
            return self._memo[lookup]
        if lookup in self._active_lookups:
            raise DefinitionError(f"Cura's setting {key} depends on itself")
        self._active_lookups.add(lookup)
        try:
            self._memo[lookup] = self._evaluate_formula(scope, key, raw_value)
        finally:
            self._active_lookups.discard(lookup)
        return self._memo[lookup]

    def _evaluate_formula(self, scope: Scope, key: str, formula: Formula) -> Any:
        try:
            return evaluate_formula(formula, lambda name: self.compute_value(scope, name), self._functions)
        except DefinitionError as error:
            raise DefinitionError(f"{key}: {error}") from error
