"""One palette for all charts: every kind has a light and a dark colour, on which its text is readable."""

import re
from importlib.resources import files

import pytest

from farm.views.charts import BAR_KINDS, load_palette

OUTCOMES = ("waiting", "printing", "printed", "good", "bad", "failed", "cancelled", "other")
STATIC_FOLDER = files("farm.web.pages").joinpath("static")


def read_variables(text, is_dark):
    """Return the variables of the light block, overridden by those of the dark block if `is_dark`."""
    light_block, _, dark_block = text.partition("@media print")[0].partition(
        "@media screen and (prefers-color-scheme: dark)"
    )
    variables = dict(re.findall(r"--([\w-]+): (#\w+)", light_block))
    return variables | dict(re.findall(r"--([\w-]+): (#\w+)", dark_block)) if is_dark else variables


def compute_luminance(colour):
    """Compute the relative luminance of a colour by WCAG 2."""
    digits = colour.lstrip("#")
    digits = digits if len(digits) == 6 else "".join(2 * digit for digit in digits)
    channels = [int(digits[start : start + 2], 16) / 255 for start in (0, 2, 4)]
    linear_channels = [
        channel / 12.92 if channel <= 0.04045 else ((channel + 0.055) / 1.055) ** 2.4 for channel in channels
    ]
    return sum(
        weight * value for weight, value in zip((0.2126, 0.7152, 0.0722), linear_channels, strict=True)
    )


def compute_contrast(first_colour, second_colour):
    """Compute the contrast of two colours by WCAG 2."""
    darker, lighter = sorted((compute_luminance(first_colour), compute_luminance(second_colour)))
    return (lighter + 0.05) / (darker + 0.05)


@pytest.mark.parametrize("is_dark", [False, True])
def test_outcomes_differ_and_their_text_can_be_read(is_dark):
    colours = read_variables(load_palette(), is_dark)
    card = read_variables(STATIC_FOLDER.joinpath("farm.css").read_text(), is_dark)["card"]
    fills = [colours[f"fill-{outcome}"] for outcome in OUTCOMES]
    assert len(set(fills)) == len(OUTCOMES)
    for outcome in OUTCOMES:
        fill = colours[f"fill-{outcome}"]
        assert compute_contrast(fill, colours[f"ink-{outcome}"]) >= 4.5, outcome
        if outcome not in ("waiting", "other"):  # bars of the future and of other jobs have less contrast
            assert compute_contrast(fill, card) >= 3.0, outcome
    assert compute_contrast(colours["fill-printing"], colours["fill-printed"]) >= 2.0


def test_colours_of_bars_are_defined_only_in_the_palette():
    palette = load_palette()
    for kind in (*BAR_KINDS, "planned"):
        assert f".bar-{kind.replace(' ', '-')}" in palette
    for name in ("farm.css", "charts.css"):
        text = STATIC_FOLDER.joinpath(name).read_text()
        assert not re.search(r"\.bar[.-](good|printed|bad|failed|cancelled|printing|planned)", text), name
        assert not re.search(r"--(fill|ink|part)-\w+:", text), name


def test_3d_view_has_the_colours_of_the_charts():
    view = files("farm.web.pages").joinpath("browser", "job_view.js").read_text()
    names = re.search(r"const STATES = \[(.*?)\]", view).group(1)
    assert set(re.findall(r'"(\w+)"', names)) == set(OUTCOMES) - {"other"}
    assert "`--fill-$" in view
    assert not re.search(r'"--', view)
