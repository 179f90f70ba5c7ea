// Map of the drive: paths of the camera and of the tracks from above, to scale, with the places at the current time.

const MAP_HEIGHT_PX = [220, 560], MAP_SPACE_M = 5;
const drive = content.map && { ego: pathOf(content.map.ego), tracks: content.map.tracks.map((track) => ({ ...track, path: pathOf(track) })) };

function pathOf({ t, x, y }) {
  return { t: unpack(t, 1000), x: unpack(x, 100), y: unpack(y, 100) };
}

// Place at a time, between the points of a path; null = not on it.
function placeAt({ t, x, y }, time_s) {
  const last = t.length - 1;
  if (!(time_s >= t[0] - 0.05 && time_s <= t[last] + 0.15)) return null;
  let i = 0;
  while (i < last && t[i + 1] <= time_s) i++;
  const part = i < last ? Math.max(0, (time_s - t[i]) / (t[i + 1] - t[i])) : 0, next = Math.min(i + 1, last);
  return [x[i] + part * (x[next] - x[i]), y[i] + part * (y[next] - y[i])];
}

function mapLimits() {
  const xs = [...drive.ego.x], ys = [...drive.ego.y];
  for (const { path, at } of drive.tracks) {
    xs.push(...(at ? [at[0]] : path.x));
    ys.push(...(at ? [at[1]] : path.y));
  }
  const ends = (values) => values.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);
  return [ends(xs), ends(ys)].map(([low, high]) => [low - MAP_SPACE_M, high + MAP_SPACE_M]);
}

function drawMap(box) {
  let [[left, right], [low, high]] = mapLimits();
  const wide_px = box.clientWidth - MARGIN.left - MARGIN.right, edges_px = MARGIN.top + MARGIN.bottom;
  const fit_px = (wide_px * (high - low)) / (right - left);
  const height_px = Math.min(MAP_HEIGHT_PX[1], Math.max(MAP_HEIGHT_PX[0], fit_px));
  box.style.height = `${Math.round(height_px + edges_px)}px`;
  const m_per_px = Math.max((right - left) / wide_px, (high - low) / height_px);
  const more = [(m_per_px * wide_px - right + left) / 2, (m_per_px * height_px - high + low) / 2];
  [left, right, low, high] = [left - more[0], right + more[0], low - more[1], high + more[1]];
  const { plot, toX, toY } = axes(box, {
    x: { low: left, high: right, label: "x, m (forward at the start)" }, y: { low, high, label: "y, m (to the left)" },
  });
  // Of a parked road user, to scale, but at least 6 pixels long and 3 wide.
  const footprint = (at, size, heading) => {
    const [length, width] = size ? [Math.max(6, size[0] / m_per_px), Math.max(3, size[1] / m_per_px)] : [6, 6];
    const [x, y] = [toX(at[0]), toY(at[1])];
    return { x: x - length / 2, y: y - width / 2, width: length, height: width, transform: `rotate(${-(heading || 0)} ${x} ${y})` };
  };
  const line = ({ x, y }) => linePath([...x].map(toX), [...y].map(toY));
  for (const { id, name, colour, path, at, size, heading } of drive.tracks) {
    const mark = at
      ? shape("rect", { ...footprint(at, size, heading), fill: colour, "fill-opacity": 0.6, stroke: colour })
      : shape("path", { d: line(path), fill: "none", stroke: colour, "stroke-width": 1.5 });
    mark.dataset.track = id;
    mark.append(shape("title", {}, `${name} ${id}${at ? ", parked" : ""}${size ? `, ${size.join(" × ")} m` : ""}`));
    plot.append(mark);
  }
  plot.append(shape("path", { class: "map-ego", d: line(drive.ego) }));
  const now = shape("g", { class: "map-now" });
  plot.append(now);
  Object.assign(box, { now, toX, toY });
  box.onclick = (event) => { // to the moment at which the camera was nearest
    const area = box.getBoundingClientRect(), at = [event.clientX - area.left - MARGIN.left, event.clientY - area.top - MARGIN.top];
    const away = [...drive.ego.x].map((x, i) => Math.hypot(toX(x) - at[0], toY(drive.ego.y[i]) - at[1]));
    seek(drive.ego.t[away.indexOf(Math.min(...away))]);
  };
  showMap();
}

function showMap() {
  const box = byId("map-chart")?.firstElementChild;
  if (!drive || !box?.now) return;
  const dot = ([x, y], attributes) => shape("circle", { cx: box.toX(x), cy: box.toY(y), ...attributes });
  const places = drive.tracks.map(({ path, at, colour }) => [placeAt(path, now_s), at, colour]).filter(([place]) => place);
  const marks = places.map(([place, at, colour]) => dot(at || place, { r: 4.5, fill: colour, stroke: "currentColor" }));
  const ego = placeAt(drive.ego, now_s);
  box.now.replaceChildren(...marks, ...(ego ? [dot(ego, { r: 6, class: "map-camera" })] : []));
}

function startMap() {
  const box = element("div", { class: "chart map", role: "img", "aria-label": `Map of the drive: the path of the camera and of ${drive.tracks.length} road users` });
  byId("map-chart").replaceChildren(box);
  addChart(box, () => drawMap(box));
}
