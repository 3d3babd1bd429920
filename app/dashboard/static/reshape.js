// "Reshape" of an item: a form by hand (reshape-form.js) over the photographs and in 3D, by handles or number fields.
// Drag a handle, or Tab to it and use the arrow keys (Shift: by ten). The fields hold the form; the server computes the
// volume that counts.

import { unpack } from "./meal3d-data.js";
import { HANDLES, formAround, hull, linesOf, nearestSection, onLevel, placeOf, project, rayOf, volumeMl } from "./reshape-form.js";
import { loadScene } from "./scene-of-meal.js";

const SVG = "http://www.w3.org/2000/svg";
const NUMBERS = ["length_mm", "width_mm", "height_mm", "yaw_deg", "lean_deg", "base_mm", "x_mm", "y_mm"];
const HANDLE_NAMES = { move: "Place", length_mm: "Length", width_mm: "Width", height_mm: "Height", lean_deg: "Lean", yaw_deg: "Turn" };
const UNKNOWN_HEIGHT = 0.5; // of the width, of an item whose shape is not known
const MOST_DOTS = 500; // of the measured shape in the 3D view
const KNOB_PX = 8; // radius of a handle on the screen
const RAD = Math.PI / 180;

let active = null; // {fieldset, scene, dots, view: {turn, tilt, middle, reach}, isDragging}

document.addEventListener("click", async (event) => {
  const button = event.target.closest("[data-reshape-start]");
  if (!button) return;
  const fieldset = button.closest("[data-reshape]");
  if (active?.fieldset === fieldset) return end();
  end();
  const scene = await loadScene();
  const cameras = scene ? sides(scene).map((side) => scene.file.photographs[side].camera) : [];
  if (!cameras.some(Boolean)) return showMessage(fieldset, "The scene of the run cannot be read, or it has no cameras: enter the volume instead.");
  const measured = measuredShape(scene, fieldset.dataset.reshape);
  if (!readForm(fieldset)) {
    const form = measured?.form ?? formOfOutline(fieldset, scene);
    if (!form) return showMessage(fieldset, "The item has no outline: type the form's numbers first.");
    writeForm(fieldset, form);
  }
  active = { fieldset, scene, dots: measured?.dots ?? [], view: { turn: -35, tilt: 25 }, isDragging: false };
  button.textContent = "Hide the form";
  showMessage(fieldset, "Drag the handles, or Tab to one and use the arrows (Shift: by ten). The picture in 3D turns by dragging and by its arrows.");
  draw();
});

document.addEventListener("input", (event) => {
  if (event.target.closest("[data-reshape]")) refresh(event.target.closest("[data-reshape]"));
});
document.addEventListener("htmx:after:swap", () => {
  showButtons();
  if (active && !active.fieldset.isConnected) active = null;
  else if (active && !readForm(active.fieldset)) end(); // the form was sent
  else if (active) draw();
});

function showButtons() {
  for (const button of document.querySelectorAll("[data-reshape-start]")) {
    button.hidden = !document.querySelector('svg[data-photograph="left"]');
    refresh(button.closest("[data-reshape]"));
  }
}

function end() {
  if (!active) return;
  active.fieldset.querySelector("[data-reshape-start]").textContent = "Show over the photographs";
  active.fieldset.querySelector("[data-reshape-view]").replaceChildren();
  showMessage(active.fieldset, "");
  active = null;
  for (const layer of document.querySelectorAll("[data-form-by-hand]")) layer.remove();
}

function showMessage(fieldset, message) {
  fieldset.querySelector("[data-reshape-message]").textContent = message;
}

// --- the fields

function field(fieldset, name) {
  return fieldset.querySelector(`[name="${name}"]`);
}

/** The fields' form; null while one is empty or no number. */
function readForm(fieldset) {
  const texts = NUMBERS.map((name) => field(fieldset, name).value.trim());
  const [length_mm, width_mm, height_mm, yaw_deg, lean_deg, base_mm, x, y] = texts.map(Number);
  if (texts.some((text) => text === "" || !Number.isFinite(Number(text)))) return null;
  return { section: field(fieldset, "section").value, length_mm, width_mm, height_mm, yaw_deg, lean_deg, base_mm, centre_mm: [x, y] };
}

function writeForm(fieldset, form) {
  const values = { ...form, x_mm: form.centre_mm[0], y_mm: form.centre_mm[1] };
  for (const name of NUMBERS) field(fieldset, name).value = String(Math.round(values[name] * 10) / 10);
  field(fieldset, "section").value = form.section;
  refresh(fieldset);
}

function refresh(fieldset) {
  const form = readForm(fieldset);
  const ml = form && volumeMl(form);
  fieldset.querySelector("output").textContent = ml === null ? "–" : `${ml >= 100 ? ml.toFixed(0) : ml.toFixed(1)} ml`;
  if (active?.fieldset === fieldset && form) draw();
}

// --- where a form begins

function sides(scene) {
  return ["left", "right"].filter((side) => scene.file.photographs?.[side]?.camera);
}

