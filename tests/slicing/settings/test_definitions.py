"""Values of settings in both stacks, with small definitions."""

import pytest

from slicing.errors import BadSetting, DefinitionError
from slicing.settings.definitions import fits_type, merge_definitions, parse_value
from slicing.settings.formula import Formula
from slicing.settings.resolver import ProfileIndex, Resolver, Scope


def make_entry(kind="float", **fields):
    return {"type": kind, **fields}


ROOT = {
    "settings": {
        "group": {
            "type": "category",
            "children": {
                "height": make_entry(default_value=0.1, settable_per_extruder=False, minimum_value="0.001"),
                "width": make_entry(default_value=0.4, maximum_value="2 * height + 10"),
                "bed": make_entry(
                    default_value=60,
                    settable_per_extruder=False,
                    resolve="max(extruderValues('bed'))",
                    value="warmth",
                ),
                "warmth": make_entry(
                    default_value=60,
                    children={"child": make_entry("int", default_value=7, value="int(width*10)")},
                ),
                "limited": make_entry(default_value=1, value="width", limit_to_extruder="nr"),
                "nr": make_entry("optional_extruder", default_value="-1", settable_per_extruder=False),
                "self": make_entry(
                    default_value=1, settable_per_extruder=False, resolve="resolveOrValue('self') + 1"
                ),
                "loop": make_entry(value="loop2"),
                "loop2": make_entry(value="loop"),
                "kind": make_entry(
                    "enum", default_value="grid", options={"grid": "", "zigzag": "", "lines": ""}
                ),
                "flag": make_entry("bool", default_value=False),
                "areas": make_entry("polygons", default_value=[]),
                "angles": make_entry("[int]", default_value="[ ]"),
            },
        }
    }
}
CHILD = {"overrides": {"width": {"default_value": 0.5}, "warmth": {"value": "50"}, "gone": {"value": "1"}}}
GRANDCHILD = {"overrides": {"warmth": {"default_value": 99}}}
EXTRUDER_TRAIN = {"settings": {"nozzle": make_entry(default_value=0.4)}}


def make_resolver(user=(), extruder=(), global_values=()):
    user = dict(user)
    profiles = {
        Scope.GLOBAL: {ProfileIndex.USER: user, ProfileIndex.QUALITY: dict(global_values)},
        Scope.EXTRUDER: {ProfileIndex.USER: user, ProfileIndex.MATERIAL: dict(extruder)},
    }
    return Resolver(
        merge_definitions([ROOT, CHILD, GRANDCHILD]), merge_definitions([EXTRUDER_TRAIN]), profiles
    )


def test_formula_of_a_parent_precedes_a_plain_value_of_a_child():
    assert make_resolver().compute_value(Scope.EXTRUDER, "warmth") == 50


def test_extruder_falls_through_to_the_machine():
    assert make_resolver().compute_value(Scope.EXTRUDER, "width") == 0.5
    assert make_resolver(extruder={"width": 0.6}).compute_value(Scope.EXTRUDER, "child") == 6
    assert make_resolver(extruder={"width": 0.6}).compute_value(Scope.GLOBAL, "child") == 5


def test_setting_that_is_not_per_extruder_has_the_global_value():
    assert (
        make_resolver(extruder={"height": 9.0}, global_values={"height": 0.2}).compute_value(
            Scope.EXTRUDER, "height"
        )
        == 0.2
    )


def test_resolve_uses_the_extruder_unless_the_value_is_set():
    assert make_resolver(extruder={"warmth": 70.0}).compute_value(Scope.GLOBAL, "bed") == 70.0
    assert make_resolver(user={"bed": 45.0}).compute_value(Scope.GLOBAL, "bed") == 45.0


@pytest.mark.parametrize(("number", "value"), [("0", 0.7), (-1, 0.7), ("-1", 0.5)])
def test_limited_setting_has_the_value_of_its_extruder_if_any(number, value):
    limited_resolver = make_resolver(extruder={"width": 0.7}, global_values={"nr": number})
    assert limited_resolver.compute_value(Scope.GLOBAL, "limited") == value


def test_value_of_the_user_precedes_a_formula():
    assert (
        make_resolver(user={"width": 1.0}, extruder={"width": Formula("height")}).compute_value(
            Scope.EXTRUDER, "width"
        )
        == 1.0
    )


def test_resolve_may_refer_to_itself_once():
    assert make_resolver().compute_value(Scope.GLOBAL, "self") == 2


def test_circular_formula_is_an_error():
    with pytest.raises(DefinitionError, match="depends on itself"):
        make_resolver().compute_value(Scope.EXTRUDER, "loop")


