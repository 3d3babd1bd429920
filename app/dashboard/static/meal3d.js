// The meal in 3D: <div data-scene="…/scene.json" data-fallback="…/points.jpg" data-names='["Apple"]'></div>.
//
// The module mounts all such elements, also those that htmx inserts later, and closes those that are removed. three.js is
// only loaded if there is a scene and WebGL.

import { VERSION, sentenceOf, tableOf } from "./meal3d-data.js";

const LAYERS = [
  ["points", "Points", true],
  ["shapes", "Shapes", true],
  ["wire", "As wire", false],
  ["slices", "Slices", false],
  ["board", "Board", true],
  ["grid", "Table grid", true],
  ["scale", "Ruler and names", true],
  ["cameras", "Cameras", false],
];
const VIEWS = [["phone", "Reset view"], ["above", "From above"], ["side", "From the side"]];
const KEYS =
  "Drag to turn, scroll to zoom, right button or two fingers to move. " +
  "Keys: arrows turn, + and − zoom, Shift with arrows moves, 0 resets.";
const mounted = new Map(); // element -> handle
let serial = 0;

/** Draw a scene into an element, replacing its content. Returns {ready, unmount()}; ready never rejects.
 *
 * options: fallbackUrl of a picture for browsers without WebGL; names of the foods, by their index in the run.
 */
export function mountScene(element, sceneUrl, options = {}) {
  mounted.get(element)?.unmount();
  addStyles();
  const ended = new AbortController();
  const root = make("div", "meal3d");
  const told = make("p", "meal3d-told", "Loading the 3D view …");
  told.setAttribute("role", "status");
  root.append(told);
  element.replaceChildren(root);
  let view = null;
  const handle = {
    root,
    url: sceneUrl,
    unmount: () => {
      ended.abort();
      view?.close();
      view = null;
      root.remove();
      if (mounted.get(element) === handle) mounted.delete(element);
    },
  };
  const start = async () => {
    const scene = await fetchScene(sceneUrl, ended.signal);
    const names = options.names ?? [];
    const table = make("div", "meal3d-table");
    table.append(tableOf(scene, names));
    root.append(table);
    if (!hasWebGl()) throw new ToldError("This browser has no WebGL, so the 3D view cannot be drawn.");
    const { openView } = await import("./meal3d-view.js");
    if (ended.signal.aborted) return;
    const parts = frameOf(scene, names);
    told.replaceWith(...parts.outer);
    view = openView(parts.canvas, scene, names, palette);
    connect(parts, view, ended.signal);
  };
  handle.ready = start().catch((error) => {
    if (ended.signal.aborted) return;
    if (!(error instanceof ToldError)) console.error(error);
    const words = error instanceof ToldError ? error.message : "The 3D view cannot be drawn.";
    root.querySelectorAll(".meal3d-view, .meal3d-bar, .meal3d-keys").forEach((part) => part.remove());
    told.textContent = words;
    told.classList.add("notice");
    root.prepend(told, ...fallbackOf(options.fallbackUrl));
  });
  mounted.set(element, handle);
  return handle;
}

/** Mount new elements and close removed ones, also after htmx swaps. */
export function mountAll() {
  for (const [element, handle] of mounted) {
    const isThere = element.isConnected && element.contains(handle.root) && (element.dataset.scene ?? handle.url) === handle.url;
    if (!isThere) handle.unmount();
  }
  for (const element of document.querySelectorAll("[data-scene]")) {
    if (mounted.has(element) || !element.dataset.scene) continue;
    mountScene(element, element.dataset.scene, { fallbackUrl: element.dataset.fallback, names: namesOf(element) });
  }
}

class ToldError extends Error {}

async function fetchScene(url, signal) {
  let answer;
  try {
    answer = await fetch(url, { headers: { Accept: "application/json" }, signal });
  } catch {
    throw new ToldError("The 3D view could not be loaded: the server does not answer.");
  }
  if (answer.status === 410) throw new ToldError("The pictures of this meal were erased.");
  if (answer.status === 404) throw new ToldError("There is no 3D view of this run.");
  if (!answer.ok) throw new ToldError("The 3D view could not be loaded.");
  if (!answer.headers.get("Content-Type")?.includes("json")) throw new ToldError("The 3D view could not be loaded: reload the page.");
  const scene = await answer.json();
  if (scene.version !== VERSION) throw new ToldError("The 3D view is of another version: reload the page.");
  return scene;
}

