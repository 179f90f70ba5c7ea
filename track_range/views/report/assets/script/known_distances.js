// Known distances: objects chosen at the current time, and the command that calibrates the camera with them.

const known = { part: byId("known"), list: [], text: "" };

// Boxes of the tracks at the current time: [track, [left, top, right, bottom] in px, time in s].
function boxesNow() {
  return onNow().flatMap(([track, row]) => {
    const { t, box } = series(track);
    if (!box.every((side) => side && Number.isFinite(side[row]))) return [];
    return track.observed && track.observed[row] === "0" ? [] : [[track, box.map((side) => side[row]), t[row]]];
  });
}

function showKnown() {
  if (!known.part || !known.part.open) return;
  const boxes = boxesNow(), choice = byId("known-object");
  const text = boxes.map(([track, box]) => `${track.id},${box}`).join(";");
  if (text === known.text) return;
  known.text = text;
  known.boxes = boxes;
  const chosen = choice.value;
  choice.replaceChildren(...boxes.map(([track, box]) => element("option", { value: track.id }, `${titleOf(track)}, ${box[3] - box[1]} px high`)));
  if (boxes.some(([track]) => String(track.id) === chosen)) choice.value = chosen;
  drawBoxes();
}

function drawBoxes() {
  if (!known.svg) return;
  known.svg.setAttribute("viewBox", `0 0 ${video.videoWidth || 1} ${video.videoHeight || 1}`);
  known.svg.replaceChildren(...(known.part.open ? known.boxes || [] : []).map(([track, [left, top, right, bottom]]) => {
    const isChosen = byId("known-object").value === String(track.id);
    const box = shape("rect", { x: left, y: top, width: right - left, height: bottom - top, class: isChosen ? "chosen" : "" });
    box.addEventListener("click", (event) => {
      event.stopPropagation();
      if (isPlaying()) togglePlay();
      byId("known-object").value = track.id;
      drawBoxes();
      byId("known-metres").focus();
    });
    return box;
  }));
}

const quoted = (text) => (/^[\w@%+=:,./-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`);

function showCommand() {
  byId("known-list").replaceChildren(...known.list.map((entry, i) => {
    const remove = element("button", { type: "button", "aria-label": `Remove ${entry.name}` }, "\u00d7");
    remove.addEventListener("click", () => {
      known.list.splice(i, 1);
      showCommand();
    });
    return element("li", {}, `${entry.name} at ${entry.time_s.toFixed(2)} s: ${entry.metres} m `, remove);
  }));
  const options = known.list.map((entry) => ` \\\n  --known-distance '${entry.time_s.toFixed(3)},${entry.box.join(",")},${entry.kind}=${entry.metres}'`);
  byId("known-result").hidden = !known.list.length;
  byId("known-command").textContent = `track-range calibrate --mono ${quoted(content.known_distances)}${options.join("")} \\\n  --out rig.yaml`;
  byId("known-state").textContent = "";
}

function addKnown() {
  const input = byId("known-metres"), metres = Number(input.value);
  const found = (known.boxes || []).find(([track]) => String(track.id) === byId("known-object").value);
  if (!found || !(metres >= 1 && metres <= 200)) {
    input.focus();
    return;
  }
  const [track, box, time_s] = found;
  known.list.push({ name: titleOf(track), kind: track.name, box, time_s, metres });
  input.value = "";
  showCommand();
}

async function copyCommand() {
  const command = byId("known-command");
  try {
    await navigator.clipboard.writeText(command.textContent);
    byId("known-state").textContent = "Copied.";
  } catch { // no access to the clipboard: the text is selected instead
    getSelection().selectAllChildren(command);
    byId("known-state").textContent = "Selected: copy it with the keyboard.";
  }
}

function startKnown() {
  if (!known.part) return;
  if (video) {
    known.svg = shape("svg", { class: "boxes", "aria-hidden": "true" });
    byId("mini").append(known.svg);
    video.addEventListener("loadedmetadata", drawBoxes);
  }
  known.part.addEventListener("toggle", () => {
    known.text = "";
    showKnown();
    drawBoxes();
  });
  byId("known-object").addEventListener("change", drawBoxes);
  byId("known-add").addEventListener("click", addKnown);
  byId("known-metres").addEventListener("keydown", (event) => { if (event.key === "Enter") addKnown(); });
  byId("known-copy").addEventListener("click", copyCommand);
}