/** The run's shape of an item: the form around it, and dots of its surface; null: the run has none of it. */
function measuredShape(scene, id) {
  const item = (scene.file.items ?? []).find((each) => scene.items[each.index]?.id === id);
  if (!item?.shape) return null;
  const { values, columns } = unpack(item.shape.vertices);
  const places = Array.from({ length: values.length / columns }, (_, i) => [...values.subarray(i * columns, i * columns + 3)]);
  const form = formAround(places, item.support_mm);
  if (!form) return null;
  if (item.volume_ml) form.section = nearestSection(form, item.volume_ml);
  const step = Math.ceil(places.length / MOST_DOTS);
  return { form, dots: places.filter((_, i) => i % step === 0) };
}

/** A form on the table where the outline in the left photograph is. */
function formOfOutline(fieldset, scene) {
  const camera = scene.file.photographs.left?.camera;
  const ring = JSON.parse(fieldset.dataset.rings)[0] ?? [];
  if (!camera) return null;
  const foot = ring.map((pixel) => onLevel(rayOf(camera, pixel), 0)).filter(Boolean);
  const form = foot.length < 3 ? null : formAround(foot.map(([x, y]) => [x, y, 0]), 0);
  return form && { ...form, section: "slab", height_mm: UNKNOWN_HEIGHT * form.width_mm };
}

// --- the pictures

function draw() {
  const form = readForm(active.fieldset);
  if (!form) return;
  for (const side of sides(active.scene)) {
    const svg = document.querySelector(`svg[data-photograph="${side}"]`);
    if (svg) drawOver(svg, side, form);
  }
  drawView(form);
}

function element(name, attributes, parent) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  parent.append(made);
  return made;
}

function pathOf(points, isClosed = false) {
  return `M${points.map(([x, y]) => `${x.toFixed(1)} ${y.toFixed(1)}`).join(" L")}${isClosed ? " Z" : ""}`;
}

/** The form's outline and lines, drawn with `seen`: place -> [x, y] or null. */
function drawForm(parent, form, seen) {
  const lines = linesOf(form).map((line) => line.map(seen).filter(Boolean)).filter((line) => line.length > 1);
  const outline = hull(lines.flat());
  if (outline.length < 3) return;
  for (const style of ["halo", "line"]) element("path", { d: pathOf(outline, true), class: `hand-${style}`, "vector-effect": "non-scaling-stroke" }, parent);
  element("path", { d: lines.map((line) => pathOf(line)).join(" "), class: "hand-wire", "vector-effect": "non-scaling-stroke" }, parent);
}

function drawOver(svg, side, form) {
  const camera = active.scene.file.photographs[side].camera;
  drawLayer(svg, `${side} photograph`, form, (place) => project(camera, place), (pixel) => rayOf(camera, pixel));
}

/** The form and its handles over what `svg` shows. seen: place -> [x, y] or null; rayAt: [x, y] -> ray. */
function drawLayer(svg, where, form, seen, rayAt) {
  let layer = svg.querySelector("[data-form-by-hand]");
  if (!layer) {
    layer = element("g", { "data-form-by-hand": where }, svg);
    layer.addEventListener("pointerdown", (event) => drag(event, svg, layer));
    layer.addEventListener("keydown", onKey);
  }
  layer.rayAt = rayAt;
  const drawn = layer.querySelector("g") ?? element("g", { "pointer-events": "none" }, layer);
  drawn.replaceChildren();
  drawForm(drawn, form, seen);
  const radius = KNOB_PX / (svg.getScreenCTM()?.a || 1);
  for (const [name, handle] of Object.entries(HANDLES)) {
    const at = seen(handle.at(form));
    const knob = layer.querySelector(`[data-handle="${name}"]`) ?? newHandle(layer, name, where);
    knob.toggleAttribute("hidden", !at);
    if (!at) continue;
    for (const [key, value] of Object.entries({ cx: at[0], cy: at[1], r: radius, ...spoken(name, form) })) knob.setAttribute(key, String(value));
  }
}

function newHandle(layer, name, where) {
  const knob = element("circle", { class: `hand-knob hand-${name}`, "data-handle": name, tabindex: 0, role: "slider", "aria-label": `${HANDLE_NAMES[name]}, ${where}` }, layer);
  element("title", {}, knob).textContent = HANDLE_NAMES[name];
  return knob;
}

/** What a screen reader says of a handle. */
function spoken(name, form) {
  if (name === "move") return { "aria-valuenow": form.centre_mm[0].toFixed(0), "aria-valuetext": `x ${form.centre_mm[0].toFixed(0)}, y ${form.centre_mm[1].toFixed(0)} mm` };
  return { "aria-valuenow": form[name].toFixed(1), "aria-valuetext": `${form[name].toFixed(0)} ${name.endsWith("deg") ? "degrees" : "mm"}` };
}

