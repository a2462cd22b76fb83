"""Rows of the table of `bench.decompose`: one run of an engine each, and their means."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

PART_ENGINES = ("symmetry", "cube-skeleton")
"""Engines that take no number of printers."""


AS_IS, BEST_POSE = "as-is", "best-pose"  # poses in which the uncut model is sliced


def compute_row(
    model: str, printers: int, engine: str, report: dict[str, Any], sliced_s: list[float | None] | None
) -> dict[str, Any]:
    """Compute one row of the table. Times are CuraEngine's if every part was sliced, else prices.

    Parameters
    ----------
    model
        Name of the model.
    printers
        Number of printers of the run.
    engine
        Name of the engine of the run.
    report
        `decomposition.json` of the result, with the wall time and peak memory; or the reason of a refusal.
    sliced_s
        CuraEngine's time of each part in seconds, None if its slice is refused; None without slices.
    """
    row: dict[str, Any] = {"model": model, "printers": printers, "engine": engine}
    if "refused" in report:
        return row | {"refused": report["refused"]}
    estimated_s = [part["estimated_s"] for part in report["parts"]]
    is_sliced = sliced_s is not None and all(seconds is not None for seconds in sliced_s)
    times_s = [float(s) for s in sliced_s if s is not None] if sliced_s and is_sliced else estimated_s
    row |= {
        "winning_engine": report["engine"],
        "parts": len(times_s),
        "sliced": is_sliced,
        "not_sliced": sum(s is None for s in sliced_s) if sliced_s else None,
        "parallel_s": max(times_s),
        "estimated_s": max(estimated_s),
        "sum_s": sum(times_s),
        "balance": float(np.mean(times_s)) / max(times_s),
        "serial_as_is_s": report["serial_as_is_s"],
        "serial_s": report["serial_s"],
        "efficiency": report["serial_as_is_s"] / (printers * max(times_s)),
        "efficiency_best_pose": report["serial_s"] / (printers * max(times_s)),
        "gap": report["gap"],  # of the partition on the grid, before its planes were moved
        "above_bound": max(estimated_s) / report["lower_bound_s"] - 1.0,  # of the result
        "bound_s": report["lower_bound_s"],
        "any_boxes_bound_s": report.get("any_boxes_bound_s"),  # of any boxes, on any grid or none
        "wall_s": report["wall_s"],
        "peak_mb": report["peak_mb"],
        "stages_s": report["stages_s"],
        "attempts": report["attempts"],
        "cells": report["cells"],
    }
    if is_sliced:
        row["cost_error"] = float(
            np.mean([abs(e / t - 1.0) for e, t in zip(estimated_s, times_s, strict=True)])
        )
    return row


def add_whole(row: dict[str, Any], pose_name: str, whole_s: float | None) -> None:
    """Add CuraEngine's time of the uncut model in seconds to a row; None if its slice is refused.

    Parameters
    ----------
    row
        Row of `compute_row`.
    pose_name
        `AS_IS` or `BEST_POSE`.
    whole_s
        Time of the uncut model in that pose.
    """
    suffix, price_s = ("", row["serial_as_is_s"]) if pose_name == AS_IS else ("_best_pose", row["serial_s"])
    row[f"whole{suffix}_s"] = whole_s
    if whole_s is not None:
        row[f"efficiency{suffix}_sliced"] = whole_s / (row["printers"] * row["parallel_s"])
        row[f"whole{suffix}_cost_error"] = price_s / whole_s - 1.0


def format_row(row: dict[str, Any]) -> str:
    """Format one row."""
    row_label = f"{row['model']:20} N {row['printers']:3} {row['engine']:22}"
    if "refused" in row:
        return f"{row_label} refused: {row['refused']}"
    error = f"{row['cost_error']:.1%}" if "cost_error" in row else "-"
    sliced_text = f", E sliced {row['efficiency_sliced']:.3f}" if "efficiency_sliced" in row else ""
    if "efficiency_best_pose_sliced" in row:
        sliced_text += f", sliced in best pose {row['efficiency_best_pose_sliced']:.3f}"
    time_text = f"{row['parallel_s']:6.0f} s" + (f" (first {row['first_s']:.0f})" if "first_s" in row else "")
    return (
        f"{row_label} {row['parts']:3} parts, {time_text}, "
        f"E {row['efficiency']:.3f}{sliced_text}, best pose {row['efficiency_best_pose']:.3f}, "
        f"balance {row['balance']:.3f}, gap {row['gap']:.1%} (result {row['above_bound']:+.1%}), "
        f"cost error {error}, {row['wall_s']:.0f} s, "
        f"{row['peak_mb']:.0f} MB"
    )


def summarise(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Compute means over the measured models."""
    best = {(r["model"], r["printers"]): r for r in rows if r["engine"] == "best" and "refused" not in r}

    def compute_geometric_mean(values: list[float]) -> float | None:
        return math.exp(float(np.mean(np.log(values)))) if values else None

    summary: dict[str, Any] = {"efficiency": {}, "rivals": {}}
    for printers in sorted({count for _, count in best}):
        rows_at_count = [r for (_, count), r in best.items() if count == printers]
        summary["efficiency"][printers] = {
            "mean": compute_geometric_mean([r["efficiency"] for r in rows_at_count]),
            "worst": min(r["efficiency"] for r in rows_at_count),
            "best_pose_mean": compute_geometric_mean([r["efficiency_best_pose"] for r in rows_at_count]),
            "best_pose_worst": min(r["efficiency_best_pose"] for r in rows_at_count),
            "balance": min(r["balance"] for r in rows_at_count),
            "gap": max(r["gap"] for r in rows_at_count),
            "above_bound": max(r["above_bound"] for r in rows_at_count),
            "best_pose_sliced_mean": compute_geometric_mean(
                [
                    r["efficiency_best_pose_sliced"]
                    for r in rows_at_count
                    if "efficiency_best_pose_sliced" in r
                ]
            ),
            "cost_error": max((r["cost_error"] for r in rows_at_count if "cost_error" in r), default=None),
            "models": len(rows_at_count),
        }
    for engine in sorted({r["engine"] for r in rows} - {"best"}):
        engine_rows = [r for r in rows if r["engine"] == engine]
        ratios = [
            (best[r["model"], count]["parallel_s"] / r["parallel_s"])
            for r in engine_rows
            if "refused" not in r
            for count in [
                min(r["parts"], r["printers"]) if engine.startswith(PART_ENGINES) else r["printers"]
            ]
            if (r["model"], count) in best
        ]
        refused_count = sum("refused" in r for r in engine_rows)
        summary["rivals"][engine] = {
            "mean": compute_geometric_mean(ratios), "worst": max(ratios, default=None), "models": len(ratios),
            "refused": refused_count,
        }  # fmt: skip
    return summary
