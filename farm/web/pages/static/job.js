// Reloads a job's page if an update adds or removes sections or parts. Other updates keep the 3D view.

const listSections = (root) =>
  [...root.querySelectorAll("section, tr[data-part]")].map((element) => element.id || element.getAttribute("aria-labelledby")).join();

document.addEventListener("element-received", ({ detail }) => {
  if (detail.id !== "main") return;
  if (listSections(detail) !== listSections(document.getElementById("main"))) location.reload();
  detail.querySelector("#viewer")?.replaceWith(document.getElementById("viewer").cloneNode(true));
});
