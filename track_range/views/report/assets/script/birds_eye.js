// Bird's-eye view: positions of the tracks to scale, with their uncertainty, their trails and their courses.

const EGO_HALF_WIDTH_M = 0.9; // half of `WarningSettings.ego_width_m`
const BEND_PRIOR_M4 = 3600; // (2 * 0.3 m / 0.01 per m)^2: noise of a position, and a usual curvature
const TRAIL_S = 3, COURSE_S = 4;
const TTC_AMBER_S = 4, TTC_RED_S = 2, AMBER_PROBABILITY = 0.25; // as in the overlay
const RANGES_M = [15, 30, 60, 90, 120, 180];
const MAX_ON_ROAD = 40, MAX_LABELS = 8;

const roadView = byId("road-view");
let range_m = RANGES_M[1];

// Position of a track in a row: x to the right and z forward in m, sigma of z; null = unknown.
function positionAt(track, row) {
  const { m, s, x } = series(track);
  if (!x || !Number.isFinite(x[row])) return null;
  const name = m.fused && Number.isFinite(m.fused[row]) ? "fused" : "fused_kf";
  const z = m[name] ? m[name][row] : NaN;
  return Number.isFinite(z) && z > 0 ? { x: x[row], z, sigma: s[name] ? s[name][row] : NaN } : null;
}

// Course of a track relative to the camera: time to collision, offset there and its sigma, and whether it may hit.
function courseAt(track, row) {
  const { ttc, pass, pass_s, w, p, o } = series(track);
  if (!ttc || !Number.isFinite(ttc[row]) || !pass || !Number.isFinite(pass[row])) return null;
  const sigma = Number.isFinite(pass_s[row]) ? pass_s[row] : 0;
  const mayHit = content.has_warnings ? Boolean(p) && p[row] >= AMBER_PROBABILITY : Math.abs(pass[row]) <= EGO_HALF_WIDTH_M + w[row] / 2 + sigma;
  const start = o && Number.isFinite(o[row]) ? o[row] : null; // lateral offset from the ego path, as the warning has it
  return { ttc: ttc[row], offset: pass[row], sigma, mayHit, start };
}

// Curvature of the ego path in 1/m, positive = to the right: x - o = k z^2 / 2 of all objects, with a prior of k = 0.
function bendOf(users) {
  let sum = 0, squares = BEND_PRIOR_M4;
  for (const { track, row, position: { x, z } } of users) {
    const { o } = series(track);
    if (!o || !Number.isFinite(o[row])) continue;
    sum += 2 * (x - o[row]) * z * z;
    squares += z ** 4;
  }
  return sum / squares;
}

function alarmOf(track, row, course) {
  const { warning, p } = series(track);
  if (warning) return warning[row] > 0 ? "red" : p && p[row] >= AMBER_PROBABILITY ? "amber" : "";
  if (!course || !course.mayHit) return "";
  return course.ttc < TTC_RED_S ? "red" : course.ttc < TTC_AMBER_S ? "amber" : "";
}

// The smallest range that contains nine tenths of the positions: the scale does not change while the video plays.
function usualRange() {
  const all = [];
  for (const track of tracks.slice(0, 300)) { // the longest
    const { t } = series(track);
    const step = Math.max(1, Math.floor(t.length / 50));
    for (let row = 0; row < t.length; row += step) {
      const position = positionAt(track, row);
      if (position) all.push(position.z);
    }
  }
  const far_m = all.length ? quantile(all, 0.9) : 0;
  return RANGES_M.find((limit) => limit >= Math.max(20, far_m)) || RANGES_M[RANGES_M.length - 1];
}

function roadScale() {
  const width = roadView.clientWidth, height = roadView.clientHeight, bottom = height - 26;
  const px_per_m = (bottom - 8) / range_m;
  return { width, height, px_per_m, toX: (x) => width / 2 + x * px_per_m, toY: (z) => bottom - z * px_per_m };
}

