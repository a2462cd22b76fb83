"""Faults of a page in the browser by axe, light and dark, and on a phone 320 px wide."""

import json
from pathlib import Path

AXE = Path(__file__).parents[2] / "build/pages/node_modules/axe-core/axe.min.js"
VIOLATIONS = """axe.run().then((results) => JSON.stringify(results.violations.map((violation) =>
    [violation.id, violation.nodes.slice(0, 3).map((node) => node.html.slice(0, 200))])))"""
NARROW_PX = 320


async def read(browser, expression):
    """Return the value of an expression, once it has one."""
    answer = await browser.call(
        "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True
    )
    assert "exceptionDetails" not in answer, answer
    return answer["result"].get("value")


async def find_faults(browser):
    """Find the faults of the open page: violations by the colour scheme, and whether it is too wide."""
    faults = {}
    await browser.evaluate(AXE.read_text() + ";0")
    for scheme in ("light", "dark"):
        feature = {"name": "prefers-color-scheme", "value": scheme}
        await browser.call("Emulation.setEmulatedMedia", features=[feature])
        if violations := json.loads(await read(browser, VIOLATIONS)):
            faults[scheme] = violations
    size = {"width": NARROW_PX, "height": 700, "deviceScaleFactor": 1, "mobile": True}
    await browser.call("Emulation.setDeviceMetricsOverride", **size)
    if await browser.evaluate("document.documentElement.scrollWidth") > NARROW_PX:
        faults["wide"] = True
    await browser.call("Emulation.clearDeviceMetricsOverride")
    return faults
