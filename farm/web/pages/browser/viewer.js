// The 3D views of the pages. Where WebGL is missing, a page keeps the picture that it came with.

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
