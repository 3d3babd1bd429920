// The WebGL view: pointer, keys and buttons turn the camera; it is drawn only when something changed.

import * as THREE from "./vendor/three/three.module.min.js";
import { OrbitControls } from "./vendor/three/OrbitControls.min.js";
import { buildLayers, setWireframe, sizeLabels } from "./meal3d-layers.js";

const FIELD_OF_VIEW = 32; // degrees
const NEAR_MM = 10;
const FAR_MM = 6000;
const MARGIN = 1.06; // around the contents
const TURN = Math.PI / 18; // per key press
const ZOOM = 1.15; // per key press
const PAN_PX = 30;
const MOVE_MS = 280; // from one view to another, unless motion is reduced

/** canvas, scene.json, names of the foods by index, palette() -> {ink, ground}. Throws if WebGL is not available. */
export function openView(canvas, scene, names, palette) {
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
  renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
  const camera = new THREE.PerspectiveCamera(FIELD_OF_VIEW, 1, NEAR_MM, FAR_MM);
  camera.up.set(0, 0, 1);
  const stage = new THREE.Scene();
  stage.add(new THREE.HemisphereLight(0xffffff, 0x8a8478, 2.2));
  const lamp = new THREE.DirectionalLight(0xffffff, 1.6);
  stage.add(lamp, lamp.target);
  let built = buildLayers(scene, names, palette());
  stage.add(built.root);
  built.box.getCenter(lamp.target.position);
  lamp.position.copy(lamp.target.position).add(new THREE.Vector3(-250, -150, 500));

  const controls = new OrbitControls(camera, canvas);
  canvas.style.touchAction = "pan-y"; // a vertical swipe scrolls the page
  controls.minDistance = 30;
  controls.maxDistance = 2500;
  let frame = 0;
  let moving = 0;
  const draw = () => {
    frame = 0;
    renderer.render(stage, camera);
    canvas.dataset.frames = Number(canvas.dataset.frames ?? 0) + 1;
  };
  const invalidate = () => {
    frame ||= requestAnimationFrame(draw);
  };
  controls.addEventListener("change", invalidate);
  controls.addEventListener("start", () => cancelAnimationFrame(moving));

  const shown = { points: true, shapes: true, slices: false, board: true, grid: true, cameras: false, scale: true };
  let isWire = false;
  const apply = () => {
    for (const [name, isShown] of Object.entries(shown)) built.layers[name].visible = isShown;
    built.layers.sheet.visible = !shown.board;
    setWireframe(built.layers, isWire);
    sizeLabels(built.root, FIELD_OF_VIEW, canvas.parentElement.clientHeight);
    invalidate();
  };

  const framed = () => (shown.cameras ? built.withCameras : built.box);
  // at the distance from the centre, in this direction, at which the whole box is visible
  const away = (direction) => {
    const { min, max } = framed();
    const middle = framed().getCenter(new THREE.Vector3());
    const across = new THREE.Vector3(0, 0, 1).cross(direction).normalize();
    const up = direction.clone().cross(across);
    const tangent = Math.tan((FIELD_OF_VIEW / 2) * (Math.PI / 180));
    const needed = Array.from({ length: 8 }, (_, k) => {
      const corner = new THREE.Vector3(k & 1 ? max.x : min.x, k & 2 ? max.y : min.y, k & 4 ? max.z : min.z).sub(middle);
      const wide = Math.abs(corner.dot(across)) / (tangent * camera.aspect);
      return corner.dot(direction) + Math.max(wide, Math.abs(corner.dot(up)) / tangent);
    });
    return MARGIN * Math.max(...needed);
  };
  const level = () => {
    const towards = directions.phone().setZ(0);
    return towards.lengthSq() > 1e-6 ? towards.normalize() : towards.set(0, -1, 0);
  };
  const directions = {
    phone: () => {
      const centre = scene.photographs.left.camera?.centre_mm;
      return centre ? new THREE.Vector3(...centre).sub(lamp.target.position).normalize() : new THREE.Vector3(0, -1, 0.9).normalize();
    },
    above: () => level().multiplyScalar(0.001).setZ(1).normalize(),
    side: () => level().setZ(0.12).normalize(),
  };
  const place = (position, target) => {
    camera.position.copy(position);
    controls.target.copy(target);
    controls.update();
    invalidate();
  };
  const setView = (name, atOnce = false) => {
    cancelAnimationFrame(moving);
    const direction = directions[name]();
    const middle = framed().getCenter(new THREE.Vector3());
    const goal = direction.clone().multiplyScalar(away(direction)).add(middle);
    const [from, aim] = [camera.position.clone(), controls.target.clone()];
    if (atOnce || matchMedia("(prefers-reduced-motion: reduce)").matches) return place(goal, middle);
    const began = performance.now();
    const step = (now) => {
      const share = Math.min(1, Math.max(0, (now - began) / MOVE_MS));
      const eased = share * share * (3 - 2 * share);
      place(from.clone().lerp(goal, eased), aim.clone().lerp(middle, eased));
      if (share < 1) moving = requestAnimationFrame(step);
    };
    moving = requestAnimationFrame(step);
    return undefined;
  };

  const keys = {
    ArrowLeft: (isShift) => (isShift ? controls.pan(PAN_PX, 0) : controls.rotateLeft(TURN)),
    ArrowRight: (isShift) => (isShift ? controls.pan(-PAN_PX, 0) : controls.rotateLeft(-TURN)),
    ArrowUp: (isShift) => (isShift ? controls.pan(0, PAN_PX) : controls.rotateUp(TURN)),
    ArrowDown: (isShift) => (isShift ? controls.pan(0, -PAN_PX) : controls.rotateUp(-TURN)),
    "+": () => controls.dollyIn(1 / ZOOM),
    "=": () => controls.dollyIn(1 / ZOOM),
    "-": () => controls.dollyOut(1 / ZOOM),
    0: () => setView("phone"),
    Home: () => setView("phone"),
  };
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !Object.hasOwn(keys, event.key)) return;
    event.preventDefault();
    keys[event.key](event.shiftKey);
    controls.update();
  });
  // zoom only if the view has the focus, so that scrolling the page does not zoom
  canvas.addEventListener("wheel", (event) => {
    controls.enableZoom = event.ctrlKey || document.activeElement === canvas;
  }, { capture: true, passive: true });
  canvas.addEventListener("pointerdown", () => {
    controls.enableZoom = true;
    canvas.focus({ preventScroll: true });
  }, { capture: true });

  const resize = () => {
    const { clientWidth: width, clientHeight: height } = canvas.parentElement;
    if (!width || !height) return;
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    renderer.setSize(width, height, false);
    sizeLabels(built.root, FIELD_OF_VIEW, height);
    invalidate();
  };
  const observer = new ResizeObserver(resize);
  observer.observe(canvas.parentElement);
  resize();
  setView("phone", true);
  apply();

  return {
    setView,
    setShown: (name, isShown) => {
      shown[name] = isShown;
      apply();
      if (name === "cameras") setView(isShown ? "side" : "phone"); // they are far outside of the former frame
    },
    setWire: (is) => {
      isWire = is;
      apply();
    },
    /** Text is drawn in the page's colours: drawn again when they change. */
    repaint: () => {
      stage.remove(built.root);
      built.dispose();
      built = buildLayers(scene, names, palette());
      stage.add(built.root);
      apply();
    },
    close: () => {
      cancelAnimationFrame(frame);
      cancelAnimationFrame(moving);
      observer.disconnect();
      controls.dispose();
      built.dispose();
      renderer.dispose();
      renderer.forceContextLoss();
    },
  };
}
