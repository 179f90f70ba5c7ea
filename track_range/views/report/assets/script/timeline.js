// Timeline of the run: number of road users, events and the current time; and the list of the events.

const events = content.events || [];
const LANE_PX = 9, MAX_LANES = 3;

const span = content.timeline || { from_s: 0, to_s: 1 };
const timelineBox = byId("timeline");
const timeX = (time_s, width) => ((time_s - span.from_s) / (span.to_s - span.from_s)) * width;

function activeEvents() {
  return events.flatMap(({ start_s, end_s }, index) => (start_s <= now_s + 0.011 && now_s <= end_s + 0.05 ? [index] : []));
}

// Lane of each event: the first in which it does not overlap an earlier one.
function lanesOf(list, gap_s) {
  const ends = [];
  return list.map(({ start_s, end_s }) => {
    let lane = ends.findIndex((end) => end < start_s);
    if (lane < 0) lane = ends.length < MAX_LANES ? ends.length : 0;
    ends[lane] = Math.max(end_s, start_s + gap_s);
    return lane;
  });
}

function drawTimeline() {
  const width = timelineBox.clientWidth, height = timelineBox.clientHeight;
  const lanes = lanesOf(events, (4 / width) * (span.to_s - span.from_s));
  const n_lanes = events.length ? Math.max(...lanes) + 1 : 0;
  const top = n_lanes * LANE_PX + 4, bottom = height - 16;
  const t = unpack(span.t, 1000), n = unpack(span.n, 1), ego = unpack(span.ego, 10);
  const most = Math.max(1, ...n);
  const svg = shape("svg", { "aria-hidden": "true", viewBox: `0 0 ${width} ${height}` });
  const { at, decimals } = ticks(span.from_s, span.to_s, Math.max(2, width / 90));
  for (const time_s of at) {
    const x = timeX(time_s, width);
    svg.append(shape("line", { class: "grid", x1: x, x2: x, y1: 0, y2: bottom }));
    if (x > 8 && x < width - 30) svg.append(shape("text", { x, y: height - 3, "text-anchor": "middle" }, clockText(time_s, decimals)));
  }
  let area = `M0 ${bottom}`;
  n.forEach((count, i) => {
    const y = (bottom - (count / most) * (bottom - top)).toFixed(1);
    area += `L${timeX(t[i], width).toFixed(1)} ${y}L${timeX(i + 1 < t.length ? t[i + 1] : span.to_s, width).toFixed(1)} ${y}`;
  });
  svg.append(shape("path", { class: "users", d: `${area}L${width} ${bottom}Z` }));
  if (ego) {
    const fastest = Math.max(5, ...ego.filter(Number.isFinite));
    const ys = Array.from(ego, (mps) => bottom - (mps / fastest) * (bottom - top));
    svg.append(shape("path", { class: "ego-speed", d: linePath(Array.from(t, (time_s) => timeX(time_s, width)), ys) }));
  }
  svg.append(shape("text", { class: "note", x: 4, y: top + 10 }, `road users (at most ${most})${ego ? ", line: ego speed" : ""}`));
  events.forEach((event, index) => {
    const x = timeX(event.start_s, width), end = timeX(event.end_s, width), y = lanes[index] * LANE_PX + 1;
    const mark = shape("rect", { class: "event-mark", "data-kind": event.kind, "data-index": index, x, y, width: Math.max(4, end - x), height: LANE_PX - 2, rx: 2 });
    mark.append(shape("title", {}, `${event.words}, ${event.object}, ${clockText(event.start_s, 1)}`));
    svg.append(mark);
    if (event.warning_s !== null) svg.append(shape("path", { class: "warning-mark", d: `M${timeX(event.warning_s, width)} ${y - 1}v${LANE_PX}` }));
  });
  timelineBox.line = shape("line", { class: "cursor", y1: 0, y2: bottom });
  svg.append(timelineBox.line);
  timelineBox.replaceChildren(svg);
  showTimeline();
}

function clockText(time_s, decimals = 1) {
  if (span.to_s < 120) return `${time_s.toFixed(decimals)} s`;
  const whole = Math.floor(time_s + 1e-6), pad = (value) => String(value).padStart(2, "0");
  const [hours, minutes, seconds] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, whole % 60];
  return hours || span.to_s >= 3600 ? `${hours}:${pad(minutes)}:${pad(seconds)}` : `${minutes}:${pad(seconds)}`;
}

function valueAt(packedText, ticksPerUnit, time_s) {
  const values = unpack(packedText, ticksPerUnit);
  return values[Math.min(values.length - 1, Math.max(0, Math.floor(((time_s - span.from_s) / (span.to_s - span.from_s)) * values.length)))];
}

