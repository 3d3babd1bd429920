// The layers of the 3D view: points, closed shapes, slices, the board, cameras, a ruler. Lengths in mm, z up.

import * as THREE from "./vendor/three/three.module.min.js";
import { colourOf, nameOf, unpack } from "./meal3d-data.js";

const CREASE = Math.cos((40 * Math.PI) / 180); // sharper edges are drawn as edges
const CORNERS = 64; // of a slice's ellipse
const SHEET_MM = 6; // a point this near to the print belongs to the sheet
const BEHIND_UNITS = 1200; // depth offset of shapes behind their measured points: 1 mm at usual distances
const CAMERA_MM = 40; // length of a drawn camera
const NAME_PX = 26;
const SMALL_PX = 18;
const UNSEEN = new Set(["mirrored", "continued"]); // slices that no photograph shows

/** {root, layers by name, box of the foods and the board, withCameras, dispose()}. palette: {ink, ground}, as CSS colours. */
export function buildLayers(scene, names, palette) {
  const root = new THREE.Group();
  const layers = {};
  const add = (name, objects) => {
    layers[name] = new THREE.Group();
    for (const object of objects.filter(Boolean)) layers[name].add(object);
    root.add(layers[name]);
  };
  const cloud = scene.points ? cloudOf(scene) : null;
  add("points", cloud ? [cloud.foods, cloud.table] : []);
  add("grid", [...gridOf(scene, cloud?.box, palette)]);
  add("board", scene.board ? [...boardOf(scene.board)] : []);
  layers.sheet = new THREE.Group(); // the board's points; the drawn board replaces them
  if (cloud) layers.sheet.add(cloud.sheet);
  layers.points.add(layers.sheet);
  const meshes = (scene.items ?? []).filter((item) => item.shape).map((item) => shapeOf(scene, item, cloud));
  add("shapes", meshes);
  add("slices", (scene.items ?? []).flatMap(slicesOf));
  add("cameras", Object.entries(scene.photographs).flatMap(([name, photo]) => cameraOf(name, photo, palette)));
  const seen = new THREE.Box3();
  for (const mesh of meshes) seen.expandByObject(mesh);
  seen.expandByObject(layers.board);
  if (seen.isEmpty()) seen.expandByObject(layers.grid); // neither a shape nor a board
  add("scale", [...rulerOf(scene.board, seen, palette), ...meshes.map((mesh) => badgeOf(mesh, names, palette))]);
  return {
    root,
    layers,
    box: seen.expandByVector(new THREE.Vector3(8, 8, 8)),
    withCameras: seen.clone().union(new THREE.Box3().setFromObject(layers.cameras)),
    dispose: () => root.traverse(disposeOf),
  };
}

export function setWireframe(layers, isWire) {
  layers.shapes.traverse((each) => {
    if (!each.isMesh) return;
    each.material.wireframe = isWire;
    each.material.opacity = isWire ? 0.55 : 1;
    each.material.transparent = isWire;
    each.material.needsUpdate = true;
  });
}

/** Text has the page's size at any distance. height: of the view, px. */
export function sizeLabels(root, fieldOfView, height) {
  const onePixel = (2 * Math.tan((fieldOfView / 2) * (Math.PI / 180))) / Math.max(height, 1);
  root.traverse((each) => {
    if (each.isSprite) each.scale.set(each.userData.width * onePixel, each.userData.height * onePixel, 1);
  });
}

function disposeOf(object) {
  object.geometry?.dispose();
  for (const material of [object.material].flat().filter(Boolean)) {
    material.map?.dispose();
    material.dispose();
  }
}

function linear(colour) {
  return new THREE.Color().setRGB(colour[0] / 255, colour[1] / 255, colour[2] / 255, THREE.SRGBColorSpace);
}

function cloudOf(scene) {
  const { values: places } = unpack(scene.points.positions);
  const { values: bytes } = unpack(scene.points.colours);
  const toLinear = Float32Array.from({ length: 256 }, (_, value) => linear([value, value, value]).r);
  const half = scene.board ? sizeOf(scene.board).map((mm) => mm / 2 + scene.board.margin_mm) : [0, 0];
  const ofFoods = (scene.items ?? []).reduce((sum, item) => Math.max(sum, item.points.start + item.points.count), 0);
  const groups = { foods: { at: [], paint: [] }, table: { at: [], paint: [] }, sheet: { at: [], paint: [] } };
  for (let i = 0; i < places.length; i += 3) {
    const onSheet = Math.abs(places[i]) < half[0] && Math.abs(places[i + 1]) < half[1] && Math.abs(places[i + 2]) < SHEET_MM;
    const group = i < 3 * ofFoods ? groups.foods : onSheet ? groups.sheet : groups.table;
    group.at.push(places[i], places[i + 1], places[i + 2]);
    group.paint.push(toLinear[bytes[i]], toLinear[bytes[i + 1]], toLinear[bytes[i + 2]]);
  }
  const { box, mm } = spreadOf(groups.table.at);
  const size = { foods: 1.4, table: mm, sheet: mm };
  return { box, ...Object.fromEntries(Object.entries(groups).map(([name, group]) => [name, pointsOf(group, size[name])])) };
}

