"""Options of the engines: one record for each in the code, and one level in decomposition.json."""

from __future__ import annotations

import json

from decompose.options import BestOptions, Engine, Options, ParalleloboxOptions, Score


def test_options_are_flat_in_the_report() -> None:
    options = Options(
        Engine.PARALLELOBOX, best=BestOptions(7.0), parallelobox=ParalleloboxOptions(2, Score.HIGH)
    )
    assert json.loads(json.dumps(options.as_dict())) == {
        "engine": "parallelobox",
        "granularity": "auto",
        "interior": "leave",
        "min_wall_mm": 10.0,
        "min_glue_mm2": 25.0,
        "seed": 0,
        "tries": 2,
        "score": "high",
        "faithful": False,
        "fit_first_layer": True,
        "budget_s": 7.0,
        "prove": True,
        "pin_mm": None,
        "pin_fit_mm": 0.4,
        "marks": False,
    }
