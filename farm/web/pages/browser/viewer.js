// Starts the 3D view of a page. If the browser has no WebGL, the picture on the page stays.

import { showJob } from "./job_view.js";
import { showUpload } from "./upload_view.js";

const container = document.getElementById("viewer");
const views = { model: showJob, volumes: showUpload };

for (const [name, show] of Object.entries(views)) {
  if (container && name in container.dataset) {
    try {
      await show(container);
    } catch (error) {
      console.warn("no 3D view:", error);
    }
  }
}
