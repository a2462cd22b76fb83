// Shows a chosen model in the printers' build volume before the upload, without sending any data.

import {
  Box3, BoxGeometry, Color, EdgesGeometry, GridHelper, Group, LineBasicMaterial, LineSegments, Mesh,
  MeshStandardMaterial, Vector3,
} from "three";
import { strFromU8, unzipSync } from "three/addons/libs/fflate.module.js";
import { ThreeMFLoader } from "three/addons/loaders/3MFLoader.js";
import { OBJLoader } from "three/addons/loaders/OBJLoader.js";
import { PLYLoader } from "three/addons/loaders/PLYLoader.js";
import { STLLoader } from "three/addons/loaders/STLLoader.js";
import { Stage, readColour } from "./stage.js";

const MAX_BYTES = 300e6; // a larger file has no preview
const UNITS_MM = { micron: 0.001, millimeter: 1, centimeter: 10, inch: 25.4, foot: 304.8, meter: 1000 };

const wrapMesh = (geometry) => new Group().add(new Mesh(geometry));

/** Return the unit of length of a 3MF file, in mm. */
const readUnit = (content) => {
  const files = unzipSync(new Uint8Array(content), { filter: ({ name }) => name.toLowerCase().endsWith(".model") });
  const units = Object.values(files).map((file) => /<model\b[^>]*\bunit="(\w+)"/.exec(strFromU8(file.subarray(0, 4096)))?.[1]);
  return UNITS_MM[units.find(Boolean) ?? "millimeter"] ?? 1;
};

const READERS = {
  stl: (content) => wrapMesh(new STLLoader().parse(content)),
  ply: (content) => wrapMesh(new PLYLoader().parse(content)),
  obj: (content) => new OBJLoader().parse(new TextDecoder().decode(content)),
  "3mf": (content) => {
    const group = new ThreeMFLoader().parse(content);
    group.scale.setScalar(readUnit(content));
    return new Group().add(group);
  },
};

/** Return the scale of a model from the fields of the form: the longest side takes precedence over the unit. */
const findScale = (form, unscaledSide) => {
  const side = Number(form.elements.longest_side_mm.value);
  return side > 0 ? side / unscaledSide : Number(form.elements.scale.value);
};

const formatLengths = (lengths) => `${lengths.map((mm) => (mm < 10 ? mm.toFixed(1) : Math.round(mm))).join(" × ")} mm`;

/** Return a sentence that compares the size of a model, in any orientation, with the build volumes. */
const compareSize = (size, volumes) => {
  const lengths = [...size].sort((a, b) => a - b);
  const fitting = volumes.filter(([, ...volume]) => volume.sort((a, b) => a - b).every((mm, axis) => lengths[axis] <= mm));
  if (Math.max(...size) < 5) return "It is smaller than 5 mm: check its unit.";
  if (Math.max(...size) > 5000) return "It is longer than 5 m: check its unit.";
  return fitting.length
    ? `It may fit as one part on ${fitting.map(([name]) => name).join(", ")}.`
    : "It is larger than any printer: it is cut into parts.";
};

class UploadView {
  constructor(container, form, volumes) {
    Object.assign(this, { container, form, volumes, stage: null, model: null });
    this.caption = document.getElementById("size");
    form.elements.file.addEventListener("change", () => this.read(form.elements.file.files[0]));
    for (const name of ["scale", "longest_side_mm"]) form.elements[name].addEventListener("input", () => this.show());
    const drop = form.querySelector(".drop");
    const markDrop = (event, isOver) => { event.preventDefault(); drop.classList.toggle("over", isOver); };
    drop.addEventListener("dragover", (event) => markDrop(event, true));
    drop.addEventListener("dragleave", (event) => markDrop(event, false));
    drop.addEventListener("drop", (event) => {
      markDrop(event, false);
      form.elements.file.files = event.dataTransfer.files;
      this.read(form.elements.file.files[0]);
    });
  }

  async read(file) {
    this.model = null;
    this.container.hidden = true;
    this.caption.textContent = "";
    const reader = READERS[file?.name.split(".").pop().toLowerCase()];
    if (!file || !reader) return;
    if (file.size > MAX_BYTES) {
      this.caption.textContent = "The file is too large for a preview.";
      return;
    }
    try {
      this.model = reader(await file.arrayBuffer());
      this.show(true);
    } catch (error) {
      this.caption.textContent = `No preview (${error.message}); the farm checks the file after the upload.`;
    }
  }

  show(isNew = false) {
    if (!this.model) return;
    this.model.scale.setScalar(1);
    this.model.position.set(0, 0, 0);
    const unscaledSize = new Box3().setFromObject(this.model).getSize(new Vector3());
    const scale = findScale(this.form, Math.max(...unscaledSize));
    const size = unscaledSize.toArray().map((mm) => mm * scale);
    this.caption.textContent = `${formatLengths(size)}. ${compareSize(size, this.volumes)}`;
    this.container.hidden = false;
    this.stage ??= new Stage(this.container, "The model beside the printers' build volume");
    this.draw(scale, isNew);
  }

  /** Draw the model in the middle of the largest build volume; z is up. */
  draw(scale, isNew) {
    const { content } = this.stage;
    content.clear();
    content.rotation.x = -Math.PI / 2;
    this.model.scale.setScalar(scale);
    content.add(this.model);
    content.updateMatrixWorld(true);
    const box = new Box3().setFromObject(this.model); // in world coordinates, y is up
    this.model.position.set(-(box.min.x + box.max.x) / 2, (box.min.z + box.max.z) / 2, -box.min.y);
    const material = new MeshStandardMaterial({ color: readColour("--accent"), roughness: 0.8 });
    this.model.traverse((mesh) => {
      if (!mesh.isMesh) return;
      if (!mesh.geometry.attributes.normal) mesh.geometry.computeVertexNormals();
      mesh.material = material;
    });
    const [, width, depth, height] = this.volumes.reduce((a, b) => (a[1] * a[2] * a[3] > b[1] * b[2] * b[3] ? a : b));
    const edges = new EdgesGeometry(new BoxGeometry(width, depth, height));
    const outline = new LineSegments(edges, new LineBasicMaterial({ color: readColour("--faint") }));
    outline.position.z = height / 2;
    const grid = new GridHelper(Math.max(width, depth), 10, new Color(readColour("--line")), readColour("--line"));
    grid.rotation.x = Math.PI / 2;
    content.add(outline, grid);
    this.stage.resize();
    if (isNew) this.stage.fitView();
    this.stage.requestFrame();
  }
}

/** Show a preview of each file that a person chooses or drops on the form. */
export const showUpload = async (container) => {
  const volumes = JSON.parse(container.dataset.volumes);
  if (volumes.length) new UploadView(container, document.getElementById("submit"), volumes);
};
