// Charts of a whole run, of several runs and of a fleet.
// ---- charts of the whole run ----

function wholeChart(id, label, className, draw) {
  const box = element("div", { class: `chart ${className}`, role: "img", "aria-label": label });
  const legend = element("div", { class: "legend", role: "group", "aria-label": "Methods shown" });
  byId(id).replaceChildren(legend, box);
  if (methods.length) startLegend(legend, false);
  addChart(box, () => draw(box));
}

function drawErrors(box) {
  const shown = shownMethods().filter(({ name }) => content.errors[name]);
  const curves = shown.map(({ name }) => content.errors[name]);
  const far_m = Math.max(10, ...Object.values(content.errors).flatMap(({ points, line }) => [...points[0], ...line[0]]));
  const sizes = curves.flatMap(({ points, line }) => (points[1].length ? [quantile(points[1].map(Math.abs), 0.98)] : line[1].map(Math.abs)));
  const limit = Math.min(100, Math.max(5, 1.2 * Math.max(0, ...sizes)));
  const { plot, toX, toY, inner } = axes(box, {
    x: { low: 0, high: 1.03 * far_m, label: "true distance, m" },
    y: { low: content.signed ? -limit : 0, high: limit, label: content.signed ? "error, % (lines: median per 10 m)" : "mean error, %" },
  });
  plot.append(shape("line", { class: "axis", x1: 0, x2: inner.width, y1: toY(0), y2: toY(0) }));
  shown.forEach(({ colour }, i) => plot.append(dots(colour, 3.6, dotPath(curves[i].points[0].map(toX), curves[i].points[1].map(toY)), 0.45)));
  shown.forEach((method, i) => drawLine(plot, method, curves[i].line[0].map(toX), curves[i].line[1].map(toY)));
}

function drawLine(plot, method, xs, ys) {
  plot.append(shape("path", { d: linePath(xs, ys), ...strokeOf(method) }), dots(method.colour, 5.5, dotPath(xs, ys)));
}

function drawSigma(box) {
  const { plot, toX, toY } = axes(box, { x: { low: 0, high: 100, label: "expected errors within k sigma, %" }, y: { low: 0, high: 100, label: "observed errors within k sigma, %" } });
  plot.append(shape("line", { class: "axis", x1: toX(0), y1: toY(0), x2: toX(100), y2: toY(100), "stroke-dasharray": "6 4" }));
  for (const method of shownMethods()) {
    const curve = content.calibration[method.name];
    if (curve) drawLine(plot, method, [0, ...curve.line[0], 100].map(toX), [0, ...curve.line[1], 100].map(toY));
  }
}

// ---- several runs ----

function startComparison() {
  const box = element("div", { class: "chart wide-chart", role: "img", "aria-label": "Mean relative error against true distance, by run" });
  const legend = element("div", { class: "legend" });
  for (const line of content.lines) {
    const style = { stroke: line.colour, "stroke-width": 2.2 };
    legend.append(element("span", {}, swatch(style), ` ${line.name}`));
  }
  byId("run-chart").replaceChildren(legend, box);
  addChart(box, () => {
    const far_m = Math.max(10, ...content.lines.flatMap(({ x }) => x)), most = Math.max(1, ...content.lines.flatMap(({ y }) => y));
    const { plot, toX, toY } = axes(box, {
      x: { low: 0, high: 1.05 * far_m, label: "true distance, m" }, y: { low: 0, high: 1.1 * most, label: "mean error of fused, %" },
    });
    for (const { colour, x, y } of content.lines) drawLine(plot, { name: "fused", colour }, x.map(toX), y.map(toY));
  });
}

// ---- a fleet ----

function startChart({ id, x, y, lines }) {
  const box = element("div", { class: "chart wide-chart", role: "img", "aria-label": `${y}, ${x}` });
  const legend = element("div", { class: "legend" });
  for (const { name, colour } of lines) legend.append(element("span", {}, swatch({ stroke: colour, "stroke-width": 2.2 }), ` ${name}`));
  byId(id).replaceChildren(legend, box);
  const last = Math.max(...lines.flatMap((line) => line.x)), values = lines.flatMap((line) => line.y);
  const low = Math.min(0, ...values), high = Math.max(0, ...values), space = 0.1 * Math.max(0.2, high - low);
  addChart(box, () => {
    const { plot, toX, toY, inner } = axes(box, { x: { low: -0.02 * (last || 1), high: 1.02 * (last || 1), label: x }, y: { low: low - space, high: high + space, label: "" } });
    plot.append(shape("line", { class: "axis", x1: 0, x2: inner.width, y1: toY(0), y2: toY(0) }));
    for (const line of lines) drawLine(plot, { name: "", colour: line.colour }, line.x.map(toX), line.y.map(toY));
  });
}