/** The extent of the table's points, and the size at which they cover it. */
function spreadOf(at) {
  const box = new THREE.Box2();
  const point = new THREE.Vector2();
  const cells = new Set(); // cells of a centimetre with a point
  for (let i = 0; i < at.length; i += 3) {
    box.expandByPoint(point.set(at[i], at[i + 1]));
    cells.add(Math.floor(at[i] / 10) * 4096 + Math.floor(at[i + 1] / 10));
  }
  const spacing = Math.sqrt((100 * cells.size) / Math.max(at.length / 3, 1));
  return { box, mm: Math.min(Math.max(1.8 * spacing, 1), 5) };
}

function pointsOf({ at, paint }, size) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(at, 3));
  geometry.setAttribute("color", new THREE.Float32BufferAttribute(paint, 3));
  return new THREE.Points(geometry, new THREE.PointsMaterial({ size, vertexColors: true, map: discOf(), alphaTest: 0.5 }));
}

function discOf() {
  const side = 32;
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = side;
  const context = canvas.getContext("2d");
  context.fillStyle = "#fff";
  context.arc(side / 2, side / 2, side / 2 - 0.5, 0, 2 * Math.PI);
  context.fill();
  return new THREE.CanvasTexture(canvas);
}

/** The mean colour of the food's points, paler: parts that no photograph shows get no invented colour. */
function paintOf(item, cloud) {
  const paint = cloud?.foods.geometry.getAttribute("color").array ?? [];
  const mean = new THREE.Color(0, 0, 0);
  const { start, count } = item.points;
  if (!count) return mean.set(colourOf(item.index));
  for (let i = 3 * start; i < 3 * (start + count); i += 3) mean.add({ r: paint[i], g: paint[i + 1], b: paint[i + 2] });
  return mean.multiplyScalar(1 / count).lerp(new THREE.Color("#b9b9b2"), 0.45);
}

function shapeOf(scene, item, cloud) {
  const { values: vertices } = unpack(item.shape.vertices);
  const { values: faces } = unpack(scene.topologies[item.shape.topology]);
  const geometry = creased(vertices, faces);
  const material = new THREE.MeshStandardMaterial({
    color: paintOf(item, cloud),
    roughness: 0.85,
    polygonOffset: true,
    polygonOffsetFactor: 1,
    polygonOffsetUnits: BEHIND_UNITS,
  });
  const mesh = new THREE.Mesh(geometry, material);
  mesh.userData.item = item;
  return mesh;
}

/** Triangles with a normal per corner: the mean over the adjacent faces of similar direction. */
function creased(vertices, faces) {
  const count = faces.length / 3;
  const normals = new Float32Array(faces.length);
  const around = Array.from({ length: vertices.length / 3 }, () => []);
  const [a, b, c] = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3()];
  for (let face = 0; face < count; face += 1) {
    [a, b, c].forEach((corner, k) => corner.fromArray(vertices, 3 * faces[3 * face + k]));
    b.sub(a).cross(c.sub(a)).toArray(normals, 3 * face); // its length is twice the area
    for (let k = 0; k < 3; k += 1) around[faces[3 * face + k]].push(face);
  }
  const at = new Float32Array(3 * faces.length);
  const smooth = new Float32Array(3 * faces.length);
  const [own, other, sum] = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3()];
  for (let corner = 0; corner < faces.length; corner += 1) {
    at.set(vertices.subarray(3 * faces[corner], 3 * faces[corner] + 3), 3 * corner);
    own.fromArray(normals, 3 * Math.floor(corner / 3));
    sum.set(0, 0, 0);
    for (const face of around[faces[corner]]) {
      other.fromArray(normals, 3 * face);
      if (other.dot(own) >= CREASE * other.length() * own.length()) sum.add(other);
    }
    sum.normalize().toArray(smooth, 3 * corner);
  }
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(at, 3));
  geometry.setAttribute("normal", new THREE.BufferAttribute(smooth, 3));
  return geometry;
}