function drag(event, svg, layer) {
  const name = event.target.dataset?.handle;
  if (!name || event.button !== 0 || !active) return;
  event.preventDefault();
  event.target.focus({ preventScroll: true });
  const { fieldset } = active;
  active.isDragging = true; // the picture in 3D stays where it is meanwhile
  const move = ({ clientX, clientY }) => {
    const at = new DOMPoint(clientX, clientY).matrixTransform(svg.getScreenCTM().inverse());
    const form = readForm(fieldset);
    const dragged = form && HANDLES[name].dragged(form, layer.rayAt([at.x, at.y]));
    if (dragged) writeForm(fieldset, dragged);
  };
  const stop = () => {
    removeEventListener("pointermove", move);
    removeEventListener("pointerup", stop);
    removeEventListener("pointercancel", stop);
    if (active) {
      active.isDragging = false;
      draw();
    }
  };
  addEventListener("pointermove", move);
  addEventListener("pointerup", stop);
  addEventListener("pointercancel", stop);
}

function onKey(event) {
  const name = event.target.dataset?.handle;
  const [right, up] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] }[event.key] ?? [0, 0];
  const form = active && readForm(active.fieldset);
  if (event.key === "Escape") end();
  else if (!name || !form || !(right || up)) return;
  else {
    const step = event.shiftKey ? 10 : 1;
    const fields = name === "move" ? { x_mm: right, y_mm: up } : { [name]: right + up };
    for (const [key, by] of Object.entries(fields)) {
      const input = field(active.fieldset, key);
      const least = Number(input.min), most = Number(input.max);
      input.value = String(Math.min(Math.max(Math.round((Number(input.value) + by * step) * 10) / 10, least), most));
    }
    refresh(active.fieldset);
  }
  event.preventDefault();
}

// --- in 3D: seen from far away, turned about the form

function drawView(form) {
  const svg = active.fieldset.querySelector("[data-reshape-view]");
  const { view } = active;
  if (!active.isDragging) {
    view.middle = placeOf(form, 0, 0, 0.5);
    const apart = (place) => Math.hypot(...place.map((value, i) => value - view.middle[i]));
    view.reach = Math.max(60, ...linesOf(form).flat().map(apart), apart(HANDLES.yaw_deg.at(form)));
  }
  const { middle, reach } = view;
  const { right, up, towards } = axesOf(view);
  const along = (place, axis) => place.reduce((sum, value, i) => sum + ((value - middle[i]) / reach) * axis[i], 0);
  const seen = (place) => [90 * along(place, right), -90 * along(place, up)];
  const rayAt = ([x, y]) => ({
    from: middle.map((value, i) => value + reach * ((x / 90) * right[i] - (y / 90) * up[i] - 20 * towards[i])),
    towards,
  });
  const ground = svg.querySelector("[data-ground]") ?? element("g", { "data-ground": "" }, svg);
  ground.replaceChildren();
  const far = reach * 1.4;
  const grid = [-1, -0.5, 0, 0.5, 1].map((share) => share * far).flatMap((at) => [[[at, -far], [at, far]], [[-far, at], [far, at]]]);
  const onGround = ([x, y]) => seen([middle[0] + x, middle[1] + y, form.base_mm]);
  element("path", { d: grid.map((line) => pathOf(line.map(onGround))).join(" "), class: "hand-grid" }, ground);
  if (active.dots.length) element("path", { d: active.dots.map((place) => `${pathOf([seen(place)])} h0`).join(" "), class: "hand-dots" }, ground);
  drawLayer(svg, "in 3D", form, seen, rayAt);
  svg.setAttribute("aria-label", `The form in 3D: ${form.section}, ${form.length_mm} by ${form.width_mm} by ${form.height_mm} mm. Arrows turn the picture.`);
}

/** Unit vectors of the picture in the table frame: to its right, upwards in it, and into it. */
function axesOf({ turn, tilt }) {
  const [ct, st, ce, se] = [Math.cos(turn * RAD), Math.sin(turn * RAD), Math.cos(tilt * RAD), Math.sin(tilt * RAD)];
  return { right: [ct, -st, 0], up: [st * se, ct * se, ce], towards: [st * ce, ct * ce, -se] };
}

function turnBy(turn, tilt) {
  active.view.turn += turn;
  active.view.tilt = Math.min(Math.max(active.view.tilt + tilt, 0), 90);
  draw();
}
document.addEventListener("keydown", (event) => {
  if (!active || !event.target.matches?.("[data-reshape-view]")) return;
  const [turn, tilt] = { ArrowLeft: [-10, 0], ArrowRight: [10, 0], ArrowUp: [0, 10], ArrowDown: [0, -10] }[event.key] ?? [0, 0];
  if (!turn && !tilt) return;
  event.preventDefault();
  turnBy(turn, tilt);
});
document.addEventListener("pointermove", (event) => {
  if (active && !active.isDragging && event.buttons === 1 && event.target.closest?.("[data-reshape-view]")) turnBy(event.movementX / 2, event.movementY / 2);
});

showButtons();
