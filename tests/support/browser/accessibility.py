"""Accessibility faults of a page, found by axe in both colour schemes, and its fit in a width of 320 px."""

import json
from pathlib import Path

AXE_SCRIPT = Path(__file__).parents[3] / "build/pages/node_modules/axe-core/axe.min.js"
VIOLATIONS_SCRIPT = """axe.run().then((results) => JSON.stringify(results.violations.map((violation) =>
    [violation.id, violation.nodes.slice(0, 3).map((node) => node.html.slice(0, 200))])))"""
NARROW_WIDTH_PX = 320


async def await_value(browser, expression):
    """Return the value of an expression, which may be a promise."""
    answer = await browser.call(
        "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True
    )
    assert "exceptionDetails" not in answer, answer
    return answer["result"].get("value")


async def find_faults(browser):
    """Return the faults of the open page: violations in each colour scheme, and whether it is too wide."""
    faults = {}
    await browser.evaluate(AXE_SCRIPT.read_text() + ";0")
    for scheme in ("light", "dark"):
        feature = {"name": "prefers-color-scheme", "value": scheme}
        await browser.call("Emulation.setEmulatedMedia", features=[feature])
        if violations := json.loads(await await_value(browser, VIOLATIONS_SCRIPT)):
            faults[scheme] = violations
    size = {"width": NARROW_WIDTH_PX, "height": 700, "deviceScaleFactor": 1, "mobile": True}
    await browser.call("Emulation.setDeviceMetricsOverride", **size)
    if await browser.evaluate("document.documentElement.scrollWidth") > NARROW_WIDTH_PX:
        faults["wide"] = True
    await browser.call("Emulation.clearDeviceMetricsOverride")
    return faults