function slicesOf(item) {
  const lines = { seen: [], unseen: [] };
  for (const slice of item.slices ?? []) {
    const z = (slice.low_mm + slice.high_mm) / 2;
    const place = (k) => {
      const turn = (2 * Math.PI * k) / CORNERS;
      const [x, y] = [slice.half_axes_mm[0] * Math.cos(turn), slice.half_axes_mm[1] * Math.sin(turn)];
      const [cosine, sine] = [Math.cos(slice.heading_rad), Math.sin(slice.heading_rad)];
      return [slice.centre_mm[0] + cosine * x - sine * y, slice.centre_mm[1] + sine * x + cosine * y, z];
    };
    const line = UNSEEN.has(slice.source) ? lines.unseen : lines.seen;
    for (let k = 0; k < CORNERS; k += 1) line.push(...place(k), ...place(k + 1));
  }
  const colour = new THREE.Color(colourOf(item.index)).lerp(new THREE.Color("#000"), 0.35);
  return Object.entries(lines)
    .filter(([, at]) => at.length)
    .map(([name, at]) => segments(at, { color: colour, transparent: name === "unseen", opacity: name === "unseen" ? 0.45 : 1 }));
}

function segments(at, options) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(at, 3));
  return new THREE.LineSegments(geometry, new THREE.LineBasicMaterial(options));
}

/** Width and height of the print, mm; files before ArUco boards have no gap_mm. */
function sizeOf(board) {
  const gap = board.gap_mm ?? 0;
  return [board.columns, board.rows].map((count) => count * board.square_mm + (count - 1) * gap);
}

function* boardOf(board) {
  const side = board.square_mm;
  const [width, height] = sizeOf(board);
  const pitch = side + (board.gap_mm ?? 0);
  const margin = board.margin_mm;
  const sheet = [-width / 2 - margin, -height / 2 - margin, width + 2 * margin, height + 2 * margin, [255, 255, 255]];
  yield quadsOf([sheet], 0.05);
  const squares = board.square_colours.map((colour, k) => {
    const [row, column] = [Math.floor(k / board.columns), k % board.columns];
    return [column * pitch - width / 2, height / 2 - row * pitch - side, side, side, colour];
  });
  yield quadsOf(squares, 0.25);
}

/** Upright rectangles [x, y, width, height, sRGB] at one height. */
function quadsOf(quads, z) {
  const [at, paint] = [[], []];
  for (const [x, y, width, height, colour] of quads) {
    const [a, b, c, d] = [[x, y, z], [x + width, y, z], [x + width, y + height, z], [x, y + height, z]];
    at.push(...a, ...b, ...c, ...a, ...c, ...d);
    const { r, g, b: blue } = linear(colour);
    for (let k = 0; k < 6; k += 1) paint.push(r, g, blue);
  }
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(at, 3));
  geometry.setAttribute("color", new THREE.Float32BufferAttribute(paint, 3));
  return new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ vertexColors: true, side: THREE.DoubleSide }));
}

/** The table as a plane with lines every 10 mm, stronger every 50 mm; a shade below each food. */
function* gridOf(scene, box, palette) {
  const low = box && !box.isEmpty() ? box.min : new THREE.Vector2(-150, -150);
  const high = box && !box.isEmpty() ? box.max : new THREE.Vector2(150, 150);
  const [x0, y0] = [low.x, low.y].map((mm) => Math.floor(mm / 50) * 50);
  const [x1, y1] = [high.x, high.y].map((mm) => Math.ceil(mm / 50) * 50);
  const [fine, strong] = [[], []];
  for (let x = x0; x <= x1; x += 10) (x % 50 ? fine : strong).push(x, y0, -0.6, x, y1, -0.6);
  for (let y = y0; y <= y1; y += 10) (y % 50 ? fine : strong).push(x0, y, -0.6, x1, y, -0.6);
  yield segments(fine, { color: palette.ink, transparent: true, opacity: 0.1 });
  yield segments(strong, { color: palette.ink, transparent: true, opacity: 0.28 });
  for (const item of scene.items ?? []) {
    const widest = (item.slices ?? []).reduce((best, one) => (!best || one.half_axes_mm[0] > best.half_axes_mm[0] ? one : best), null);
    if (!widest) continue;
    const shade = new THREE.Mesh(
      new THREE.CircleGeometry(1, CORNERS),
      new THREE.MeshBasicMaterial({ color: "#000", transparent: true, opacity: 0.3, map: softOf(), depthWrite: false }),
    );
    shade.scale.set(1.25 * widest.half_axes_mm[0], 1.25 * widest.half_axes_mm[1], 1);
    shade.rotation.z = widest.heading_rad;
    shade.position.set(...widest.centre_mm, Math.max(item.support_mm - 0.2, 0.4));
    yield shade;
  }
}

