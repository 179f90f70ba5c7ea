// Current time: that of the video, or of a clock where there is no video.

const video = byId("video");
const starts_s = content.starts_s || 0;
let now_s = content.timeline ? content.timeline.from_s : 0;
let isRunning = false; // the clock that replaces a missing video

const hasVideo = () => Boolean(video) && !video.hidden;
const isPlaying = () => (hasVideo() ? !video.paused && !video.ended : isRunning);

function seek(time_s) {
  now_s = Math.min(span.to_s, Math.max(span.from_s, time_s));
  if (hasVideo()) video.currentTime = Math.max(0, now_s - starts_s + 0.002); // inside the frame, not on its edge
  showMoment();
}

function togglePlay() {
  if (hasVideo()) {
    if (isPlaying()) video.pause();
    else video.play();
    return;
  }
  isRunning = !isRunning;
  if (isRunning && now_s >= span.to_s - 0.05) now_s = span.from_s;
  showPlaying();
  let last_ms = performance.now();
  const run = (time_ms) => {
    if (!isRunning) return;
    now_s = Math.min(span.to_s, now_s + Math.max(0, time_ms - last_ms) / 1000);
    last_ms = time_ms;
    isRunning = now_s < span.to_s;
    showMoment();
    if (isRunning) requestAnimationFrame(run);
    else showPlaying();
  };
  requestAnimationFrame(run);
}

function showPlaying() {
  byId("play").textContent = isPlaying() ? "Pause" : "Play";
}

function showMoment() {
  for (const chart of charts.values()) if (waiting.get(chart.box)?.isSeen) chart.follow();
  showPresent();
  showTimeline();
  showRoad();
  showMap();
  showKnown();
}

const metres = (track, row) => {
  const { m } = series(track);
  const known = [m.fused, m.fused_kf, ...Object.values(m)].find((values) => values && Number.isFinite(values[row]));
  return known ? known[row] : NaN;
};

// Tracks at the current time with their rows.
function onNow() {
  return tracks
    .filter((track) => track.from_s <= now_s + 0.001 && now_s <= track.to_s + 1)
    .map((track) => [track, rowAt(track, now_s)])
    .filter(([, row]) => row >= 0);
}

let presentText = "";
function showPresent() {
  const bar = byId("now");
  if (!bar) return;
  const present = onNow()
    .map(([track, row]) => [track, metres(track, row)])
    .sort((a, b) => (Number.isFinite(a[1]) ? a[1] : Infinity) - (Number.isFinite(b[1]) ? b[1] : Infinity))
    .slice(0, 24);
  const words = present.map(([track, value]) => titleOf(track) + (Number.isFinite(value) ? `  ${value.toFixed(1)} m` : ""));
  if (words.join() === presentText) return;
  presentText = words.join();
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
function startControls() {
  if (!matchMedia("(hover: hover)").matches) return;
  video.controls = false;
  video.addEventListener("pointerenter", () => { video.controls = true; });
  video.addEventListener("pointerleave", () => { video.controls = false; });
}

// While the events or the charts of the tracks are in view and most of the video is not, it is shown small in a corner. Its place on
// the page keeps its size, which has the shape of the video.
function startMini() {
  const [mini, picture, close] = [byId("mini"), byId("picture"), byId("close-mini")];
  const inView = new Map();
  let isClosed = false;
  const update = () => {
    const isNeeded = inView.get(byId("tracks")) || inView.get(byId("events"));
    const isSmall = Boolean(!isClosed && hasVideo() && isNeeded && inView.get(picture) === false); // no list of events: undefined
    if (isSmall === mini.classList.contains("small")) return;
    mini.classList.toggle("small", isSmall);
    close.hidden = !isSmall;
  };
  const observer = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting, intersectionRatio } of entries) inView.set(target, target === picture ? intersectionRatio >= 0.3 : isIntersecting);
    if (inView.get(picture)) isClosed = false;
    update();
  }, { threshold: [0, 0.3] });
  for (const part of [picture, byId("tracks"), byId("events")]) if (part) observer.observe(part);
  close.addEventListener("click", () => {
    isClosed = true;
    update();
  });
}

function startVideo() {
  startControls();
  const keepSize = () => byId("picture").style.setProperty("aspect-ratio", `${video.videoWidth} / ${video.videoHeight}`);
  if (video.readyState) keepSize();
  else video.addEventListener("loadedmetadata", keepSize);
  startMini();
  const follow = (time_s = video.currentTime) => {
    now_s = time_s + starts_s;
    showMoment();
    showPlaying();
  };
  const next = (run) => (video.requestVideoFrameCallback ? video.requestVideoFrameCallback((_, { mediaTime }) => run(mediaTime)) : requestAnimationFrame(() => run()));
  const run = (time_s) => {
    if (video.paused || video.ended) return;
    follow(time_s);
    next(run);
  };
  video.addEventListener("play", () => {
    showPlaying();
    next(run);
  });
  for (const name of ["seeked", "pause", "ended"]) video.addEventListener(name, () => follow());
  const fail = () => {
    video.hidden = true;
    byId("video-missing").hidden = false;
    byId("stage").classList.add("video-failed");
  };
  if (video.error) fail();
  video.addEventListener("error", fail);
}
