// Starts the 3D view of a page. Without WebGL, the page keeps its picture.

import { showJob } from "./job_view.js";
import { showUpload } from "./upload_view.js";

const place = document.getElementById("viewer");
const views = { model: showJob, beds: showUpload };

for (const [name, show] of Object.entries(views)) {
  if (place && name in place.dataset) {
    try {
      await show(place);
    } catch (error) {
      console.warn("no 3D view:", error);
    }
  }
}