function softOf() {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 64;
  const context = canvas.getContext("2d");
  const fade = context.createRadialGradient(32, 32, 16, 32, 32, 32);
  fade.addColorStop(0, "rgba(255, 255, 255, 1)");
  fade.addColorStop(1, "rgba(255, 255, 255, 0)");
  context.fillStyle = fade;
  context.fillRect(0, 0, 64, 64);
  return new THREE.CanvasTexture(canvas);
}

function cameraOf(name, photo, palette) {
  if (!photo.camera) return [];
  const { fx, fy, cx, cy, rotation, centre_mm: centre } = photo.camera;
  const origin = new THREE.Vector3(...centre);
  const corner = (x, y) => {
    const ray = [((x - cx) / fx) * CAMERA_MM, ((y - cy) / fy) * CAMERA_MM, CAMERA_MM];
    // from the camera's axes to the table's: the transposed rotation
    const turned = [0, 1, 2].map((k) => rotation.reduce((sum, row, axis) => sum + row[k] * ray[axis], 0));
    return new THREE.Vector3(...turned).add(origin);
  };
  const [w, h] = [photo.width - 0.5, photo.height - 0.5];
  const corners = [corner(-0.5, -0.5), corner(w, -0.5), corner(w, h), corner(-0.5, h)];
  const at = corners.flatMap((one, k) => [...origin, ...one, ...one, ...corners[(k + 1) % 4]]);
  const label = labelOf(`${name} photograph`, SMALL_PX, palette);
  label.position.copy(origin).z += 6;
  return [segments(at, { color: palette.ink }), label];
}

/** A ruler of 100 mm along the board's lower edge, or that of what is seen, with a height of 50 mm at its end. */
function* rulerOf(board, seen, palette) {
  const [left, low] = board ? sizeOf(board).map((mm) => -mm / 2 - board.margin_mm) : [seen.min.x, seen.min.y];
  const y = low - 12;
  const tens = Array.from({ length: 10 }, (_, k) => [left + 10 * k, y, 10, 4, k % 2 ? [250, 250, 250] : [40, 44, 42]]);
  yield quadsOf(tens, 0.3);
  const upright = [];
  for (let z = 0; z <= 50; z += 10) upright.push(left, y, z, left + (z % 50 ? 3 : 6), y, z);
  yield segments([left, y, 0, left, y, 50, ...upright], { color: palette.ink });
  for (const [words, x, z] of [["50", left + 50, 0], ["100 mm", left + 100, 0], ["50 mm up", left, 52]]) {
    const label = labelOf(words, SMALL_PX, palette);
    label.position.set(x, z ? y : y - 3, z);
    if (!z) label.center.set(0.5, 0.5);
    yield label;
  }
}

function badgeOf(mesh, names, palette) {
  const item = mesh.userData.item;
  mesh.geometry.computeBoundingBox();
  const box = mesh.geometry.boundingBox;
  const label = labelOf(`${item.index + 1} · ${nameOf(item, names)}`, NAME_PX, palette, colourOf(item.index));
  label.position.set((box.min.x + box.max.x) / 2, (box.min.y + box.max.y) / 2, box.max.z + 12);
  return label;
}

/** Text that always faces the viewer, of a fixed height in px, above its place. */
function labelOf(words, height, palette, edge) {
  const [pixels, pad] = [48, 14];
  const canvas = document.createElement("canvas");
  const context = canvas.getContext("2d");
  const font = `600 ${pixels}px system-ui, sans-serif`;
  context.font = font;
  canvas.width = Math.ceil(context.measureText(words).width) + 2 * pad;
  canvas.height = pixels + 2 * pad;
  context.font = font;
  context.fillStyle = palette.ground;
  context.globalAlpha = 0.82;
  context.beginPath();
  context.roundRect(0, 0, canvas.width, canvas.height, pad);
  context.fill();
  context.globalAlpha = 1;
  if (edge) {
    context.strokeStyle = edge;
    context.lineWidth = 8;
    context.beginPath();
    context.roundRect(4, 4, canvas.width - 8, canvas.height - 8, pad);
    context.stroke();
  }
  context.fillStyle = palette.ink;
  context.textBaseline = "middle";
  context.fillText(words, pad, canvas.height / 2 + 2);
  const map = new THREE.CanvasTexture(canvas);
  map.colorSpace = THREE.SRGBColorSpace;
  const options = { map, transparent: true, depthWrite: false, depthTest: false, sizeAttenuation: false };
  const sprite = new THREE.Sprite(new THREE.SpriteMaterial(options));
  sprite.userData = { width: (height * canvas.width) / canvas.height, height };
  sprite.center.set(0.5, 0);
  sprite.renderOrder = 10;
  return sprite;
}
