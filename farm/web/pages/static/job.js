// A job's page is loaded anew once it has other sections or parts; else its 3D view stays while the rest changes.

const outline = (root) =>
  [...root.querySelectorAll("section, tr[data-part]")].map((one) => one.id || one.getAttribute("aria-labelledby")).join();

document.addEventListener("fresh", ({ detail }) => {
  if (detail.id !== "main") return;
  if (outline(detail) !== outline(document.getElementById("main"))) location.reload();
  detail.querySelector("#viewer")?.replaceWith(document.getElementById("viewer").cloneNode(true));
});
