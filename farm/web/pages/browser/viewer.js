// Starts the 3D view of a page. Without WebGL, the page keeps its picture.

import { showJob } from "./job_view.js";
import { showUpload } from "./upload_view.js";

const container = document.getElementById("viewer");
const views = { model: showJob, beds: showUpload };

for (const [name, show] of Object.entries(views)) {
  if (container && name in container.dataset) {
    try {
      await show(container);
    } catch (error) {
      console.warn("no 3D view:", error);
    }
  }
}