def test_error_for_an_unknown_key_names_the_nearest_key():
    with pytest.raises(BadSetting, match="heigth: Cura has no such setting; did you mean height"):
        make_resolver().find_setting("heigth")


@pytest.mark.parametrize(
    ("key", "raw", "value"),
    [
        ("width", "0.35", 0.35),
        ("child", "3.0", 3),
        ("flag", "TRUE", True),
        ("kind", "zigzag", "zigzag"),
        ("areas", "[[[1, 2]]]", [[[1, 2]]]),
        ("angles", "[0, -45]", [0, -45]),
        ("nr", "-1", "-1"),
    ],
)
def test_values_are_read_by_type(key, raw, value):
    parsed_value = parse_value(make_resolver().find_setting(key), raw)
    assert parsed_value == value
    assert type(parsed_value) is type(value)


@pytest.mark.parametrize(
    ("key", "raw"),
    [
        ("width", "abc"),
        ("width", "nan"),
        ("width", "inf"),
        ("child", "1.5"),
        ("flag", "maybe"),
        ("kind", "ZigZag"),
        ("areas", "7"),
        ("angles", "[1.5]"),
        ("angles", "['x']"),
        ("angles", "[[1]]"),
        ("areas", "__import__('os')"),
        ("nr", "4"),
    ],
)
def test_values_of_another_type_are_refused(key, raw):
    with pytest.raises(BadSetting, match=key):
        parse_value(make_resolver().find_setting(key), raw)


def test_limits_are_computed():
    assert make_resolver(user={"height": 0.25}).compute_bounds(Scope.EXTRUDER, "width") == (None, 10.5)
    assert make_resolver().compute_bounds(Scope.GLOBAL, "height") == (0.001, None)


def test_only_keys_of_the_extruder_are_listed_for_it():
    keys = make_resolver().list_keys(Scope.EXTRUDER)
    assert "nozzle" in keys
    assert "width" in keys
    assert not {"height", "group", "bed"} & set(keys)


@pytest.mark.parametrize(
    ("formula", "value"),
    [
        ("extruderValueFromContainer(0, 'width', 0)", 3.0),  # the profile of the user and all lower ones
        ("extruderValueFromContainer(0, 'width', 3)", 2.0),  # the profile of the quality and all lower ones
        ("extruderValueFromContainer(0, 'width', 7)", 0.5),  # the definition
        ("extruderValueFromContainer(0, 'child', 4)", 20),  # its inputs are read from the definition too
        ("valueFromContainer('height', 3)", 0.2),
        ("int(anyExtruderWithMaterial('flag')) + int(anyExtruderNrWithOrDefault('flag'))", 0),
    ],
)
def test_cura_5_formula_reads_the_value_below_its_profile(formula, value):
    user = {"width": 3.0, "height": 0.9, "warmth": Formula(formula)}
    resolver = make_resolver(user=user, extruder={"width": 2.0}, global_values={"height": 0.2})
    assert resolver.compute_value(Scope.EXTRUDER, "warmth") == value
    assert resolver.compute_value(Scope.EXTRUDER, "width") == 3.0  # elsewhere, the value is unchanged


def test_setting_is_enabled_according_to_its_definition():
    extra_definition = {
        "overrides": {"child": {"enabled": "flag and width > 1"}, "areas": {"enabled": "[x for x in y]"}}
    }
    machine = merge_definitions([ROOT, extra_definition])

    def is_enabled(key, **user):
        return Resolver(
            machine, merge_definitions([EXTRUDER_TRAIN]), {Scope.EXTRUDER: {ProfileIndex.USER: user}}
        ).is_enabled(key)

    assert not is_enabled("child")
    assert is_enabled("child", flag=True, width=2.0)
    assert is_enabled("areas")  # this formula is only for the user interface


@pytest.mark.parametrize(
    ("key", "valid_value", "invalid_value"),
    [
        ("width", [0.4, 3], [None, "0.4", float("nan")]),
        ("child", [3, 3.0], [3.5, "3"]),
        ("flag", [True, 0], ["yes", None]),
        ("kind", ["grid"], ["Grid", 1]),
        ("nr", ["0", -1], ["2", None]),
        ("areas", [[], "[[1, 2]]"], ["(1, 2)", "[", 1]),
        ("angles", ["[ ]", [20, 110]], [[0.5], "[True]", "0"]),
    ],
)
def test_computed_value_has_the_type_of_its_setting(key, valid_value, invalid_value):
    setting = make_resolver().find_setting(key)
    assert all(fits_type(setting, value) for value in valid_value)
    assert not any(fits_type(setting, value) for value in invalid_value)
