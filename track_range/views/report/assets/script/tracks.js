// Distance over time: a chart per track, the list of tracks, and the legend of the methods.
// ---- methods and their legend ----

const methods = content.methods || [];
const shownMethods = () => methods.filter((method) => method.shown);

function swatch(attributes) {
  const svg = shape("svg", { viewBox: "0 0 26 10", "aria-hidden": "true" });
  svg.append(shape("line", { x1: 1, x2: 25, y1: 5, y2: 5, ...attributes }));
  return svg;
}

function startLegend(legend, hasTruth) {
  const buttons = methods.map((method) => {
    const button = element("button", { type: "button", "data-method": method.name }, swatch(strokeOf(method)), method.label);
    button.addEventListener("click", () => {
      method.shown = !method.shown;
      for (const twin of document.querySelectorAll(".legend button"))
        if (twin.dataset.method === method.name) twin.setAttribute("aria-pressed", method.shown);
      redrawAll();
    });
    button.setAttribute("aria-pressed", method.shown);
    return button;
  });
  const truth = element("span", {}, "truth");
  legend.append(...buttons);
  if (hasTruth) legend.append(truth);
  if (hasTruth) truth.prepend(swatch({ class: "truth", stroke: "currentColor", "stroke-width": 2.5, "stroke-dasharray": "0.1 5", "stroke-linecap": "round" }), " ");
}

// ---- tracks ----

const unpackedTracks = new Map();

function unpack(text, ticksPerUnit) {
  if (text === undefined) return null;
  const cells = text.split(",");
  const values = new Float64Array(cells.length);
  let last = 0;
  cells.forEach((cell, i) => {
    if (cell === "") values[i] = NaN;
    else values[i] = (last += Number(cell)) / ticksPerUnit;
  });
  return values;
}

function series(track) {
  if (!unpackedTracks.has(track)) {
    const inMetres = (texts) => Object.fromEntries(Object.entries(texts).map(([name, text]) => [name, unpack(text, 100)]));
    const t = unpack(track.t, 1000);
    const steps = Array.from(t.subarray(1), (value, i) => value - t[i]);
    const step_s = steps.length ? quantile(steps, 0.5) : content.timeline.frame_s, longest_s = 3.5 * step_s;
    unpackedTracks.set(track, {
      t, m: inMetres(track.m), s: inMetres(track.s), truth: unpack(track.truth, 100), closing: unpack(track.closing, 10),
      x: unpack(track.x, 100), w: unpack(track.w, 100), ttc: unpack(track.ttc, 100), pass: unpack(track.pass, 100),
      box: [track.x1, track.y1, track.x2, track.y2].map((side) => unpack(side, 1)),
      o: unpack(track.o, 100), pass_s: unpack(track.pass_s, 100), p: unpack(track.p, 100), p_on: unpack(track.p_on, 100), warning: unpack(track.warning, 1),
      step_s, isBreak: (i) => i > 0 && t[i] - t[i - 1] > longest_s,
    });
  }
  return unpackedTracks.get(track);
}

// Last row at or before a time; -1 = the track starts later.
function rowBefore(track, time_s) {
  const { t } = series(track);
  if (time_s < t[0] - 0.001) return -1;
  let low = 0, high = t.length;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (t[middle] <= time_s + 0.001) low = middle;
    else high = middle;
  }
  return low;
}

// Row of the frame that is shown at a time; -1 = the track has no box in it.
function rowAt(track, time_s) {
  const shown_s = Math.min(time_s, span.to_s - 0.5 * span.frame_s); // at its end the video shows its last frame
  const row = rowBefore(track, shown_s), { t, step_s } = series(track);
  return row >= 0 && shown_s <= t[row] + 0.97 * step_s ? row : -1;
}

const titleOf = (track) => `${track.name} ${track.id}`;

function detailOf(track) {
  const words = [`${track.n} frame${track.n === 1 ? "" : "s"}, ${track.from_s.toFixed(1)} to ${track.to_s.toFixed(1)} s`];
  if (track.near_m !== null) words.push(`minimum distance ${track.near_m.toFixed(1)} m`);
  if (track.ttc_s !== null) words.push(`shortest time to collision with the front of the ego vehicle ${track.ttc_s.toFixed(1)} s`);
  if (track.error_pct !== null) words.push(`median error of the fused distance ${track.error_pct.toFixed(1)} %`);
  return words.join(" \u00b7 ");
}

