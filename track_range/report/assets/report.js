// Script of the report and the comparison page: sortable tables, charts drawn when they come into view, video linked to the charts.
"use strict";
(() => {
  const content = JSON.parse(document.getElementById("run-content").textContent);
  const SVG = "http://www.w3.org/2000/svg";
  const PAGE = 20; // charts added at a time
  const MARGIN = { left: 46, right: 12, top: 22, bottom: 36 };
  const byId = (id) => document.getElementById(id);

  function element(name, attributes = {}, ...children) {
    const node = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    node.append(...children);
    return node;
  }

  function shape(name, attributes = {}, text = "") {
    const node = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    if (text) node.textContent = text;
    return node;
  }

  // ---- theme ----

  function startTheme() {
    const button = byId("theme");
    const themes = ["system", "light", "dark"];
    let chosen = "system";
    try {
      chosen = localStorage.getItem("track-range-theme") || "system";
    } catch { /* without local storage (some browsers, for local files) the choice is lost when the page is closed */ }
    const show = () => {
      if (chosen === "system") delete document.documentElement.dataset.theme;
      else document.documentElement.dataset.theme = chosen;
      button.textContent = `Theme: ${chosen}`;
    };
    button.hidden = false;
    button.addEventListener("click", () => {
      chosen = themes[(themes.indexOf(chosen) + 1) % themes.length];
      try {
        localStorage.setItem("track-range-theme", chosen);
      } catch { /* as above */ }
      show();
    });
    show();
  }

  // ---- tables ----

  function startSorting(table) {
    const headings = [...table.tHead.rows[0].cells];
    headings.forEach((heading, index) => {
      const button = element("button", { type: "button" }, heading.textContent);
      heading.replaceChildren(button);
      heading.setAttribute("aria-sort", "none");
      button.addEventListener("click", () => {
        const isUp = heading.getAttribute("aria-sort") !== "ascending";
        headings.forEach((other) => other.setAttribute("aria-sort", "none"));
        heading.setAttribute("aria-sort", isUp ? "ascending" : "descending");
        sortRows(table.tBodies[0], index, isUp ? 1 : -1);
      });
    });
  }

  function sortRows(body, index, sign) {
    const key = (row) => row.cells[index].textContent.trim();
    const isEmpty = (text) => text === "-" || text === "";
    const compare = (a, b) => {
      if (isEmpty(a) || isEmpty(b)) return isEmpty(a) - isEmpty(b); // values that were not measured stay at the bottom
      const numbers = [parseFloat(a), parseFloat(b)];
      return sign * (numbers.some(Number.isNaN) ? a.localeCompare(b) : numbers[0] - numbers[1]);
    };
    body.append(...[...body.rows].sort((a, b) => compare(key(a), key(b))));
  }

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
      const button = element("button", { type: "button", "data-method": method.name }, swatch(strokeOf(method)), method.name);
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
      const longest_s = steps.length ? 3.5 * quantile(steps, 0.5) : 0;
      unpackedTracks.set(track, {
        t, m: inMetres(track.m), s: inMetres(track.s), truth: unpack(track.truth, 100), closing: unpack(track.closing, 10),
        isBreak: (i) => i > 0 && t[i] - t[i - 1] > longest_s,
      });
    }
    return unpackedTracks.get(track);
  }

  // Last row at or before a time; -1 = the track does not exist at that time.
  function rowAt(track, time_s) {
    const { t } = series(track);
    if (time_s < t[0] - 0.001) return -1;
    let low = 0, high = t.length;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (t[middle] <= time_s + 0.001) low = middle;
      else high = middle;
    }
    const step_s = t.length > 1 ? (t[t.length - 1] - t[0]) / (t.length - 1) : 0.1;
    return time_s > t[t.length - 1] + 1.5 * step_s ? -1 : low;
  }

  const titleOf = (track) => `${track.name} ${track.id}`;

  function detailOf(track) {
    const words = [`${track.n} frame${track.n === 1 ? "" : "s"}, ${track.from_s.toFixed(1)} to ${track.to_s.toFixed(1)} s`];
    if (track.near_m !== null) words.push(`minimum distance ${track.near_m.toFixed(1)} m`);
    if (track.ttc_s !== null) words.push(`minimum time to collision ${track.ttc_s.toFixed(1)} s`);
    if (track.error_pct !== null) words.push(`median error of the fused distance ${track.error_pct.toFixed(1)} %`);
    return words.join(" \u00b7 ");
  }

  function wordsAt(track, row) {
    const { t, m, s, truth, closing } = series(track);
    const words = [[`${t[row].toFixed(2)} s`, ""]];
    for (const { name } of shownMethods()) {
      const value = m[name] ? m[name][row] : NaN;
      const sigma = s[name] ? s[name][row] : NaN;
      if (Number.isFinite(value)) words.push([name, `${value.toFixed(1)}${Number.isFinite(sigma) ? ` \u00b1 ${sigma.toFixed(1)}` : ""} m`]);
    }
    if (truth && Number.isFinite(truth[row])) words.push(["truth", `${truth[row].toFixed(1)} m`]);
    if (closing && Number.isFinite(closing[row])) words.push(["closing", `${closing[row].toFixed(1)} m/s`]);
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
      const current = Math.max(0, rowAt(this.track, now_s));
      const steps = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageDown: -10, PageUp: 10, Home: -t.length, End: t.length };
      if (event.key in steps) {
        const row = Math.min(t.length - 1, Math.max(0, current + steps[event.key]));
        seek(t[row]);
        this.point(row);
        this.announce(row);
      } else if ((event.key === " " || event.key === "Enter") && video) {
        if (video.paused) video.play();
        else video.pause();
      } else return;
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
    byId("count").textContent = `${Math.min(n_listed, selected.length)} of ${selected.length} tracks`;
    byId("more").hidden = n_listed >= selected.length;
  }

  // ---- current time ----

  const video = byId("video");
  const starts_s = content.starts_s || 0;
  let now_s = tracks.length ? Math.min(...tracks.map((track) => track.from_s)) : 0;

  function seek(time_s) {
    now_s = time_s;
    if (video && !video.hidden) video.currentTime = Math.max(0, time_s - starts_s + 0.002); // inside the frame, not on its edge
    showMoment();
  }

  function showMoment() {
    for (const chart of charts.values()) if (waiting.get(chart.box)?.isSeen) chart.follow();
    showPresent();
  }

  const metres = (track, row) => {
    const { m } = series(track);
    const known = [m.fused, m.fused_kf, ...Object.values(m)].find((values) => values && Number.isFinite(values[row]));
    return known ? known[row] : NaN;
  };

  let presentText = "";
  function showPresent() {
    const present = tracks
      .filter((track) => track.from_s <= now_s + 0.001 && now_s <= track.to_s + 0.2)
      .map((track) => [track, rowAt(track, now_s)])
      .filter(([, row]) => row >= 0)
      .map(([track, row]) => [track, metres(track, row)])
      .sort((a, b) => (Number.isFinite(a[1]) ? a[1] : Infinity) - (Number.isFinite(b[1]) ? b[1] : Infinity))
      .slice(0, 24);
    const words = present.map(([track, value]) => titleOf(track) + (Number.isFinite(value) ? `  ${value.toFixed(1)} m` : ""));
    if (words.join() === presentText) return;
    presentText = words.join();
    const bar = byId("now");
    const old = [...bar.children].filter((child) => child.tagName === "BUTTON");
    const buttons = present.map(([track], i) => {
      const button = old[i] || element("button", { type: "button" }); // the same element, so that focus stays
      button.textContent = words[i];
      button.onclick = () => reveal(track);
      return button;
    });
    bar.replaceChildren(element("span", { class: "faint" }, `${now_s.toFixed(2)} s:`), ...(buttons.length ? buttons : ["no road users"]));
  }

  function reveal(track) {
    if (!charts.has(track)) showList(track);
    const { figure, box } = charts.get(track);
    figure.scrollIntoView({ block: "start", behavior: matchMedia("(prefers-reduced-motion: reduce)").matches ? "auto" : "smooth" });
    box.focus({ preventScroll: true });
    figure.classList.add("lit");
    setTimeout(() => figure.classList.remove("lit"), 1500);
  }

  // The video's native controls would cover the top view in the overlay, so they are shown only under the mouse pointer.
  function startPlayer() {
    const [player, play, when] = [byId("player"), byId("play"), byId("when")];
    const update = () => {
      if (!Number.isFinite(video.duration)) return;
      player.hidden = video.hidden;
      when.max = video.duration;
      when.value = video.currentTime;
      when.setAttribute("aria-valuetext", `${(video.currentTime + starts_s).toFixed(2)} s`);
      play.textContent = video.paused ? "Play" : "Pause";
    };
    play.addEventListener("click", () => (video.paused ? video.play() : video.pause()));
    when.addEventListener("input", () => { video.currentTime = Number(when.value); });
    for (const name of ["loadedmetadata", "seeked", "timeupdate", "play", "pause", "ended"]) video.addEventListener(name, update);
    update();
    if (!matchMedia("(hover: hover)").matches) return;
    video.controls = false;
    video.addEventListener("pointerenter", () => { video.controls = true; });
    video.addEventListener("pointerleave", () => { video.controls = false; });
  }

  function startVideo() {
    startPlayer();
    const follow = () => {
      now_s = video.currentTime + starts_s;
      showMoment();
    };
    const run = () => {
      if (video.paused || video.ended) return;
      follow();
      requestAnimationFrame(run);
    };
    video.addEventListener("play", run);
    for (const name of ["seeked", "timeupdate", "pause"]) video.addEventListener(name, follow);
    const fail = () => {
      video.hidden = byId("player").hidden = true;
      byId("video-missing").hidden = false;
    };
    if (video.error) fail();
    video.addEventListener("error", fail);
  }

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

  // ---- start ----

  startTheme();
  document.querySelectorAll("table.sortable").forEach(startSorting);
  if (tracks.length) {
    new ResizeObserver(([{ target }]) => { // keeps scroll targets clear of the video, which stays at the top
      document.documentElement.style.setProperty("--watch", `${target.offsetHeight + 8}px`);
    }).observe(byId("watch"));
    startLegend(byId("legend"), tracks.some((track) => track.truth));
    byId("now").hidden = false;
    startList();
    showPresent();
    if (video) startVideo();
  }
  if (content.errors && Object.keys(content.errors).length)
    wholeChart("error-chart", "Relative error against true distance, by method", "wide-chart", drawErrors);
  if (content.lines?.length) startComparison();
  content.charts?.forEach(startChart);
  if (content.calibration && Object.keys(content.calibration).length)
    wholeChart("sigma-chart", "Expected and observed fraction of errors within k sigma, by method", "square-chart", drawSigma);
})();
