// Reloads a job's page when its sections or parts change; otherwise the 3D view stays while the rest is updated.

const outline = (root) =>
  [...root.querySelectorAll("section, tr[data-part]")].map((element) => element.id || element.getAttribute("aria-labelledby")).join();

document.addEventListener("element-received", ({ detail }) => {
  if (detail.id !== "main") return;
  if (outline(detail) !== outline(document.getElementById("main"))) location.reload();
  detail.querySelector("#viewer")?.replaceWith(document.getElementById("viewer").cloneNode(true));
});
