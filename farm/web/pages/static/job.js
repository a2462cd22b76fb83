// Reloads a job's page when its sections or parts change; otherwise keeps the 3D view while the rest is updated.

const listSections = (root) =>
  [...root.querySelectorAll("section, tr[data-part]")].map((element) => element.id || element.getAttribute("aria-labelledby")).join();

document.addEventListener("element-received", ({ detail }) => {
  if (detail.id !== "main") return;
  if (listSections(detail) !== listSections(document.getElementById("main"))) location.reload();
  detail.querySelector("#viewer")?.replaceWith(document.getElementById("viewer").cloneNode(true));
});
