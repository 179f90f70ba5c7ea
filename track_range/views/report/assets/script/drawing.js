// Axes, paths and marks of the charts, which are drawn when they come into view.
// ---- drawing ----

function ticks(low, high, about) {
  const rough = (high - low) / about;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * ([1, 2, 5].find((factor) => factor * power >= rough) || 10);
  const positions = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) positions.push(i * step);
  return { at: positions, decimals: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}

// Axes of a box: `plot` is clipped to them; `toX` and `toY` convert values to pixels of `plot`.
function axes(box, { x, y }) {
  const width = box.clientWidth, height = box.clientHeight;
  const inner = { width: width - MARGIN.left - MARGIN.right, height: height - MARGIN.top - MARGIN.bottom };
  const svg = shape("svg", { "aria-hidden": "true", viewBox: `0 0 ${width} ${height}` });
  const plot = shape("svg", { x: MARGIN.left, y: MARGIN.top, ...inner });
  const toX = (value) => ((value - x.low) / (x.high - x.low)) * inner.width;
  const toY = (value) => (1 - (value - y.low) / (y.high - y.low)) * inner.height;
  const across = ticks(x.low, x.high, Math.max(2, inner.width / 90)), up = ticks(y.low, y.high, Math.max(2, inner.height / 45));
  for (const value of across.at) {
    const at = MARGIN.left + toX(value);
    svg.append(
      shape("line", { class: "grid", x1: at, x2: at, y1: MARGIN.top, y2: height - MARGIN.bottom }),
      shape("text", { x: at, y: height - MARGIN.bottom + 15, "text-anchor": "middle" }, value.toFixed(across.decimals)));
  }
  for (const value of up.at) {
    const at = MARGIN.top + toY(value);
    svg.append(
      shape("line", { class: "grid", x1: MARGIN.left, x2: width - MARGIN.right, y1: at, y2: at }),
      shape("text", { x: MARGIN.left - 6, y: at + 4, "text-anchor": "end" }, value.toFixed(up.decimals)));
  }
  svg.append(
    shape("text", { x: width - MARGIN.right, y: height - 4, "text-anchor": "end" }, x.label),
    plot,
    shape("text", { x: MARGIN.left, y: MARGIN.top - 8 }, y.label));
  box.replaceChildren(svg);
  return { plot, toX, toY, inner };
}

// Path of a line with gaps at missing values, and before each point i for which `isBreak(i)` is true.
function linePath(xs, ys, isBreak = () => false) {
  let path = "", isDown = false;
  for (let i = 0; i < xs.length; i++) {
    if (!Number.isFinite(ys[i])) {
      isDown = false;
      continue;
    }
    path += `${isDown && !isBreak(i) ? "L" : "M"}${xs[i].toFixed(1)} ${ys[i].toFixed(1)}`;
    isDown = true;
  }
  return path;
}

function bandPath(xs, lows, highs, isBreak) {
  let path = "", start = -1;
  const close = (end) => {
    if (start < 0) return;
    const points = [];
    for (let i = start; i < end; i++) points.push(`${xs[i].toFixed(1)} ${highs[i].toFixed(1)}`);
    for (let i = end - 1; i >= start; i--) points.push(`${xs[i].toFixed(1)} ${lows[i].toFixed(1)}`);
    path += `M${points.join("L")}Z`;
    start = -1;
  };
  for (let i = 0; i < xs.length; i++) {
    const isKnown = Number.isFinite(lows[i]) && Number.isFinite(highs[i]);
    if (!isKnown || isBreak(i)) close(i);
    if (isKnown && start < 0) start = i;
  }
  close(xs.length);
  return path;
}

function dotPath(xs, ys) {
  let path = "";
  for (let i = 0; i < xs.length; i++)
    if (Number.isFinite(ys[i])) path += `M${xs[i].toFixed(1)} ${ys[i].toFixed(1)}h.01`;
  return path;
}

const isFiltered = (name) => name.endsWith("_kf");

function strokeOf(method) {
  return {
    fill: "none", stroke: method.colour, "stroke-linejoin": "round", "stroke-width": method.name.startsWith("fused") ? 2.2 : 1.3,
    ...(isFiltered(method.name) ? { "stroke-dasharray": "5 3" } : {}),
  };
}

const dots = (colour, size, path, opacity = 1) =>
  shape("path", { d: path, stroke: colour, "stroke-width": size, "stroke-linecap": "round", fill: "none", opacity });

function quantile(values, share) {
  const sorted = Float64Array.from(values).sort();
  return sorted[Math.min(sorted.length - 1, Math.round(share * (sorted.length - 1)))];
}

// ---- charts drawn when they come into view ----

const waiting = new Map(); // box -> { draw, isSeen, isStale }
const seen = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) {
    const chart = waiting.get(target);
    if (!chart) continue;
    chart.isSeen = isIntersecting;
    redraw(chart);
  }
}, { rootMargin: "300px" });
const resized = new ResizeObserver((entries) => {
  for (const { target } of entries) {
    const chart = waiting.get(target);
    if (chart && chart.width !== target.clientWidth) {
      chart.isStale = true;
      redraw(chart);
    }
  }
});

function addChart(box, draw) {
  waiting.set(box, { box, draw, isSeen: false, isStale: true });
  seen.observe(box);
  resized.observe(box);
}

function dropChart(box) {
  seen.unobserve(box);
  resized.unobserve(box);
  waiting.delete(box);
}

function redraw(chart) {
  if (!chart.isSeen || !chart.isStale || chart.box.clientWidth < 80) return;
  chart.isStale = false;
  chart.width = chart.box.clientWidth;
  chart.draw();
}

function redrawAll() {
  for (const chart of waiting.values()) {
    chart.isStale = true;
    redraw(chart);
  }
}
