// Draws an outline over a photograph: corners are set by click and moved by drag or arrow keys; a textarea shows them.
// Mouse: click sets a corner, drag moves one. Keys: Tab selects the next corner, arrows move it (Shift: by ten),
// Insert or + adds one after it, Delete removes it, Enter finishes, Escape cancels.

const SVG = "http://www.w3.org/2000/svg";
const FIRST_SHARE = 0.2; // size of the first square, for drawing by keyboard

let stop = null; // ends the current drawing

export function startDrawing(svg, textarea, button) {
  stop?.();
  const before = textarea.value;
  const size = svg.viewBox.baseVal;
  const layer = svg.querySelector("[data-drawing]");
  const label = button.textContent;
  let points = readPoints(before);
  let dragged = null;

  const tell = (sentence) => {
    const place = document.getElementById("told");
    if (!place) return;
    const line = document.createElement("p");
    line.className = "told";
    line.textContent = sentence;
    place.replaceChildren(line);
  };

  function write() {
    textarea.value = points.map(([x, y]) => `${x.toFixed(1)}, ${y.toFixed(1)}`).join("\n");
  }

  function draw(focus = null) {
    layer.replaceChildren();
    if (points.length > 1) {
      const path = document.createElementNS(SVG, "path");
      path.setAttribute("class", "drawn");
      path.setAttribute("d", `M${points.map((point) => point.join(" ")).join(" L")} ${points.length > 2 ? "Z" : ""}`);
      path.setAttribute("vector-effect", "non-scaling-stroke");
      layer.append(path);
    }
    points.forEach(([x, y], index) => {
      const corner = document.createElementNS(SVG, "circle");
      corner.setAttribute("class", "corner");
      corner.setAttribute("cx", x);
      corner.setAttribute("cy", y);
      corner.setAttribute("r", size.width / 130);
      corner.setAttribute("tabindex", "0");
      corner.setAttribute("role", "button");
      corner.setAttribute("aria-label", `Corner ${index + 1} of ${points.length}, ${Math.round(x)}, ${Math.round(y)}`);
      corner.dataset.index = String(index);
      layer.append(corner);
      if (index === focus) corner.focus({ preventScroll: true });
    });
  }

  function place(event) {
    const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    return clamp(at.x, at.y);
  }

  function clamp(x, y) {
    const inside = (value, low, extent) => Math.min(Math.max(value, low), low + extent);
    return [inside(x, size.x, size.width), inside(y, size.y, size.height)];
  }

  function onDown(event) {
    if (event.button !== 0) return;
    event.preventDefault();
    const corner = event.target.closest?.(".corner");
    if (corner) {
      dragged = Number(corner.dataset.index);
    } else {
      const at = place(event);
      dragged = nearestSide(points, at);
      points.splice(dragged, 0, at);
    }
    svg.setPointerCapture(event.pointerId);
    write();
    draw(dragged);
  }

  function onMove(event) {
    if (dragged === null) return;
    points[dragged] = place(event);
    write();
    draw();
  }

  function onUp() {
    if (dragged !== null) draw(dragged);
    dragged = null;
  }

  function onKey(event) {
    const index = event.target.dataset?.index === undefined ? null : Number(event.target.dataset.index);
    const step = event.shiftKey ? 10 : 1;
    const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
    if (event.key === "Enter") end(true);
    else if (event.key === "Escape") end(false);
    else if (index === null) return;
    else if (moves[event.key]) {
      points[index] = clamp(points[index][0] + moves[event.key][0], points[index][1] + moves[event.key][1]);
      write();
      draw(index);
    } else if (event.key === "+" || event.key === "Insert") {
      const next = points[(index + 1) % points.length];
      points.splice(index + 1, 0, [(points[index][0] + next[0]) / 2, (points[index][1] + next[1]) / 2]);
      write();
      draw(index + 1);
    } else if (event.key === "Delete" || event.key === "Backspace") {
      points.splice(index, 1);
      write();
      draw(Math.min(index, points.length - 1));
    } else return;
    event.preventDefault();
    event.stopPropagation();
  }

  function onText() {
    points = readPoints(textarea.value);
    draw();
  }

  function end(isKept) {
    stop = null;
    if (!isKept) textarea.value = before;
    svg.classList.remove("drawing");
    layer.replaceChildren();
    svg.removeEventListener("pointerdown", onDown);
    svg.removeEventListener("pointermove", onMove);
    svg.removeEventListener("pointerup", onUp);
    svg.removeEventListener("click", noLink, true);
    svg.removeEventListener("keydown", onKey);
    textarea.removeEventListener("input", onText);
    button.removeEventListener("click", onDone);
    button.textContent = label;
    (isKept ? (textarea.form?.querySelector("button:not([type=button])") ?? textarea) : textarea).focus({ preventScroll: true });
    tell(isKept ? `Outline of ${points.length} corners: press the form's button to have it measured.` : "The drawing was given up.");
  }

  function onDone(event) {
    event.stopPropagation();
    end(true);
  }

  const noLink = (event) => event.preventDefault(); // the outlines below are links

  stop = () => end(true);
  if (points.length === 0) {
    const [x, y] = [size.x + size.width / 2, size.y + size.height / 2];
    const reach = (FIRST_SHARE * Math.min(size.width, size.height)) / 2;
    const isByKeyboard = button.matches(":focus-visible");
    if (isByKeyboard) points = [[x - reach, y - reach], [x + reach, y - reach], [x + reach, y + reach], [x - reach, y + reach]];
  }
  svg.classList.add("drawing");
  svg.addEventListener("pointerdown", onDown);
  svg.addEventListener("pointermove", onMove);
  svg.addEventListener("pointerup", onUp);
  svg.addEventListener("click", noLink, true);
  svg.addEventListener("keydown", onKey);
  textarea.addEventListener("input", onText);
  button.addEventListener("click", onDone);
  button.textContent = "Done drawing";
  write();
  draw(points.length ? 0 : null);
  svg.scrollIntoView({ block: "nearest" });
  tell("Click in the left photograph to set corners, drag to move them. Keys: Tab and arrows, + a new corner, Delete, Enter ends, Escape gives up.");
}

// Returns the index of a new corner: after the start of the nearest side; at the end if there are fewer than three.
function nearestSide(points, [x, y]) {
  if (points.length < 3) return points.length;
  let best = points.length;
  let least = Infinity;
  points.forEach(([ax, ay], index) => {
    const [bx, by] = points[(index + 1) % points.length];
    const length = (bx - ax) ** 2 + (by - ay) ** 2 || 1;
    const along = Math.min(1, Math.max(0, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length));
    const distance = (x - ax - along * (bx - ax)) ** 2 + (y - ay - along * (by - ay)) ** 2;
    if (distance < least) [least, best] = [distance, index + 1];
  });
  return best;
}

function readPoints(text) {
  const points = [];
  for (const line of text.split("\n")) {
    const numbers = line.trim().split(/[\s,;]+/).map(Number);
    if (numbers.length === 2 && line.trim() && numbers.every(Number.isFinite)) points.push(numbers);
  }
  return points;
}