function wordsAt(track, row) {
  const { t, m, s, truth, closing, p } = series(track);
  const words = [[`${t[row].toFixed(2)} s`, ""]];
  for (const { name } of shownMethods()) {
    const value = m[name] ? m[name][row] : NaN;
    const sigma = s[name] ? s[name][row] : NaN;
    if (Number.isFinite(value)) words.push([name, `${value.toFixed(1)}${Number.isFinite(sigma) ? ` \u00b1 ${sigma.toFixed(1)}` : ""} m`]);
  }
  if (truth && Number.isFinite(truth[row])) words.push(["truth", `${truth[row].toFixed(1)} m`]);
  if (closing && Number.isFinite(closing[row])) words.push(["closing", `${closing[row].toFixed(1)} m/s`]);
  if (p && Number.isFinite(p[row]) && p[row] >= 0.01) words.push(["contact", `${(100 * p[row]).toFixed(0)} %`]);
  if (track.observed && track.observed[row] === "0") words.push(["predicted box", ""]);
  return words;
}

function rangeOf(track) {
  const { m, s, truth } = series(track);
  const known = [];
  for (const { name } of shownMethods()) if (m[name]) known.push(...m[name].filter(Number.isFinite));
  if (m.fused && s.fused) // the band of sigma, within the limits below
    for (const sign of [-1, 1]) known.push(...Array.from(m.fused, (value, i) => value + sign * s.fused[i]).filter(Number.isFinite));
  const reliable = [m.fused, truth].filter(Boolean).flatMap((values) => [...values.filter(Number.isFinite)]);
  if (!known.length && !reliable.length) return [0, 10];
  const all = known.length ? known : reliable;
  let low = quantile(all, 0), high = quantile(all, 1);
  if (reliable.length) { // outliers must not flatten the other values
    const [from, to] = [quantile(reliable, 0), quantile(reliable, 1)];
    const span = Math.max(to - from, 0.3 * to);
    [low, high] = [Math.min(from, Math.max(low, from - span)), Math.max(to, Math.min(high, to + span))];
  }
  const room = Math.max(0.08 * (high - low), 0.25);
  return [Math.max(0, low - room), high + room];
}

class TrackChart {
  constructor(track) {
    this.track = track;
    this.box = element("div", { class: "chart", role: "slider", tabindex: "0", "aria-label": `Distance over time of ${titleOf(track)}` });
    this.readout = element("p", { class: "readout" });
    const caption = element("figcaption", {}, titleOf(track), element("span", { class: "faint" }, detailOf(track)));
    this.figure = element("figure", { class: "track-chart", "data-track": track.id }, caption, this.box, this.readout);
    const { t } = series(track);
    this.box.setAttribute("aria-valuemin", t[0]);
    this.box.setAttribute("aria-valuemax", t[t.length - 1]);
    this.announce(Math.max(0, rowAt(track, now_s)));
    this.box.addEventListener("pointerdown", (event) => this.onPointer(event, true));
    this.box.addEventListener("pointermove", (event) => this.onPointer(event, event.buttons === 1));
    this.box.addEventListener("pointerleave", () => this.follow());
    this.box.addEventListener("keydown", (event) => this.onKey(event));
    addChart(this.box, () => this.draw());
  }

  draw() {
    const { t, m, s, truth, isBreak } = series(this.track);
    const [low, high] = rangeOf(this.track);
    const [first, last] = [t[0], t[t.length - 1]];
    const room = last > first ? 0 : 0.5;
    this.axes = axes(this.box, { x: { low: first - room, high: last + room, label: "time, s" }, y: { low, high, label: "distance, m" } });
    const { plot, toX, toY, inner } = this.axes;
    const xs = Array.from(t, toX);
    for (const method of shownMethods()) {
      const [values, sigma] = [m[method.name], s[method.name]];
      if (!values || !sigma || isFiltered(method.name)) continue;
      const path = bandPath(xs, Array.from(values, (value, i) => toY(value - sigma[i])), Array.from(values, (value, i) => toY(value + sigma[i])), isBreak);
      plot.append(shape("path", { d: path, fill: method.colour, opacity: method.name === "fused" ? 0.28 : 0.13 }));
    }
    for (const method of shownMethods()) {
      if (!m[method.name]) continue;
      const ys = Array.from(m[method.name], toY);
      plot.append(shape("path", { d: linePath(xs, ys, isBreak), ...strokeOf(method) }));
      if (t.length <= 60 && (!isFiltered(method.name) || t.length === 1)) plot.append(dots(method.colour, 4.5, dotPath(xs, ys)));
    }
    if (truth) plot.append(shape("path", { class: "truth", d: dotPath(xs, Array.from(truth, toY)), "stroke-width": t.length > 200 ? 2 : 3.2, "stroke-linecap": "round" }));
    this.drawPredicted(plot, xs, toY);
    this.line = shape("line", { class: "cursor", y1: 0, y2: inner.height, visibility: "hidden" });
    plot.append(this.line);
    this.follow();
  }

