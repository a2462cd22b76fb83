// Scrolls each chart that is wider than the window to the present time.

for (const area of document.querySelectorAll("[data-now]")) {
  area.scrollLeft = Math.max(0, Number(area.dataset.now) - area.clientWidth / 3);
}
