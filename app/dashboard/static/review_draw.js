// Drawing an outline over a photograph by keys or mouse: arrows move a corner, Tab selects the next.

const SVG = "http://www.w3.org/2000/svg";
const STEPS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const MOST_CORNERS = 24; // at the start, so that they can be moved by hand
const REACH = 0.035; // of the picture's side: distance at which the pointer reaches a corner

// Simplifies a ring to at most `most` corners (Visvalingam: the corner of the smallest triangle is removed first).
export function fewerCorners(ring, most = MOST_CORNERS) {
  const corners = ring.map(([x, y]) => [x, y]);
  const area = (i) => {
    const [a, b, c] = [corners.at(i - 1), corners[i], corners[(i + 1) % corners.length]];
    return Math.abs((b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]));
  };
  while (corners.length > Math.max(3, most)) {
    let least = 0;
    for (let i = 1; i < corners.length; i += 1) if (area(i) < area(least)) least = i;
    corners.splice(least, 1);
  }
  return corners;
}

function octagon([x, y, width, height]) {
  const corners = [];
  for (let i = 0; i < 8; i += 1) {
    const angle = (Math.PI * (2 * i + 1)) / 8;
    corners.push([x + width / 2 + 0.3 * width * Math.cos(angle), y + height / 2 + 0.3 * height * Math.sin(angle)]);
  }
  return corners;
}

