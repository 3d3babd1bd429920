// The page of a meal: outlines and cards are highlighted together, foods are searched while typing (combobox.js),
// outlines are drawn, forms shaped by hand (reshape.js).
import "./combobox.js";
import { startDrawing } from "./outline-editor.js";
import "./reshape.js";
import { loadScene } from "./scene-of-meal.js";

const SVG = "http://www.w3.org/2000/svg";

// --- outline and card are highlighted together

function light(id) {
  for (const element of document.querySelectorAll(".meal [data-item]")) {
    element.classList.toggle("lit", element.dataset.item === id);
  }
}
for (const kind of ["mouseover", "focusin"]) {
  document.addEventListener(kind, (event) => light(event.target.closest?.(".meal [data-item]")?.dataset.item));
}

// --- open details stay open when the section is replaced

document.addEventListener("htmx:before:morph:attr", (event) => {
  if (event.detail?.attrName === "open" && event.target.matches?.("details[data-keep]")) event.preventDefault();
});

let sentFor = null; // id of the last form's item; "" for the meal; null: no form was sent

document.addEventListener("submit", (event) => {
  if (event.target.closest(".meal")) sentFor = event.target.elements.namedItem("item")?.value ?? "";
});

// a refusal is shown at the top of the page: scroll to it; otherwise the focus stays at the form's item
document.addEventListener("htmx:after:swap", () => {
  afterSwap();
  const refusal = document.querySelector("#problem .refused, #conflict");
  refusal?.scrollIntoView({ block: "nearest" });
  if (sentFor === null) return;
  const isLost = !document.activeElement?.checkVisibility() || document.activeElement === document.body;
  const next = refusal ? document.getElementById("conflict") : (document.getElementById(`item-${sentFor}`) ?? document.getElementById("said"));
  if (isLost) next?.focus({ preventScroll: !refusal });
  sentFor = null;
});

// --- drawing an outline in the left photograph

document.addEventListener("click", (event) => {
  const button = event.target.closest("[data-draw-start]");
  if (!button) return;
  const field = button.closest(".outline-field");
  const svg = document.querySelector('svg[data-photograph="left"]');
  startDrawing(svg, field.querySelector("textarea"), button);
});

// --- from the run's scene: outlines in the right photograph, the marker's corners in both

async function drawScene() {
  const scene = await loadScene();
  if (!scene) return; // the outlines in the left photograph are shown without it
  for (const side of ["left", "right"]) {
    const group = document.querySelector(`svg[data-photograph="${side}"] [data-corners]`);
    const arm = (group?.ownerSVGElement.viewBox.baseVal.width ?? 0) / 220;
    group?.replaceChildren(...(scene.file.photographs?.[side]?.marker_corners_px ?? []).map((at) => cornerMark(at, arm)));
  }
  const right = document.querySelector('svg[data-photograph="right"]');
  if (!right) return;
  for (const old of right.querySelectorAll("a[data-item]")) old.remove();
  const size = right.viewBox.baseVal.width / 28;
  for (const item of scene.file.items ?? []) {
    const shown = scene.items[item.index];
    if (shown && item.right_rings_px?.length) right.append(outline(item, shown, size));
  }
}

function cornerMark([x, y], arm) {
  const mark = document.createElementNS(SVG, "path");
  mark.setAttribute("d", `M${x - arm} ${y} H${x + arm} M${x} ${y - arm} V${y + arm}`);
  mark.setAttribute("vector-effect", "non-scaling-stroke");
  return mark;
}

function outline(item, shown, size) {
  const link = document.createElementNS(SVG, "a");
  link.setAttribute("href", `#item-${shown.id}`);
  link.setAttribute("class", `outline colour-${((shown.number - 1) % 6) + 1} ${item.right_rings_from === "shape" ? "reckoned" : ""}`);
  link.dataset.item = shown.id;
  link.setAttribute("aria-label", `Item ${shown.number} in the right photograph`);
  const path = document.createElementNS(SVG, "path");
  path.setAttribute("d", item.right_rings_px.map((ring) => `M${ring.map((point) => point.join(" ")).join(" L")} Z`).join(" "));
  path.setAttribute("fill-rule", "evenodd");
  path.setAttribute("vector-effect", "non-scaling-stroke");
  const ring = item.right_rings_px[0];
  const label = document.createElementNS(SVG, "text");
  const middle = (axis) => ring.reduce((sum, point) => sum + point[axis], 0) / ring.length;
  for (const [name, value] of Object.entries({ x: middle(0), y: middle(1), "font-size": size, "text-anchor": "middle", "dominant-baseline": "central", "aria-hidden": "true" })) {
    label.setAttribute(name, String(value));
  }
  label.textContent = String(shown.number);
  link.append(path, label);
  return link;
}

function afterSwap() {
  for (const button of document.querySelectorAll("[data-draw-start]")) {
    button.hidden = !document.querySelector('svg[data-photograph="left"]');
  }
  drawScene();
}

afterSwap();
