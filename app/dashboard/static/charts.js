// Charts: each <figure data-chart> has its numbers in a JSON script. uPlot (vendor/uplot, loaded before) draws it in the
// colours of the page's tokens; mouse and keys show single values. A table below has the same numbers.
//
// {kind: "days", labels: [local days]} or {kind: "bins", edges: [n + 1 amounts], x_unit}; caption; unit: of the values, ""
// if their label has it; whole: they are counts; stacked; low: of small height;
// series: [{label, draw: "bars" | "line" | "dashed", colour: a token's name, fill: "solid" | "hatched" | "hollow",
//           values: [number or null], counts: null or [over how many]}];
// marks: [{label, at: an amount, colour, dash: [px]}]: lines across the bins

const HEIGHT_PX = 200;
const LOW_HEIGHT_PX = 120;
const MONTHS = ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"];
const DURATIONS = [1, 2, 5, 10, 30, 60, 120, 300, 600, 1800, 3600, 7200, 14400, 21600, 43200, 86400, 172800, 432000, 864000, 2592000];

const mounted = new Map(); // figure -> { plot, observer }

function token(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

// --- numbers as the page's filters show them

export function amount(value, unit = "") {
  if (value === null || value === undefined) return "not known";
  if (unit === "s") return duration(value);
  const size = Math.abs(value);
  const digits = Number.isInteger(value) || size >= 100 ? 0 : size >= 10 ? 1 : 2;
  const [whole, rest] = size.toFixed(digits).split(".");
  const grouped = whole.replace(/\B(?=(\d{3})+$)/g, "\u202f");
  return `${value < 0 ? "−" : ""}${grouped}${rest ? `.${rest}` : ""}${unit ? ` ${unit}` : ""}`;
}

export function duration(seconds) {
  const size = Math.abs(seconds);
  for (const [length, unit] of [[86400, "d"], [3600, "h"], [60, "min"]]) {
    if (size >= 2 * length) return `${(seconds / length).toFixed(size % length ? 1 : 0).replace(/\.0$/, "")} ${unit}`;
  }
  return `${Math.round(seconds)} s`;
}

export function shortDay(day) {
  const [, month, date] = day.split("-");
  return `${Number(date)} ${MONTHS[Number(month) - 1]}`;
}

// the text for position n of the x axis
export function reading(chart, n) {
  const place =
    chart.kind === "days" ? chart.labels[n] : `${amount(chart.edges[n])} to ${amount(chart.edges[n + 1], chart.x_unit)}`;
  const told = chart.series.map((series) => {
    const count = series.counts ? ` (n = ${amount(series.counts[n])})` : "";
    return `${series.label.toLowerCase()} ${amount(series.values[n], chart.unit)}${series.values[n] === null ? "" : count}`;
  });
  return `${place}: ${told.join(", ")}`;
}

// the tops of stacked bars: each series on top of the earlier ones
export function stackedTops(series) {
  const tops = [];
  for (const [n, each] of series.entries()) {
    tops.push(each.values.map((value, at) => (value ?? 0) + (n ? tops[n - 1][at] : 0)));
  }
  return tops;
}

// --- one chart

function xAxis(chart, ink, grid) {
  const axis = { stroke: ink, grid: { show: false }, ticks: { stroke: grid, width: 1, size: 4 }, font: "12px system-ui, sans-serif", size: 28 };
  if (chart.kind === "bins") {
    return { ...axis, space: 60, values: (plot, splits) => splits.map((at) => amount(at)) };
  }
  const last = chart.labels.length - 1;
  return {
    ...axis,
    splits: (plot) => {
      const width = plot.bbox.width / devicePixelRatio || 300;
      const step = Math.max(1, Math.ceil((last + 1) / Math.max(2, Math.floor(width / 64))));
      return Array.from({ length: Math.floor(last / step) + 1 }, (_, n) => n * step);
    },
    values: (plot, splits) => splits.map((n) => (chart.labels[n] ? shortDay(chart.labels[n]) : "")),
  };
}

function yAxis(chart, ink, grid) {
  const axis = {
    stroke: ink,
    grid: { stroke: grid, width: 1 },
    ticks: { show: false },
    font: "12px system-ui, sans-serif",
    size: 52,
    space: 32,
    values: (plot, splits) => splits.map((at) => amount(at, ["s", "%"].includes(chart.unit) ? chart.unit : "")),
  };
  if (chart.unit === "s") axis.incrs = DURATIONS;
  else if (chart.whole) axis.incrs = [1, 2, 5, 10, 20, 25, 50, 100, 200, 250, 500, 1000, 2000, 5000, 10000, 20000, 50000, 100000, 1000000];
  return axis;
}

// bars start at zero; with room above them
function yRange(plot, low, high) {
  return [Math.min(0, low ?? 0) * 1.05, Math.max(high ?? 0, 0) > 0 ? high * 1.08 : low < 0 ? 0 : 1];
}

function hatching(plot, colour, ground) {
  const tile = document.createElement("canvas");
  const size = Math.round(6 * devicePixelRatio);
  tile.width = tile.height = size;
  const pen = tile.getContext("2d");
  pen.fillStyle = ground;
  pen.fillRect(0, 0, size, size);
  pen.strokeStyle = colour;
  pen.lineWidth = 2 * devicePixelRatio;
  pen.beginPath();
  for (const shift of [-size, 0, size]) {
    pen.moveTo(shift - 1, size + 1);
    pen.lineTo(shift + size + 1, -1);
  }
  pen.stroke();
  return plot.ctx.createPattern(tile, "repeat");
}

function drawnSeries(chart, series, ground) {
  const colour = token(series.colour);
  const common = { label: series.label, stroke: colour, points: { show: false } };
  if (series.draw === "bars") {
    const size = chart.kind === "bins" ? [1, Infinity] : [0.8, 44];
    const fills = { solid: () => colour, hollow: () => ground, hatched: (plot) => hatching(plot, colour, ground) };
    return { ...common, width: 1, fill: fills[series.fill ?? "solid"], paths: uPlot.paths.bars({ size, gap: chart.kind === "bins" ? 1 : 0 }) };
  }
  const isDashed = series.draw === "dashed";
  return {
    ...common,
    width: 2,
    dash: isDashed ? [5, 4] : undefined,
    spanGaps: false,
    points: { show: true, size: 6, width: 2, stroke: colour, fill: isDashed ? ground : colour },
  };
}

function drawMarks(plot, chart) {
  const pen = plot.ctx;
  const { top, height } = plot.bbox;
  pen.save();
  pen.lineWidth = 2 * devicePixelRatio;
  for (const mark of chart.marks) {
    const x = Math.round(plot.valToPos(mark.at, "x", true));
    pen.strokeStyle = token(mark.colour);
    pen.setLineDash((mark.dash ?? []).map((part) => part * devicePixelRatio));
    pen.beginPath();
    pen.moveTo(x, top);
    pen.lineTo(x, top + height);
    pen.stroke();
  }
  pen.restore();
}

function build(figure, place, told, chart) {
  const [ink, grid, ground] = ["soft", "line", "surface"].map(token);
  const places = chart.kind === "days" ? chart.labels.length : chart.edges.length - 1;
  const x = Array.from({ length: places }, (_, n) => (chart.kind === "days" ? n : (chart.edges[n] + chart.edges[n + 1]) / 2));
  const ends = chart.kind === "days" ? [-0.6, places - 0.4] : [chart.edges[0], chart.edges[places]];
  const tops = chart.stacked ? stackedTops(chart.series) : chart.series.map((series) => series.values);
  let drawn = chart.series.map((series, n) => [drawnSeries(chart, series, ground), tops[n]]);
  if (chart.stacked) drawn = drawn.reverse(); // the highest first: later ones cover its lower part
  const plot = new uPlot(
    {
      width: Math.max(place.clientWidth, 200),
      height: chart.low ? LOW_HEIGHT_PX : HEIGHT_PX,
      padding: [8, 8, 0, 0],
      legend: { show: false },
      cursor: { y: false, drag: { x: false, y: false }, points: { show: !chart.stacked && chart.kind === "days" } },
      scales: { x: { time: false, range: () => ends }, y: { range: yRange } },
      axes: [xAxis(chart, ink, grid), yAxis(chart, ink, grid)],
      series: [{}, ...drawn.map(([series]) => series)],
      hooks: {
        draw: [(made) => drawMarks(made, chart)],
        setCursor: [(made) => {
          const n = made.cursor.idx;
          told.textContent = n === null || n === undefined ? "" : reading(chart, n);
        }],
      },
    },
    [x, ...drawn.map(([, values]) => values)],
    place,
  );
  return plot;
}

// arrows, Home, End, Page Up and Page Down move the cursor
function lead(event, plot, told) {
  const last = plot.data[0].length - 1;
  const at = plot.cursor.idx ?? null;
  const far = Math.max(1, Math.round(last / 10));
  const steps = { ArrowLeft: -1, ArrowRight: 1, PageUp: -far, PageDown: far };
  let next;
  if (event.key in steps) next = at === null ? (steps[event.key] > 0 ? 0 : last) : at + steps[event.key];
  else if (event.key === "Home") next = 0;
  else if (event.key === "End") next = last;
  else if (event.key === "Escape") next = null;
  else return;
  event.preventDefault();
  told.setAttribute("aria-live", "polite");
  if (next === null) return plot.setCursor({ left: -10, top: -10 });
  next = Math.min(Math.max(next, 0), last);
  plot.setCursor({ left: plot.valToPos(plot.data[0][next], "x"), top: plot.over.clientHeight / 2 });
}

function mount(figure) {
  const place = figure.querySelector(".plot");
  const told = figure.querySelector("output");
  const chart = JSON.parse(figure.querySelector('script[type="application/json"]').textContent);
  const known = mounted.get(figure);
  const at = known?.plot.cursor.idx;
  known?.plot.destroy();
  const plot = build(figure, place, told, chart);
  if (at !== null && at !== undefined) plot.setCursor({ left: plot.valToPos(plot.data[0][at], "x"), top: 0 });
  if (known) return void (known.plot = plot);
  const state = { plot };
  mounted.set(figure, state);
  figure.classList.add("is-drawn");
  place.tabIndex = 0;
  place.setAttribute("role", "application");
  place.setAttribute("aria-roledescription", "chart");
  place.setAttribute("aria-label", `${chart.caption}. Arrow keys read it out; the table beneath has all numbers.`);
  place.addEventListener("keydown", (event) => lead(event, state.plot, told));
  place.addEventListener("pointerenter", () => told.setAttribute("aria-live", "off")); // a pointer's user sees it
  place.addEventListener("blur", () => state.plot.setCursor({ left: -10, top: -10 }));
  new ResizeObserver(() => {
    const width = Math.max(place.clientWidth, 200);
    if (width !== state.plot.width) state.plot.setSize({ width, height: state.plot.height });
  }).observe(place);
}

function mountAll() {
  for (const [figure, { plot }] of mounted) {
    if (figure.isConnected) continue;
    plot.destroy();
    mounted.delete(figure);
  }
  for (const figure of document.querySelectorAll("figure[data-chart]")) if (!mounted.has(figure)) mount(figure);
}

function redraw() {
  for (const figure of mounted.keys()) mount(figure);
}

mountAll();
document.addEventListener("htmx:after:swap", mountAll);
document.addEventListener("tada:theme", redraw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