function drawRoad() {
  const { width, height, px_per_m, toX, toY } = roadScale();
  const svg = shape("svg", { viewBox: `0 0 ${width} ${height}`, role: "img" });
  if (content.camera) {
    const far = 2 * range_m, { left, right } = content.camera;
    svg.append(shape("path", { class: "view", d: `M${toX(0)} ${toY(0)}L${toX(left * far)} ${toY(far)}H${toX(right * far)}Z` }));
  }
  const path = shape("path", { class: "path" });
  svg.append(path);
  const { at, decimals } = ticks(0, range_m, Math.max(3, height / 90));
  for (const z of at.slice(1)) {
    svg.append(shape("line", { class: "grid", x1: 0, x2: width, y1: toY(z), y2: toY(z) }));
    svg.append(shape("text", { class: "scale", x: 4, y: Math.max(12, toY(z) - 3) }, `${z.toFixed(decimals)} m`));
  }
  const half = Math.max(4, EGO_HALF_WIDTH_M * px_per_m);
  svg.append(shape("path", { class: "ego", d: `M${toX(0)} ${toY(0) - half}L${toX(0) + half} ${toY(0) + 1.6 * half}H${toX(0) - half}Z` }));
  const moving = shape("g", { class: "moving" });
  svg.append(moving);
  roadView.replaceChildren(svg);
  roadView.moving = moving;
  roadView.path = path;
  showRoad();
}

// Tracks at the current time, nearest first.
function onRoad() {
  return onNow()
    .map(([track, row]) => ({ track, row }))
    .map((user) => ({ ...user, position: positionAt(user.track, user.row) }))
    .filter(({ position }) => position)
    .sort((a, b) => a.position.z - b.position.z)
    .slice(0, MAX_ON_ROAD);
}

function showRoad() {
  if (!roadView || !roadView.moving) return;
  const scale = roadScale(), users = onRoad();
  const active = new Set(activeEvents().map((index) => events[index].track_id));
  const bend = bendOf(users);
  roadView.path.setAttribute("d", egoPath(bend, scale));
  const groups = users.map((user) => {
    const course = courseAt(user.track, user.row), alarm = alarmOf(user.track, user.row, course);
    return drawUser(user, course, alarm, active.has(user.track.id), { ...scale, bend });
  });
  drawLabels(users, groups, scale);
  roadView.moving.replaceChildren(...groups.reverse()); // the nearest is drawn last
  const svg = roadView.firstElementChild;
  svg.dataset.time = now_s.toFixed(3);
  svg.setAttribute("aria-label", `Bird's-eye view at ${now_s.toFixed(1)} s: ${users.slice(0, 6).map(wordsOnRoad).join("; ") || "no road users"}`);
}

// The ego path as wide as the vehicle, an arc of curvature `bend`.
function egoPath(bend, { toX, toY }) {
  const at = Array.from({ length: 25 }, (_, i) => (range_m * 1.05 * i) / 24);
  const side = (half) => at.map((z) => `${toX(half + (bend * z * z) / 2).toFixed(1)} ${toY(z).toFixed(1)}`);
  return `M${side(-EGO_HALF_WIDTH_M).join("L")}L${side(EGO_HALF_WIDTH_M).reverse().join("L")}Z`;
}

function wordsOnRoad({ track, position }) {
  const side = Math.abs(position.x) < 0.5 ? "" : `, ${Math.abs(position.x).toFixed(1)} m to the ${position.x < 0 ? "left" : "right"}`;
  return `${titleOf(track)} ${position.z.toFixed(1)} m ahead${side}`;
}

function drawUser({ track, row, position }, course, alarm, isActive, { px_per_m, toX, toY, bend }) {
  const { t, w } = series(track);
  const group = shape("g", { class: `user ${alarm}${isActive ? " active" : ""}`, "data-track": track.id, style: `--c: ${track.colour}` });
  group.isUrgent = Number(Boolean(alarm) || isActive);
  const [x, y] = [toX(position.x), toY(position.z)];
  let trail = "";
  for (let i = row; i >= 0 && t[row] - t[i] <= TRAIL_S; i--) {
    const past = positionAt(track, i);
    if (past) trail += `${trail ? "L" : "M"}${toX(past.x).toFixed(1)} ${toY(past.z).toFixed(1)}`;
  }
  group.append(shape("path", { class: "trail", d: trail }));
  if (course) group.append(...drawCourse(position, course, { toX, toY, px_per_m, bend }));
  if (Number.isFinite(position.sigma)) {
    const ray = Math.hypot(1, position.x / position.z);
    const across_m = (content.camera ? position.z / content.camera.focal_px : 0) + 0.02 * (w ? w[row] : 0); // of the box centre, as in the collision course
    const angle = (Math.atan2(position.x, position.z) * 180) / Math.PI;
    group.append(shape("ellipse", {
      class: "sigma-area", cx: x, cy: y, rx: Math.max(1.5, across_m * px_per_m), ry: Math.max(1.5, Math.min(position.sigma * ray, range_m) * px_per_m),
      transform: `rotate(${angle.toFixed(1)} ${x.toFixed(1)} ${y.toFixed(1)})`,
    }));
  }
  const half = w && Number.isFinite(w[row]) ? Math.min(2.5, w[row] / 2) * px_per_m : 0;
  group.append(shape("line", { class: "width", x1: x - half, x2: x + half, y1: y, y2: y }));
  if (alarm || isActive) group.append(shape("circle", { class: "ring", cx: x, cy: y, r: 8 }));
  const isPredicted = track.observed && track.observed[row] === "0";
  group.append(shape("circle", { class: isPredicted ? "dot predicted" : "dot", cx: x, cy: y, r: 4 }));
  return group;
}