function showTimeline() {
  if (!timelineBox) return;
  if (timelineBox.line) {
    const x = timeX(now_s, timelineBox.clientWidth);
    timelineBox.line.setAttribute("x1", x);
    timelineBox.line.setAttribute("x2", x);
  }
  const n = onNow().length, active = activeEvents();
  const ego = span.ego ? valueAt(span.ego, 10, now_s) : NaN;
  const text = `${now_s.toFixed(2)} s`;
  const words = [`${n} road user${n === 1 ? "" : "s"}`, ...(Number.isFinite(ego) ? [`ego ${(3.6 * ego).toFixed(0)} km/h`] : [])];
  byId("clock").textContent = `${text} \u00b7 ${words.join(" \u00b7 ")}`;
  timelineBox.setAttribute("aria-valuenow", now_s.toFixed(2));
  timelineBox.setAttribute("aria-valuetext", [text, ...words, ...active.map((index) => `${events[index].words}, ${events[index].object}`)].join(", "));
  eventButtons.forEach((button, index) => {
    const isActive = active.includes(index);
    if ((button.getAttribute("aria-current") === "true") === isActive) return;
    if (isActive) button.setAttribute("aria-current", "true");
    else button.removeAttribute("aria-current");
  });
}

// ---- list of events ----

const eventButtons = [...document.querySelectorAll("#events .event")];

function jumpTo(index) {
  seek(events[index].start_s);
  choose(index);
}

// One button of the list is in the tab order; the list is scrolled to it, the page is not.
function choose(index, isFocused = false) {
  eventButtons.forEach((button, i) => { button.tabIndex = i === index ? 0 : -1; });
  const button = eventButtons[index], list = byId("events");
  if (isFocused) button.focus({ preventScroll: true });
  const [inner, outer] = [button.getBoundingClientRect(), list.getBoundingClientRect()];
  if (inner.top < outer.top) list.scrollTop -= outer.top - inner.top;
  else if (inner.bottom > outer.bottom) list.scrollTop += inner.bottom - outer.bottom;
}

function startEvents() {
  if (!eventButtons.length) return;
  eventButtons.forEach((button, index) => button.addEventListener("click", () => jumpTo(index)));
  byId("events").addEventListener("keydown", (event) => {
    const index = eventButtons.indexOf(document.activeElement), last = eventButtons.length - 1;
    const targets = { ArrowDown: index + 1, ArrowRight: index + 1, ArrowUp: index - 1, ArrowLeft: index - 1, Home: 0, End: last };
    if (index < 0 || !(event.key in targets)) return;
    choose(Math.min(last, Math.max(0, targets[event.key])), true);
    event.preventDefault();
  });
  choose(0);
  byId("next").addEventListener("click", () => jumpBy(1));
  byId("previous").addEventListener("click", () => jumpBy(-1));
}

// Jump to the next or the previous event.
function jumpBy(direction) {
  const isNext = ({ start_s }) => start_s > now_s + 0.05, isPrevious = ({ start_s }) => start_s < now_s - 0.05;
  const index = direction > 0 ? events.findIndex(isNext) : events.findLastIndex(isPrevious);
  if (index >= 0) jumpTo(index);
}

// Keys of the whole page, where no control has the focus: j, k = events; space = play; left, right = time.
function startKeys() {
  document.addEventListener("keydown", (event) => {
    if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey) return;
    const focused = document.activeElement, isText = focused?.matches("input, select, textarea");
    const isControl = focused?.matches("a, button, summary, video, [tabindex]") && focused !== document.body;
    const step_s = event.shiftKey ? span.frame_s : 1;
    if (!isText && (event.key === "j" || event.key === "k")) jumpBy(event.key === "j" ? 1 : -1);
    else if (isText || isControl) return;
    else if (event.key === " ") togglePlay();
    else if (event.key === "ArrowLeft") seek(now_s - step_s);
    else if (event.key === "ArrowRight") seek(now_s + step_s);
    else return;
    event.preventDefault();
  });
}

function startTimeline() {
  byId("time").hidden = false;
  timelineBox.setAttribute("aria-valuemin", span.from_s);
  timelineBox.setAttribute("aria-valuemax", span.to_s);
  const point = (event) => {
    const mark = event.type === "pointerdown" ? event.target.closest(".event-mark") : null;
    if (mark) return jumpTo(Number(mark.dataset.index));
    const box = timelineBox.getBoundingClientRect();
    seek(span.from_s + ((event.clientX - box.left) / box.width) * (span.to_s - span.from_s));
  };
  timelineBox.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    timelineBox.setPointerCapture(event.pointerId);
    point(event);
  });
  timelineBox.addEventListener("pointermove", (event) => { if (event.buttons === 1 && timelineBox.hasPointerCapture(event.pointerId)) point(event); });
  timelineBox.addEventListener("keydown", (event) => {
    const step_s = event.shiftKey ? span.frame_s : 1;
    const targets = {
      ArrowLeft: now_s - step_s, ArrowDown: now_s - step_s, ArrowRight: now_s + step_s, ArrowUp: now_s + step_s,
      PageDown: now_s - 10, PageUp: now_s + 10, Home: span.from_s, End: span.to_s,
    };
    if (event.key in targets) seek(targets[event.key]);
    else if (event.key === "Enter" || event.key === " ") togglePlay();
    else return;
    event.preventDefault();
  });
  new ResizeObserver(drawTimeline).observe(timelineBox);
}