// Draws on `svg`, whose view is `near` [x, y, w, h] of a picture of `size` [w, h]. say(text): for the live region.
// done(corners) gets pixels to one decimal; done(null): cancelled. Returns {finish, cancel}.
export function drawOutline(svg, { ring, near, size, say, done }) {
  let view = around(near, size);
  let corners = ring.length >= 3 ? fewerCorners(ring) : octagon(near);
  let chosen = 0;
  let dragged = null;
  svg.setAttribute("viewBox", view.join(" "));
  const step = Math.max(1, Math.min(view[2], view[3]) / 200);
  const layer = document.createElementNS(SVG, "g");
  layer.setAttribute("class", "drawing");
  const area = layer.appendChild(document.createElementNS(SVG, "polygon"));
  const dots = layer.appendChild(document.createElementNS(SVG, "g"));
  svg.append(layer);
  const before = { role: svg.getAttribute("role"), label: svg.getAttribute("aria-label") };
  svg.setAttribute("tabindex", "0");
  svg.setAttribute("role", "application");
  svg.setAttribute(
    "aria-label",
    "Outline. Arrows move the corner, with Shift ten times as far; Tab next corner; plus adds one; Delete takes one out; Enter saves; Escape gives up.",
  );

  function keepInside([x, y]) {
    return [Math.min(Math.max(x, 0), size[0]), Math.min(Math.max(y, 0), size[1])];
  }

  // the view follows a corner that is moved out of it
  function keepInSight([x, y]) {
    const [left, top] = [Math.min(view[0], x), Math.min(view[1], y)];
    view = [left, top, Math.max(view[0] + view[2], x) - left, Math.max(view[1] + view[3], y) - top];
    svg.setAttribute("viewBox", view.join(" "));
  }

  function draw() {
    area.setAttribute("points", corners.map((corner) => corner.join(",")).join(" "));
    const radius = Math.min(view[2], view[3]) * 0.012;
    dots.replaceChildren(
      ...corners.map(([x, y], i) => {
        const dot = document.createElementNS(SVG, "circle");
        dot.setAttribute("cx", x);
        dot.setAttribute("cy", y);
        dot.setAttribute("r", i === chosen ? 1.7 * radius : radius);
        dot.setAttribute("class", i === chosen ? "corner chosen" : "corner");
        return dot;
      }),
    );
  }

  function tell() {
    const [x, y] = corners[chosen];
    say(`Corner ${chosen + 1} of ${corners.length}: ${Math.round(x)}, ${Math.round(y)}`);
  }

  function end(result) {
    svg.removeEventListener("keydown", onKey);
    svg.removeEventListener("pointerdown", onDown);
    svg.removeEventListener("pointermove", onMove);
    svg.removeEventListener("pointerup", onUp);
    svg.removeAttribute("tabindex");
    svg.setAttribute("viewBox", near.join(" "));
    svg.setAttribute("role", before.role);
    svg.setAttribute("aria-label", before.label);
    layer.remove();
    done(result);
  }

  function onKey(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const move = STEPS[event.key];
    if (move) {
      const far = step * (event.shiftKey ? 10 : 1);
      corners[chosen] = keepInside([corners[chosen][0] + far * move[0], corners[chosen][1] + far * move[1]]);
      keepInSight(corners[chosen]);
    } else if (event.key === "Tab") {
      chosen = (chosen + (event.shiftKey ? corners.length - 1 : 1)) % corners.length;
    } else if (event.key === "+" || event.key === "Insert") {
      const [a, b] = [corners[chosen], corners[(chosen + 1) % corners.length]];
      corners.splice(chosen + 1, 0, [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2]);
      chosen += 1;
    } else if (event.key === "Delete" || event.key === "Backspace" || event.key === "-") {
      if (corners.length > 3) corners.splice(chosen, 1);
      chosen %= corners.length;
    } else if (event.key === "Enter") {
      if (!event.repeat) end(corners.map(([x, y]) => [Math.round(10 * x) / 10, Math.round(10 * y) / 10]));
      event.preventDefault();
      event.stopPropagation();
      return;
    } else if (event.key === "Escape") {
      event.preventDefault();
      event.stopPropagation();
      end(null);
      return;
    } else {
      event.stopPropagation(); // letter keys make no decisions while drawing
      return;
    }
    event.preventDefault();
    event.stopPropagation();
    draw();
    tell();
  }

  function at(event) {
    const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    return keepInside([point.x, point.y]);
  }

  function onDown(event) {
    const [x, y] = at(event);
    const reach = REACH * Math.max(view[2], view[3]);
    const distances = corners.map((corner) => Math.hypot(corner[0] - x, corner[1] - y));
    const nearest = distances.indexOf(Math.min(...distances));
    if (distances[nearest] <= reach) {
      chosen = nearest;
    } else {
      chosen = nearestEdge(corners, [x, y]) + 1;
      corners.splice(chosen, 0, [x, y]);
    }
    dragged = event.pointerId;
    svg.setPointerCapture(dragged);
    svg.focus({ preventScroll: true });
    event.preventDefault();
    draw();
  }

  function onMove(event) {
    if (event.pointerId !== dragged) return;
    corners[chosen] = at(event);
    draw();
  }

  function onUp(event) {
    if (event.pointerId !== dragged) return;
    dragged = null;
    tell();
  }

  svg.addEventListener("keydown", onKey);
  svg.addEventListener("pointerdown", onDown);
  svg.addEventListener("pointermove", onMove);
  svg.addEventListener("pointerup", onUp);
  draw();
  svg.focus({ preventScroll: true });
  tell();
  return { finish: () => end(corners.map(([x, y]) => [Math.round(10 * x) / 10, Math.round(10 * y) / 10])), cancel: () => end(null) };
}

// Enlarges a view by half its size on each side, within the picture.
function around([x, y, width, height], size) {
  const [left, top] = [Math.max(0, x - width / 2), Math.max(0, y - height / 2)];
  return [left, top, Math.min(size[0], x + 1.5 * width) - left, Math.min(size[1], y + 1.5 * height) - top];
}

function nearestEdge(corners, [x, y]) {
  let best = [Infinity, 0];
  corners.forEach(([ax, ay], i) => {
    const [bx, by] = corners[(i + 1) % corners.length];
    const length = (bx - ax) ** 2 + (by - ay) ** 2 || 1;
    const t = Math.min(1, Math.max(0, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length));
    const distance = Math.hypot(ax + t * (bx - ax) - x, ay + t * (by - ay) - y);
    if (distance < best[0]) best = [distance, i];
  });
  return best[1];
}
