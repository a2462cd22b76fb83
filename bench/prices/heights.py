"""Share of heights that can be printed exactly, by the change of the first layer, and the mean layer height.

Usage: python -m bench.prices.heights [--from-mm 5] [--to-mm 205] [--json]

Heights are tested in steps of 0.01 mm, for each quality with exact heights, each printer and each nozzle.
"""

from __future__ import annotations

import argparse
import json
import sys

from drivers.printers import SLICING_PROFILES
from farm.planning.printer_settings import build_slicing_printer
from slicing.settings import FARM_QUALITIES, SettingsRequest, find_resources, resolve_settings
from slicing.settings.layer_heights import (
    MAX_HEIGHT_ERROR_MM,
    LayerHeights,
    compute_printed_height_mm,
    fit_heights,
)
from slicing.settings.limits import MAX_LAYER_SHARE

PRINTERS = {"ultimaker2_plus": (0.25, 0.4, 0.6, 0.8), "ultimaker2": (0.4,)}
CASES = ("first layer unchanged", "first layer changed", "missed")


def compute_shares(nominal: LayerHeights, nozzle_mm: float, hundredths: range) -> dict[str, float]:
    """Compute the share of each of `CASES` among heights in hundredths of a mm, and the mean layer height.

    The mean layer height is a share of the nominal one.
    """
    counts, layer_height_sum_mm = [0] * len(CASES), 0.0
    for hundredth in hundredths:
        height_mm = hundredth / 100.0
        heights = fit_heights(height_mm, nominal, max_first_layer_mm=MAX_LAYER_SHARE * nozzle_mm)
        is_exact = abs(compute_printed_height_mm(height_mm, heights) - height_mm) <= MAX_HEIGHT_ERROR_MM
        case = int(heights.first_layer_mm != nominal.first_layer_mm)
        counts[case if is_exact else -1] += 1
        layer_height_sum_mm += heights.other_layers_mm
    shares = {name: count / len(hundredths) for name, count in zip(CASES, counts, strict=True)}
    return shares | {"mean layer height": layer_height_sum_mm / len(hundredths) / nominal.other_layers_mm}


def main() -> int:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--from-mm", type=float, default=5.0)
    parser.add_argument("--to-mm", type=float, default=205.0)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    hundredths = range(round(100 * args.from_mm), round(100 * args.to_mm) + 1)
    rows = []
    for quality in (name for name, quality in FARM_QUALITIES.items() if quality.fits_layers):
        for printer, nozzles_mm in PRINTERS.items():
            for nozzle_mm in nozzles_mm:
                request = SettingsRequest(
                    build_slicing_printer(SLICING_PROFILES[printer]), quality, nozzle_mm=nozzle_mm
                )
                settings = resolve_settings(request, find_resources())
                nominal = LayerHeights(settings.layer_height_0_mm, settings.layer_height_mm)
                shares = compute_shares(nominal, nozzle_mm, hundredths)
                rows.append({"quality": quality, "printer": printer, "nozzle_mm": nozzle_mm, **shares})
                if not args.json:
                    text = ", ".join(f"{name} {share:.2%}" for name, share in shares.items())
                    print(f"{quality} {printer} {nozzle_mm}: {text}", flush=True)
    if args.json:
        print(json.dumps({"schema": 1, "heights": len(hundredths), "rows": rows}, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
