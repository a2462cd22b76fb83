// A narrow window begins at the present: what is past is to the left of it.

for (const area of document.querySelectorAll("[data-now]")) {
  area.scrollLeft = Math.max(0, Number(area.dataset.now) - area.clientWidth / 3);
}
