// A map of places without images from other hosts: points over a plain outline of the land (map-view.js has the
// numbers). <figure data-map data-land="address of land.json" data-meals="address of the study's meals">, its points in a JSON
// script: [[latitude, longitude, participant, local day, meal id]]. The table below has the same places.
import { MapView, around, degrees, eastOf } from "./map-view.js";

const POINT_PX = 5;
const REACH_PX = 10; // distance at which the pointer reaches a point
const PAN_PX = 60;
const TURN = [-360, 0, 360, 720]; // a ring may start on one turn of the globe and extend into the next

function token(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

// rings as they are stored: integer steps, each the difference from the previous point
export function readLand({ unit, rings }) {
  return rings.map((flat) => {
    const ring = new Float32Array(flat.length);
    let [x, y] = [0, 0];
    for (let n = 0; n < flat.length; n += 2) {
      ring[n] = (x += flat[n]) / unit;
      ring[n + 1] = (y += flat[n + 1]) / unit;
    }
    return ring;
  });
}

class PointMap {
  constructor(figure) {
    this.figure = figure;
    this.place = figure.querySelector(".map-place");
    this.told = figure.querySelector("output");
    this.points = JSON.parse(figure.querySelector('script[type="application/json"]').textContent).map(
      ([latitude, longitude, participant, day, meal]) => ({ latitude, longitude, participant, day, meal }),
    );
    this.land = [];
    this.view = new MapView(this.points);
    this.canvas = document.createElement("canvas");
    this.place.append(this.canvas);
    figure.classList.add("is-drawn");
    for (const button of figure.querySelectorAll("button[data-map-do]")) {
      button.addEventListener("click", () => this.act(button.dataset.mapDo));
    }
    this.listen();
    new ResizeObserver(() => this.resize()).observe(this.place);
    this.resize();
  }

  async loadLand() {
    const answer = await fetch(this.figure.dataset.land);
    if (!answer.ok) return; // the points are shown without it
    this.land = readLand(await answer.json());
    this.draw();
  }

  listen() {
    this.place.addEventListener("keydown", (event) => {
      const done = { ArrowLeft: "west", ArrowRight: "east", ArrowUp: "north", ArrowDown: "south", "+": "closer", "=": "closer", "-": "farther", 0: "fit" }[event.key];
      if (!done || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      this.act(done);
    });
    this.place.addEventListener(
      "wheel",
      (event) => {
        if (!this.place.contains(document.activeElement) && !event.ctrlKey) return; // otherwise the page scrolls
        event.preventDefault();
        const box = this.canvas.getBoundingClientRect();
        this.view.zoom(1.0015 ** -event.deltaY, event.clientX - box.left, event.clientY - box.top);
        this.draw();
      },
      { passive: false },
    );
    let held = null;
    this.canvas.addEventListener("pointerdown", (event) => {
      held = { x: event.clientX, y: event.clientY, moved: 0 };
      this.canvas.setPointerCapture(event.pointerId);
      this.place.focus({ preventScroll: true });
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (!held) return this.tell(this.near(event));
      const [right, down] = [event.clientX - held.x, event.clientY - held.y];
      held = { x: event.clientX, y: event.clientY, moved: held.moved + Math.hypot(right, down) };
      this.view.pan(-right, -down);
      this.draw();
    });
    this.canvas.addEventListener("pointerup", (event) => {
      const found = held && held.moved < 4 ? this.near(event) : [];
      held = null;
      if (found.length === 1) location.assign(`${this.figure.dataset.meals}/${encodeURIComponent(found[0].participant)}/${found[0].meal}`);
      else this.tell(found);
    });
    this.canvas.addEventListener("pointercancel", () => (held = null));
  }

  act(done) {
    const view = this.view;
    const acts = {
      west: () => view.pan(-PAN_PX, 0),
      east: () => view.pan(PAN_PX, 0),
      north: () => view.pan(0, -PAN_PX),
      south: () => view.pan(0, PAN_PX),
      closer: () => view.zoom(1.6),
      farther: () => view.zoom(1 / 1.6),
      fit: () => view.fit(),
    };
    acts[done]();
    this.draw();
    const middle = view.placeOf(view.width / 2, view.height / 2);
    const step = view.grid().step;
    const seen = this.points.filter((point) => this.isSeen(view.pixelOfPoint(point))).length;
    this.told.textContent = `${seen} of ${this.points.length} places seen, around ${degrees(middle.latitude, step, "NS")} ${degrees(around(middle.longitude), step, "EW")}`;
  }

  isSeen([x, y]) {
    return x >= 0 && y >= 0 && x <= this.view.width && y <= this.view.height;
  }

  near(event) {
    const box = this.canvas.getBoundingClientRect();
    const [x, y] = [event.clientX - box.left, event.clientY - box.top];
    return this.points.filter((point) => {
      const [px, py] = this.view.pixelOfPoint(point);
      return Math.hypot(px - x, py - y) <= REACH_PX;
    });
  }

  tell(found) {
    this.canvas.classList.toggle("on-point", found.length > 0);
    if (!found.length) return void (this.told.textContent = "");
    const people = [...new Set(found.map((point) => point.participant))];
    const [point] = found;
    const where = `${degrees(point.latitude, 0.001, "NS")} ${degrees(point.longitude, 0.001, "EW")}`;
    const who = people.length > 3 ? `${people.length} participants` : people.join(", ");
    this.told.textContent = found.length === 1 ? `${where}: ${who}, ${point.day}` : `${where}: ${found.length} meals of ${who}`;
  }

  resize() {
    const width = Math.max(this.place.clientWidth, 200);
    const height = Math.round(Math.min(Math.max(width * 0.5, 260), 520));
    this.canvas.width = Math.round(width * devicePixelRatio);
    this.canvas.height = Math.round(height * devicePixelRatio);
    this.view.resize(width, height);
    this.draw();
  }

  draw() {
    const pen = this.canvas.getContext("2d");
    const { width, height } = this.view;
    pen.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    pen.fillStyle = token("sunk");
    pen.fillRect(0, 0, width, height);
    this.drawLand(pen);
    this.drawGrid(pen);
    this.drawPoints(pen);
    this.drawScale(pen);
  }

  drawLand(pen) {
    pen.beginPath();
    for (const ring of this.land) {
      const start = eastOf(this.view.start - 180, ring[0]) - ring[0]; // all points of a ring are on the same turn
      for (const turn of TURN) this.trace(pen, ring, start + turn);
    }
    pen.fillStyle = token("surface");
    pen.fill("evenodd");
    pen.strokeStyle = token("soft");
    pen.lineWidth = 1;
    pen.stroke();
  }

  trace(pen, ring, turn) {
    let [low, high] = [Infinity, -Infinity];
    for (let n = 0; n < ring.length; n += 2) {
      const [x] = this.view.pixelOf(ring[n] + turn, 0);
      low = Math.min(low, x);
      high = Math.max(high, x);
    }
    if (high < 0 || low > this.view.width) return;
    for (let n = 0; n < ring.length; n += 2) {
      const [x, y] = this.view.pixelOf(ring[n] + turn, ring[n + 1]);
      if (n) pen.lineTo(x, y);
      else pen.moveTo(x, y);
    }
    pen.closePath();
  }

  drawGrid(pen) {
    const { step, longitudes, latitudes } = this.view.grid();
    pen.strokeStyle = token("line");
    pen.lineWidth = 1;
    pen.fillStyle = token("soft");
    pen.font = "11px system-ui, sans-serif";
    pen.beginPath();
    for (const longitude of longitudes) {
      const [x] = this.view.pixelOf(longitude, 0);
      pen.moveTo(Math.round(x) + 0.5, 0);
      pen.lineTo(Math.round(x) + 0.5, this.view.height);
      pen.fillText(degrees(around(longitude), step, "EW"), x + 4, 12);
    }
    for (const latitude of latitudes) {
      const [, y] = this.view.pixelOf(0, latitude);
      pen.moveTo(0, Math.round(y) + 0.5);
      pen.lineTo(this.view.width, Math.round(y) + 0.5);
      if (y > 28) pen.fillText(degrees(latitude, step, "NS"), 4, y - 4);
    }
    pen.stroke();
  }

  drawPoints(pen) {
    const colour = token("series-2");
    pen.lineWidth = 1.5;
    pen.strokeStyle = token("surface");
    for (const point of this.points) {
      const [x, y] = this.view.pixelOfPoint(point);
      pen.beginPath();
      pen.arc(x, y, POINT_PX, 0, 2 * Math.PI);
      pen.globalAlpha = 0.75;
      pen.fillStyle = colour;
      pen.fill();
      pen.globalAlpha = 1;
      pen.stroke();
    }
  }

  drawScale(pen) {
    const { km, pixels } = this.view.scaleBar();
    const [x, y] = [12, this.view.height - 14];
    const words = km >= 1 ? `${km} km` : `${Math.round(km * 1000)} m`;
    pen.font = "12px system-ui, sans-serif";
    pen.globalAlpha = 0.85;
    pen.fillStyle = token("surface");
    pen.fillRect(x - 6, y - 18, Math.max(pixels, pen.measureText(words).width) + 12, 26);
    pen.globalAlpha = 1;
    pen.strokeStyle = token("ink");
    pen.lineWidth = 2;
    pen.beginPath();
    pen.moveTo(x, y - 4);
    pen.lineTo(x, y);
    pen.lineTo(x + pixels, y);
    pen.lineTo(x + pixels, y - 4);
    pen.stroke();
    pen.fillStyle = token("ink");
    pen.fillText(words, x + 2, y - 6);
  }
}

const maps = [...document.querySelectorAll("figure[data-map]")].map((figure) => new PointMap(figure));
for (const map of maps) map.loadLand();
const redraw = () => maps.forEach((map) => map.draw());
document.addEventListener("tada:theme", redraw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
