// 3D view of the parts of a job, coloured by state or printer: an exploded view, or the steps of the assembly.

import { AnimationMixer, Box3, Color, Vector3 } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { Stage, readColour } from "./stage.js";

const STATES = ["waiting", "printing", "printed", "good", "bad", "failed", "cancelled"]; // colours in palette.css
const HUE_STEP = 0.618; // golden ratio, so that neighbouring numbers get very different hues
const STEP_S = 1.5; // duration of each step in the animation (decompose/export/glb.py)

/** Return the rows of the parts in the table, by name of the part. */
const findRows = () => new Map([...document.querySelectorAll("tr[data-part]")].map((row) => [row.dataset.part, row]));

/** Return the name of a part as in the model file, because three.js removes the dots from the name of a mesh. */
const findName = (mesh) => mesh.userData.name ?? mesh.name;

/** Return the colour of a printer by its number. */
const computeColour = (number) => new Color().setHSL((number * HUE_STEP) % 1, 0.5, 0.55);

/** Add an input with its label. */
const addInput = (container, text, attributes, onInput) => {
  const label = document.createElement("label");
  const input = Object.assign(document.createElement("input"), attributes);
  label.append(attributes.type === "radio" ? input : `${text} `, attributes.type === "radio" ? ` ${text}` : input);
  input.addEventListener("input", () => onInput(input));
  container.append(label);
  return input;
};

class JobView {
  constructor(container, gltf) {
    this.stage = new Stage(container, "The parts of this job. The arrow keys turn the view; the table describes the parts.");
    this.rows = findRows();
    this.parts = new Map();
    this.stage.content.add(gltf.scene);
    gltf.scene.updateMatrixWorld(true);
    gltf.scene.traverse((mesh) => {
      if (!mesh.isMesh) return;
      mesh.material = mesh.material.clone();
      const centre = new Box3().setFromBufferAttribute(mesh.geometry.attributes.position).getCenter(new Vector3());
      this.parts.set(findName(mesh), { mesh, centre, restPosition: mesh.position.clone() });
    });
    const middle = new Vector3();
    for (const { centre } of this.parts.values()) middle.addScaledVector(centre, 1 / this.parts.size);
    for (const part of this.parts.values()) part.direction = part.centre.clone().sub(middle);
    this.clip = gltf.animations[0];
    this.mixer = this.clip ? new AnimationMixer(gltf.scene) : null;
    this.mixer?.clipAction(this.clip).play();
    const kinds = new Set([...this.rows.values()].map((row) => row.dataset.kind));
    this.colourBy = kinds.size > 1 ? "state" : "printer"; // all parts wait before the first print
    this.picked = null; // name of the picked part in the model
    this.copy = null; // name of the picked row, which stands for one copy of the part
    this.addControls(container);
    this.explode(0.35);
    this.paint();
    this.stage.fitView();
    this.stage.onPick((mesh) => this.pick(mesh ? findName(mesh) : null));
  }

  addControls(container) {
    const controls = document.createElement("div");
    controls.className = "tools";
    this.explosionInput = addInput(controls, "Pull apart", { type: "range", min: 0, max: 100, value: 35 }, (input) => {
      if (this.stepInput) this.stepInput.value = this.stepInput.max;
      this.explode(input.value / 100);
    });
    if (this.clip) {
      const steps = Math.round(this.clip.duration / STEP_S);
      this.stepInput = addInput(controls, "Assembly", { type: "range", min: 0, max: steps, value: steps }, (input) => {
        this.explosionInput.value = 0;
        this.setStep(Number(input.value));
      });
    }
    for (const [by, text] of [["state", "Colour by state"], ["printer", "by printer"]]) {
      addInput(controls, text, { type: "radio", name: "colour-by", checked: by === this.colourBy }, () => {
        this.colourBy = by;
        this.paint();
      });
    }
    this.legend = document.createElement("p");
    this.legend.className = "key";
    this.caption = document.createElement("p");
    this.caption.setAttribute("role", "status");
    container.append(controls, this.legend, this.caption);
    for (const [name, row] of this.rows) this.addButton(name, row);
    const table = document.querySelector("table.parts");
    if (table) {
      const options = { attributeFilter: ["data-kind", "data-printer"], childList: true, subtree: true };
      new MutationObserver(() => this.updateRows()).observe(table, options);
    }
  }

