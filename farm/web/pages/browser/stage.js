// 3D view of meshes that a user can rotate; it is drawn only after a change.

import {
  AmbientLight, Box3, Color, DirectionalLight, Group, PerspectiveCamera, Raycaster, Scene, Vector2, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

const FIELD_OF_VIEW_DEG = 35;
const MARGIN = 0.95; // below 1, because a box does not fill its bounding sphere
const CLICK_PX = 4; // if the pointer moves further while it is pressed, it turns the view instead of picking a part

/** Return the colour in a variable of the style sheet. */
export const readColour = (name) => new Color(getComputedStyle(document.documentElement).getPropertyValue(name).trim());

export class Stage {
  /**
   * @param {HTMLElement} container element to fill
   * @param {string} label description of the view for screen readers
   */
  constructor(container, label) {
    this.renderer = new WebGLRenderer({ antialias: true, preserveDrawingBuffer: true }); // so that a printed page has the view
    this.canvas = this.renderer.domElement;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", label);
    this.canvas.tabIndex = 0;
    container.append(this.canvas);
    this.scene = new Scene();
    this.content = new Group();
    const sun = new DirectionalLight(0xffffff, 2.2);
    sun.position.set(0.5, 1, 0.8);
    this.camera = new PerspectiveCamera(FIELD_OF_VIEW_DEG, 1, 1, 1e5);
    this.camera.add(sun);
    this.scene.add(this.content, this.camera, new AmbientLight(0xffffff, 1.4));
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.addEventListener("change", () => this.requestFrame());
    this.canvas.addEventListener("keydown", (event) => this.turn(event));
    new ResizeObserver(() => this.resize()).observe(container);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.requestFrame());
    this.isFrameRequested = false;
    this.resize();
  }

  /** Draw once at the next animation frame. */
  requestFrame() {
    if (this.isFrameRequested) return;
    this.isFrameRequested = true;
    requestAnimationFrame(() => {
      this.isFrameRequested = false;
      this.draw();
    });
  }

  draw() {
    this.scene.background = readColour("--card");
    this.renderer.render(this.scene, this.camera);
  }

  resize() {
    const width = this.canvas.parentElement.clientWidth;
    const height = Math.round(Math.min(0.7 * innerHeight, 0.66 * width));
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.draw(); // setting the size clears the canvas
  }

  /** Move the camera so that the content fills the view. */
  fitView() {
    const box = new Box3().setFromObject(this.content);
    if (box.isEmpty()) return;
    const centre = box.getCenter(new Vector3());
    const radius = box.getSize(new Vector3()).length() / 2;
    const relativeWidth = Math.min(1, this.camera.aspect); // below 1 if the view is narrower than it is high
    const distance = (MARGIN * radius) / Math.sin((FIELD_OF_VIEW_DEG * Math.PI) / 360) / relativeWidth;
    this.camera.near = distance / 100;
    this.camera.far = distance * 10;
    this.camera.position.copy(centre).add(new Vector3(0.55, 0.5, 0.8).normalize().multiplyScalar(distance));
    this.camera.updateProjectionMatrix();
    this.controls.target.copy(centre);
    this.controls.update();
    this.requestFrame();
  }

  /** Call a function at each click, with the mesh under the pointer or null. */
  onPick(callback) {
    let start = null;
    this.canvas.addEventListener("pointerdown", (event) => { start = [event.clientX, event.clientY]; });
    this.canvas.addEventListener("pointerup", (event) => {
      if (!start || Math.hypot(event.clientX - start[0], event.clientY - start[1]) > CLICK_PX) return;
      const area = this.canvas.getBoundingClientRect();
      const pointer = new Vector2(
        (2 * (event.clientX - area.left)) / area.width - 1, 1 - (2 * (event.clientY - area.top)) / area.height,
      );
      const caster = new Raycaster();
      caster.setFromCamera(pointer, this.camera);
      callback(caster.intersectObject(this.content, true).find((hit) => hit.object.isMesh)?.object ?? null);
    });
  }

  /** Turn the view with the arrow keys. */
  turn(event) {
    const step = { ArrowLeft: [0.15, 0], ArrowRight: [-0.15, 0], ArrowUp: [0, -0.15], ArrowDown: [0, 0.15] }[event.key];
    if (!step) return;
    event.preventDefault();
    this.controls.rotateLeft(step[0]);
    this.controls.rotateUp(step[1]);
    this.controls.update();
    this.requestFrame();
  }
}
