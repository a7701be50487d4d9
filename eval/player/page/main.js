// Wire the controls and play frames.
const $$ = (id) => document.getElementById(id);
let dirty = true, drawn = 0, spent = 0;

function changed() { dirty = true; }

function timeOf(frame) { return recording.column("time")[frame]; }

function go(frame) {
  const k = Math.min(Math.max(Math.round(frame), 0), recording.frames - 1);
  if (k !== S.frame) S.row = -1;
  S.frame = k; S.clock = timeOf(k);
  changed();
}

function play(on) {
  if (on && S.frame >= recording.frames - 1) go(0);
  S.playing = on; S.clock = timeOf(S.frame);
  $$("detail").setAttribute("aria-live", on ? "off" : "polite");  // not thirty announcements a second
  $$("play").textContent = on ? "Pause" : "Play";
  $$("play").setAttribute("aria-pressed", on);
  changed();
}

function toWrong(direction) {
  const frames = wrongFrames();
  const at = direction > 0 ? frames.find((k) => k > S.frame) : frames.findLast((k) => k < S.frame);
  if (at === undefined) return;
  play(false); go(at);
  const d = decided(focus()), [from, to] = rowsIn(S.frame);
  for (let row = from; row < to; row++) if (d.outcome[row] >= 2) { S.row = row; break; }
  changed();
}

function draw() {
  const begin = performance.now();
  dirty = false;
  drawMap(); showNow(); inspect(); drawCamera();
  spent += performance.now() - begin; drawn += 1;
}

let last = 0;
function tick(now) {
  const passed = Math.min((now - last) / 1000, 0.25);
  last = now;
  if (S.playing) {
    S.clock += passed * S.speed;
    const k = after(recording.column("time"), S.clock) - 1;
    if (k !== S.frame) { const clock = S.clock; go(k); S.clock = clock; }
    if (S.frame >= recording.frames - 1) play(false);
  }
  if (mapView.resize()) changed();
  if (dirty) draw();
  requestAnimationFrame(tick);
}

function showNow() {
  const head = recording.head, unit = head.indexed ? "" : `, ${timeOf(S.frame).toFixed(2)} s`;
  const text = `frame ${recording.first + S.frame} of ${recording.first + recording.frames - 1}${unit}`;
  $$("now").textContent = text;
  $$("slider").value = S.frame;
  $$("slider").setAttribute("aria-valuetext", text);
  moveCursors();
}

/** The recording has its first frames: show it. */
function opened() {
  if (!recording.head.runs.length) { $$("facts").textContent = "No run of this log can be played."; return; }
  mapView = new View($$("map"), changed);
  mapView.clicked = pick;
  wire();
  mapView.resize(); mapView.fit(worldBox());
  makePlots();
  DARK.addEventListener("change", () => { makePlots(); fillRuns(); fillLegend(); changed(); });
  requestAnimationFrame(tick);
  window.player = { S, recording, go, play, toWrong, marks: () => marks, redraw: changed,
    pose: () => poseOf(focus()), draw,
    cost: () => ({ drawn, milliseconds: spent / Math.max(drawn, 1) }), view: mapView };
  document.documentElement.dataset.ready = "true";
}