  drawPredicted(plot, xs, toY) {
    const { m } = series(this.track);
    const values = m.fused_kf || m.fused;
    [...(this.track.observed || "")].forEach((flag, i) => {
      if (flag === "0" && values && Number.isFinite(values[i]))
        plot.append(shape("circle", { cx: xs[i], cy: toY(values[i]), r: 4, fill: "none", class: "truth" }));
    });
  }

  follow() {
    this.point(rowAt(this.track, now_s));
  }

  // Move the cursor to a row and show the values of that row.
  point(row) {
    this.row = row;
    if (this.line) {
      this.line.setAttribute("visibility", row < 0 ? "hidden" : "visible");
      const at = row < 0 ? 0 : this.axes.toX(series(this.track).t[row]);
      this.line.setAttribute("x1", at);
      this.line.setAttribute("x2", at);
    }
    if (row < 0) this.readout.textContent = "no box at this time";
    else this.readout.replaceChildren(...wordsAt(this.track, row).flatMap(([name, value]) => [element("b", {}, name), ` ${value} `]));
  }

  announce(row) {
    this.box.setAttribute("aria-valuenow", series(this.track).t[row]);
    this.box.setAttribute("aria-valuetext", wordsAt(this.track, row).map((pair) => pair.join(" ").trim()).join(", "));
  }

  onPointer(event, isHeld) {
    if (!this.axes) return;
    const { t } = series(this.track);
    const share = (event.clientX - this.box.getBoundingClientRect().left - MARGIN.left) / this.axes.inner.width;
    const room = t.length > 1 ? 0 : 0.5;
    const time_s = t[0] - room + share * (t[t.length - 1] - t[0] + 2 * room);
    const row = nearest(t, time_s);
    if (isHeld) {
      seek(t[row]);
      this.announce(row);
    }
    this.point(row);
  }

  onKey(event) {
    const { t } = series(this.track);
    const current = Math.max(0, rowBefore(this.track, now_s));
    const steps = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageDown: -10, PageUp: 10, Home: -t.length, End: t.length };
    if (event.key in steps) {
      const row = Math.min(t.length - 1, Math.max(0, current + steps[event.key]));
      seek(t[row]);
      this.point(row);
      this.announce(row);
    } else if (event.key === " " || event.key === "Enter") togglePlay();
    else return;
    event.preventDefault();
  }
}

function nearest(times, time_s) {
  let best = 0;
  for (let i = 1; i < times.length; i++) if (Math.abs(times[i] - time_s) < Math.abs(times[best] - time_s)) best = i;
  return best;
}

// ---- the list of tracks ----

const tracks = content.tracks || [];
const charts = new Map(); // track -> TrackChart, for those in the list
let selected = [], n_listed = PAGE;

function startList() {
  const [order, find] = [byId("order"), byId("find")];
  byId("controls").hidden = false;
  const update = () => {
    n_listed = PAGE;
    selected = ordered(tracks.filter((track) => matches(track, find.value)), order.value);
    showList();
  };
  order.addEventListener("change", update);
  find.addEventListener("input", update);
  byId("more").addEventListener("click", () => {
    const first = n_listed;
    n_listed += PAGE;
    showList();
    charts.get(selected[first])?.box.focus();
  });
  update();
}

function matches(track, text) {
  const words = text.toLowerCase().split(/[\s,]+/).filter(Boolean);
  return words.every((word) => (/^\d+$/.test(word) ? String(track.id) === word : track.name.toLowerCase().includes(word)));
}

function ordered(list, key) {
  const sign = key === "n" || key === "error_pct" ? -1 : 1;
  const value = (track) => (track[key] === null ? Infinity : sign * track[key]);
  return [...list].sort((a, b) => (value(a) === value(b) ? 0 : value(a) - value(b)));
}

function showList(first = null) {
  const listed = selected.slice(0, n_listed);
  if (first && !listed.includes(first)) listed.unshift(first);
  for (const [track, chart] of charts) {
    if (listed.includes(track)) continue;
    dropChart(chart.box);
    charts.delete(track);
  }
  for (const track of listed) if (!charts.has(track)) charts.set(track, new TrackChart(track));
  byId("track-list").replaceChildren(...listed.map((track) => charts.get(track).figure));
  const n = selected.length, n_users = selected.filter((track) => track.is_user).length;
  const others = n_users < n ? `, traffic lights and signs: ${n - n_users}` : "";
  byId("count").textContent = `${Math.min(n_listed, n)} of ${n} shown (road users: ${n_users}${others})`;
  byId("more").hidden = n_listed >= selected.length;
}