  /** Turn the name of a part in the table into a button that picks the part. */
  addButton(name, row) {
    const cell = row.querySelector("th");
    if (!cell || !this.parts.has(this.findPart(name)) || cell.querySelector("button")) return;
    const button = document.createElement("button");
    button.type = "button";
    button.className = "plain";
    button.append(...cell.childNodes);
    button.addEventListener("click", () => this.pick(this.findPart(name), name));
    cell.append(button);
  }

  /** Update the view after rows of the table were replaced, or the state or printer of a part changed. */
  updateRows() {
    this.rows = findRows();
    for (const [name, row] of this.rows) this.addButton(name, row);
    this.markRows();
    this.paint();
  }

  /** Move the parts away from the middle of the model, by a share of the greatest distance, from 0 to 1. */
  explode(share) {
    for (const { mesh, restPosition, direction } of this.parts.values()) {
      mesh.position.copy(restPosition).addScaledVector(direction, 1.2 * share);
    }
    this.stage.requestFrame();
  }

  /** Show the parts after a number of assembly steps. */
  setStep(number) {
    for (const { mesh, restPosition } of this.parts.values()) mesh.position.copy(restPosition);
    const end = Math.min(number * STEP_S, this.clip.duration - 1e-3);
    this.mixer.setTime(end);
    this.stage.requestFrame();
  }

  /** Colour all parts, and update the legend. */
  paint() {
    const printers = [...new Set([...this.rows.values()].map((row) => row.dataset.printer))].sort();
    const meanings = new Map();
    for (const [name, { mesh }] of this.parts) {
      const values = new Set(this.findPartRows(name).map((row) => row.dataset[this.colourBy === "state" ? "kind" : "printer"]));
      const [first = "cut into smaller parts"] = values;
      const text = values.size > 1 ? `copies with several ${this.colourBy}s` : first;
      const colour = this.colourBy === "printer" && values.size === 1
        ? computeColour(printers.indexOf(first))
        : readColour(`--fill-${STATES.includes(text) ? text : "other"}`);
      meanings.set(text, colour);
      mesh.material.color.copy(colour);
      mesh.material.emissive.set(name === this.picked ? 0x555522 : 0);
    }
    this.legend.replaceChildren(...[...meanings].sort().map(([text, colour]) => {
      const entry = document.createElement("span");
      const patch = document.createElement("i");
      patch.style.background = `#${colour.getHexString()}`;
      entry.append(patch, ` ${text}`);
      return entry;
    }));
    this.stage.requestFrame();
  }

  /** Mark a part in the view, and its row in the table: the row of one copy, or of all copies. Null marks no part. */
  pick(name, copy = null) {
    [this.picked, this.copy] = [name, copy];
    const rows = this.markRows();
    if (!copy) rows[0]?.scrollIntoView({ block: "nearest" });
    const text = rows.map(({ dataset }) => `${dataset.part}: ${dataset.kind}, ${dataset.printer}`);
    this.caption.textContent = text.join("; ") || (name ?? "");
    this.paint();
  }

  /** Mark only the rows of the picked part, and return them. */
  markRows() {
    const rows = this.copy ? [this.rows.get(this.copy)].filter(Boolean) : this.findPartRows(this.picked);
    for (const row of this.rows.values()) row.classList.toggle("picked", rows.includes(row));
    return rows;
  }

  /** Return the name of the part in the model for a row; the name of a copy's row ends with a dot and a number. */
  findPart(name) {
    return this.parts.has(name) ? name : name.split(".")[0];
  }

  /** Return the rows of a part, one for each copy; none if the part was cut into smaller parts. */
  findPartRows(name) {
    return [...this.rows].filter(([part]) => this.findPart(part) === name).map(([, row]) => row);
  }
}

/** Replace the picture in an element with a 3D view of its model. */
export const showJob = async (container) => {
  const gltf = await new GLTFLoader().loadAsync(container.dataset.model);
  const picture = container.querySelector("img");
  new JobView(container, gltf);
  picture?.remove();
};