function frameOf(scene, names) {
  const box = make("div", "meal3d-view");
  const canvas = make("canvas");
  const keys = make("p", "meal3d-keys", KEYS);
  keys.id = `meal3d-keys-${(serial += 1)}`;
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "application");
  canvas.setAttribute("aria-label", sentenceOf(scene, names));
  canvas.setAttribute("aria-describedby", keys.id);
  const lost = make("p", "meal3d-told");
  lost.setAttribute("role", "status");
  box.append(canvas, lost);
  const bar = make("div", "meal3d-bar");
  const layers = make("fieldset");
  layers.append(make("legend", "", "What the 3D view shows"));
  for (const [name, words, isOn] of LAYERS) {
    const label = make("label");
    const field = make("input");
    field.type = "checkbox";
    field.value = name;
    field.checked = isOn;
    label.append(field, words);
    layers.append(label);
  }
  const views = make("fieldset");
  views.append(make("legend", "", "From where it is seen"));
  for (const [name, words] of VIEWS) {
    const button = make("button", "", words);
    button.type = "button";
    button.value = name;
    views.append(button);
  }
  bar.append(layers, views);
  return { outer: [box, bar, keys], canvas, lost, layers, views };
}

function connect({ canvas, lost, layers, views }, view, signal) {
  layers.addEventListener("change", ({ target }) => {
    if (target.value === "wire") view.setWire(target.checked);
    else view.setShown(target.value, target.checked);
  });
  views.addEventListener("click", ({ target }) => {
    if (target.closest("button")) view.setView(target.closest("button").value);
  });
  canvas.addEventListener("webglcontextlost", (event) => {
    event.preventDefault(); // so that the context can be restored
    if (!signal.aborted) lost.textContent = "The graphics card let go of the 3D view. Reload the page if it does not come back.";
  });
  canvas.addEventListener("webglcontextrestored", () => {
    lost.textContent = "";
    view.repaint();
  });
  const repaint = () => view.repaint();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", repaint, { signal });
  const theme = new MutationObserver(repaint);
  theme.observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme"] });
  signal.addEventListener("abort", () => theme.disconnect());
}

/** The page's current colours (app.css). */
function palette() {
  const style = getComputedStyle(document.documentElement);
  const isDark = style.colorScheme.includes("dark") && !style.colorScheme.includes("light");
  const token = (name, other) => style.getPropertyValue(name).trim() || other;
  return { ink: token("--ink", isDark ? "#e8ece9" : "#1c2320"), ground: token("--surface", isDark ? "#1d2320" : "#ffffff") };
}

function fallbackOf(url) {
  if (!url) return [];
  const picture = make("img", "meal3d-fallback");
  picture.alt = "The foods' points as measured, drawn by the server; the table below has their sizes.";
  picture.addEventListener("error", () => picture.remove());
  picture.src = url;
  return [picture];
}

function hasWebGl() {
  const context = document.createElement("canvas").getContext("webgl2");
  context?.getExtension("WEBGL_lose_context")?.loseContext(); // browsers allow about sixteen at once
  return Boolean(context);
}

function namesOf(element) {
  try {
    const names = JSON.parse(element.dataset.names ?? "[]");
    return Array.isArray(names) ? names.map(String) : [];
  } catch {
    return [];
  }
}

function addStyles() {
  const url = new URL("./meal3d.css", import.meta.url).href;
  const sheets = [...document.querySelectorAll('link[rel="stylesheet"]')];
  if (sheets.some((link) => new URL(link.href).pathname === new URL(url).pathname)) return;
  const link = make("link");
  link.rel = "stylesheet";
  link.href = url;
  document.head.append(link);
}

function make(tag, className = "", text = "") {
  const element = document.createElement(tag);
  if (className) element.className = className;
  if (text) element.textContent = text;
  return element;
}

mountAll();
new MutationObserver(mountAll).observe(document.documentElement, {
  childList: true,
  subtree: true,
  attributes: true,
  attributeFilter: ["data-scene"],
});
