// scene.json (docs/volume.md) as numbers, and the text and table beside the picture.

export const VERSION = 1;
export const ITEM_COLOURS = ["#dc2828", "#28aa3c", "#1e78dc", "#e6a01e", "#aa32be"]; // as in overlay.jpg

const TYPES = { int16: Int16Array, uint16: Uint16Array, uint8: Uint8Array };

/** Packed rows -> {values, columns}: integers, or a Float32Array if they have a scale. */
export function unpack(packed) {
  const text = atob(packed.base64);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i += 1) bytes[i] = text.charCodeAt(i);
  const whole = new TYPES[packed.type](bytes.buffer); // little endian, as on every machine with a browser
  const columns = packed.shape[1];
  if (!packed.scale) return { values: whole, columns };
  const values = new Float32Array(whole.length);
  for (let i = 0; i < whole.length; i += 1) values[i] = packed.offset[i % columns] + packed.scale[i % columns] * whole[i];
  return { values, columns };
}

export function colourOf(index) {
  return ITEM_COLOURS[index % ITEM_COLOURS.length];
}

export function nameOf(item, names) {
  return names[item.index] || `Food ${item.index + 1}`;
}

/** The text alternative: the picture's contents as a table, shown with and without WebGL. */
export function tableOf(scene, names) {
  const table = document.createElement("table");
  const caption = table.createCaption();
  caption.textContent = "What this run measured. Size: the smallest upright box about the shape.";
  const head = table.createTHead().insertRow();
  for (const [words, isNumber] of [["Food", false], ["Volume", true], ["90 % interval", true], ["Width × depth × height", true]]) {
    const cell = document.createElement("th");
    cell.scope = "col";
    cell.textContent = words;
    if (isNumber) cell.className = "num";
    head.append(cell);
  }
  const body = table.createTBody();
  for (const item of scene.items ?? []) {
    const row = body.insertRow();
    const name = document.createElement("th");
    name.scope = "row";
    const swatch = document.createElement("span");
    swatch.className = "meal3d-swatch";
    swatch.style.backgroundColor = colourOf(item.index);
    name.append(swatch, `${item.index + 1} · ${nameOf(item, names)}`);
    row.append(name);
    const size = item.size_mm;
    const interval = item.volume_interval_ml;
    for (const words of [
      item.volume_ml === null ? "not measurable" : `${volume(item.volume_ml)} ml`,
      interval ? `${volume(interval[0])} to ${volume(interval[1])} ml` : "–",
      size ? `${size.width.toFixed(0)} × ${size.depth.toFixed(0)} × ${size.height.toFixed(0)} mm` : "–",
    ]) {
      const cell = row.insertCell();
      cell.className = "num";
      cell.textContent = words;
    }
    if (differs(item)) {
      const note = document.createElement("small");
      note.textContent = ` (shape drawn: ${volume(item.mesh_volume_ml)} ml)`;
      row.cells[1].append(note);
    }
  }
  if (!body.rows.length) {
    const cell = body.insertRow().insertCell();
    cell.colSpan = 4;
    cell.textContent = "No food was measured.";
  }
  return table;
}

/** A sentence for people who cannot see the picture. */
export function sentenceOf(scene, names) {
  const items = scene.items ?? [];
  const board = scene.board ? `the board ${scene.board.marker}` : null;
  if (!items.length) return `3D view of the table${board ? ` and ${board}` : ""}; no food was measured.`;
  const foods = items.map((item) => nameOf(item, names)).join(", ");
  return `3D view of ${foods} on the table${board ? ` beside ${board}` : ""}. The table below has the sizes.`;
}

function volume(ml) {
  return ml >= 100 ? ml.toFixed(0) : ml.toFixed(1);
}

// the default method's volume is an average over several shapes; the most likely one is drawn
function differs(item) {
  return item.mesh_volume_ml !== undefined && Math.abs(item.mesh_volume_ml / item.volume_ml - 1) > 0.01;
}
