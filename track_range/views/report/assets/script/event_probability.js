// Probability of contact over time in the cards of the events, with the thresholds of the alarm.

const PROBABILITY_BOX = { width: 260, height: 56, left: 30, right: 6, top: 5, bottom: 13 };
const AROUND_S = { before: 3, after: 1 }; // shown before the start and after the end of an event

// A chart for each event whose track has a known probability; rows of earlier versions have none.
function startProbabilities() {
  eventButtons.forEach((button, index) => {
    const chart = probabilityChart(events[index]);
    if (chart) button.append(chart);
  });
}

function probabilityChart(event) {
  const track = tracks.find(({ id }) => id === event.track_id);
  if (!track?.p || !content.alarm) return null;
  const from_s = Math.max(event.start_s - AROUND_S.before, span.from_s), to_s = Math.min(event.end_s + AROUND_S.after, span.to_s);
  const { t, p, p_on, isBreak } = series(track), { width, height, left, right, top, bottom } = PROBABILITY_BOX;
  const rows = Array.from(t.keys()).filter((i) => t[i] >= from_s && t[i] <= to_s);
  if (!rows.some((i) => Number.isFinite(p[i])) || !(to_s > from_s)) return null;
  const x = (time_s) => left + ((time_s - from_s) / (to_s - from_s)) * (width - left - right);
  const y = (probability) => top + (1 - probability) * (height - top - bottom);
  const on = track.name === "person" ? content.alarm.person : content.alarm.on;
  const seen_s = track.from_s >= from_s ? track.from_s : null;
  const moments = [["seen", seen_s, "first seen"], ["warned", event.warning_s, "warning"], ["peak", event.peak_s, "most critical"]].filter(([, time_s]) => time_s !== null);
  const words = moments.map(([, time_s, name]) => `${name} at ${clockText(time_s)}`).join(", ");
  const svg = shape("svg", { class: "probability", viewBox: `0 0 ${width} ${height}`, role: "img",
    "aria-label": `Predicted probability of contact of ${titleOf(track)}; alarm from ${percent(on)} where hard braking is needed, off below ${percent(content.alarm.off)}; ${words}` });
  svg.append(shape("title", {}, `Predicted probability of contact; dashed: an alarm needs this if the object keeps its speed, less if it brakes, at least ${percent(on)}; dotted: it ends below ${percent(content.alarm.off)}; ${words}`));
  const off_y = y(content.alarm.off), xs = rows.map((i) => x(t[i])), isGap = (i) => isBreak(rows[i]);
  svg.append(shape("line", { class: "limit", x1: left, x2: width - right, y1: off_y, y2: off_y, "stroke-dasharray": "1 3" }));
  if (p_on) svg.append(shape("path", { class: "limit", d: linePath(xs, rows.map((i) => y(p_on[i])), isGap), "stroke-dasharray": "4 2" }));
  svg.append(shape("line", { class: "axis", x1: left, x2: width - right, y1: y(0), y2: y(0) }));
  for (const [name, time_s] of moments)
    svg.append(shape("line", { class: name, x1: x(time_s), x2: x(time_s), y1: top, y2: y(0) }));
  svg.append(shape("path", { class: "line", d: linePath(xs, rows.map((i) => y(p[i])), isGap) }));
  for (const [text, at] of [["100 %", 1], [percent(on), on]])
    svg.append(shape("text", { x: left - 3, y: y(at) + 3, "text-anchor": "end" }, text));
  svg.append(shape("text", { x: left, y: height - 2 }, clockText(from_s)), shape("text", { x: width - right, y: height - 2, "text-anchor": "end" }, clockText(to_s)));
  for (const [name, time_s] of moments)
    if (name === "warned") svg.append(shape("text", { class: name, x: x(time_s), y: height - 2, "text-anchor": "middle" }, clockText(time_s, 2)));
  return svg;
}

const percent = (share) => `${(100 * share).toFixed(0)} %`;