// Names and distances of the nearest tracks and of those with an alarm or event, where they do not cover each other.
function drawLabels(users, groups, { width, toX, toY }) {
  const order = users.map((_, i) => i).sort((a, b) => groups[b].isUrgent - groups[a].isUrgent || a - b);
  const placed = [];
  for (const i of order) {
    const { track, position } = users[i], [x, y] = [toX(position.x), toY(position.z)];
    if (placed.length >= MAX_LABELS || y < 10 || x < -10 || x > width + 10) continue;
    const text = `${titleOf(track)}  ${position.z.toFixed(position.z < 9.95 ? 1 : 0)} m`, length = 6.6 * text.length;
    const boxes = [x + 11, x - 11 - length].map((left) => ({ left, right: left + length, y }));
    const isFree = (box) => box.left > 0 && box.right < width && placed.every((other) => box.right < other.left || box.left > other.right || Math.abs(box.y - other.y) > 13);
    const box = boxes.find(isFree);
    if (!box) continue;
    placed.push(box);
    groups[i].append(shape("text", { x: box === boxes[0] ? x + 11 : x - 11, y: y + 4, "text-anchor": box === boxes[0] ? "start" : "end" }, text));
  }
}

// After t seconds the object is at z (1 - t / ttc), and its offset has changed by a share t / ttc on the way to `offset`. The
// offset is relative to the ego path where the run has it, and to the axis of the camera elsewhere.
function drawCourse({ x, z }, { ttc, offset, sigma, mayHit, start }, { toX, toY, px_per_m, bend }) {
  const share = Math.min(1, COURSE_S / ttc), k = start === null ? 0 : bend, from = x - (k * z * z) / 2;
  const point = (part) => {
    const ahead = z * (1 - part);
    return [toX(from + (offset - from) * part + (k * ahead * ahead) / 2), toY(ahead)];
  };
  const points = Array.from({ length: k ? 9 : 2 }, (_, i) => point((share * i) / (k ? 8 : 1)));
  const end = points[points.length - 1], before = points[points.length - 2];
  const half = Math.max(1, sigma * share * px_per_m);
  const direction = Math.atan2(end[1] - before[1], end[0] - before[0]);
  const tip = (turn) => `${(end[0] - 8 * Math.cos(direction + turn)).toFixed(1)} ${(end[1] - 8 * Math.sin(direction + turn)).toFixed(1)}`;
  const texts = points.map((at) => at.map((value) => value.toFixed(1)).join(" "));
  const to = texts[texts.length - 1], kind = mayHit ? "course hit" : "course";
  const side = (sign) => points.map(([px, py], i) => `${(px + (sign * half * i) / (points.length - 1)).toFixed(1)} ${py.toFixed(1)}`);
  return [
    shape("path", { class: `${kind} spread`, d: `M${side(-1).join("L")}L${side(1).reverse().join("L")}Z` }),
    shape("path", { class: kind, d: `M${texts.join("L")}` }),
    shape("path", { class: `${kind} tip`, d: `M${tip(0.4)}L${to}L${tip(-0.4)}` }),
  ];
}

function startRoad() {
  byId("road").hidden = false;
  range_m = usualRange();
  const zoom = (step) => {
    range_m = RANGES_M[Math.min(RANGES_M.length - 1, Math.max(0, RANGES_M.indexOf(range_m) + step))];
    byId("zoom-in").disabled = range_m === RANGES_M[0];
    byId("zoom-out").disabled = range_m === RANGES_M[RANGES_M.length - 1];
    drawRoad();
  };
  byId("zoom-in").addEventListener("click", () => zoom(-1));
  byId("zoom-out").addEventListener("click", () => zoom(1));
  new ResizeObserver(() => { if (roadView.clientHeight > 60) drawRoad(); }).observe(roadView);
}
