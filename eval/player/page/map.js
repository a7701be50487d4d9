// The map at the present frame.
const KNOWN = 1e-8;  // m; a smaller sigma is unknown or zero
let mapView = null, marks = [];
let ground = null;  // an occupancy grid: image, west, south, wide, high [m]

function worldBox() {
  const box = { x0: Infinity, y0: Infinity, x1: -Infinity, y1: -Infinity };
  const take = (xs, ys) => {
    for (let i = 0; xs && i < xs.length; i++) {
      if (!Number.isFinite(xs[i])) continue;
      box.x0 = Math.min(box.x0, xs[i]); box.x1 = Math.max(box.x1, xs[i]);
      box.y0 = Math.min(box.y0, ys[i]); box.y1 = Math.max(box.y1, ys[i]);
    }
  };
  const walls = recording.head.walls;
  if (walls && path(focus()).xy) { const seen = seenFrom(focus()); take(seen.x, seen.y); }
  for (const name of walls ? ["truth"] : ["truth", "true_xy", "map_xy", ...mates().map((r) => r.key + "truth")]) { const a = recording.of(name); if (a) take(a[0], a[1]); }
  if (!recording.of("truth")) for (const run of runs()) if (S.shown.has(run.key)) { const p = path(run); if (p.xy) take(...p.xy); }
  const own = recording.of(focus().key + "map_xy");
  if (own && !walls && !recording.of("true_xy")) take(own[0], own[1]);
  return box.x0 <= box.x1 ? box : { x0: -1, y0: -1, x1: 1, y1: 1 };
}

function drawMap() {
  const view = mapView, c = view.canvas.getContext("2d"), run = focus(), pose = poseOf(run);
  if (S.follow && pose) { view.x = pose.x; view.y = pose.y; }
  c.setTransform(view.ratio, 0, 0, view.ratio, 0, 0);
  c.fillStyle = paper(); c.fillRect(0, 0, view.width, view.height);
  c.font = "11px system-ui, sans-serif"; c.lineJoin = "round";
  drawGround(c, view);
  drawTruth(c, view);
  drawSources(c, view, path(run).xy);
  for (const r of runs()) if (S.shown.has(r.key) && r !== run) drawRunPath(c, view, r, 1.2);
  for (const r of mates()) drawRunPath(c, view, run, 1.5, r);
  drawRunPath(c, view, run, 2);
  if (run.loops && run.loops.length) drawLoops(c, view, run);
  marks = [];
  if (run.decides) drawObserved(c, view, run, pose);
  for (const r of runs()) if (S.shown.has(r.key) && r !== run) drawRobot(c, view, r, 7);
  for (const r of mates()) drawRobot(c, view, run, 8, r);
  drawRobot(c, view, run, 10);
  drawMeetings(c, view, run); drawNames(c, view, run);
  scaleBar(c, view);
}

function drawGround(c, view) {
  if (!ground) return;
  c.imageSmoothingEnabled = false;
  const { image, west, south, wide, high } = ground;
  c.drawImage(image, view.px(west), view.py(south + high), wide * view.scale, high * view.scale);
}

function drawTruth(c, view) {
  const xy = recording.of("true_xy"), truth = recording.of("truth");
  c.strokeStyle = faint(); c.lineWidth = 1; c.setLineDash([]);
  for (let i = 0; xy && i < xy[0].length; i++) {
    if (recording.head.walls) { wallLine(c, view, xy[0][i], xy[1][i]); continue; }
    const x = view.px(xy[0][i]), y = view.py(xy[1][i]);
    c.beginPath(); c.moveTo(x - 4, y); c.lineTo(x + 4, y); c.moveTo(x, y - 4); c.lineTo(x, y + 4); c.stroke();
  }
  if (!truth || !recording.head.truth) return;
  c.strokeStyle = faint(); c.lineWidth = 1; c.setLineDash([1, 3]);
  drawPath(c, view, truth[0], truth[1], 0, recording.frames);
  c.strokeStyle = ink(); c.setLineDash([]); c.lineWidth = 1.2;
  drawPath(c, view, truth[0], truth[1], 0, S.frame + 1);
  c.lineWidth = 0.7;
  for (const r of mates()) { const xy = recording.of(r.key + "truth"); if (xy) drawPath(c, view, xy[0], xy[1], 0, S.frame + 1); }
  const theta = recording.column("truth_theta")[S.frame];
  if (Number.isFinite(theta)) robot(c, view, truth[0][S.frame], truth[1][S.frame], theta, 11, null, ink());
}

/** Fixes and closures up to now; closures between the poses of a path. */
function drawSources(c, view, xy) {
  const fix = recording.of("fix_xy"), when = recording.column("fix_frame"), pairs = recording.of("closure_frames");
  c.strokeStyle = faint(); c.lineWidth = 0.8; c.setLineDash([]);
  for (let i = 0; fix && i < fix[0].length && when[i] <= S.frame; i++) {
    const x = view.px(fix[0][i]), y = view.py(fix[1][i]);
    c.beginPath(); c.moveTo(x - 2, y - 2); c.lineTo(x + 2, y + 2); c.moveTo(x - 2, y + 2); c.lineTo(x + 2, y - 2); c.stroke();
  }
  for (let i = 0; pairs && xy && i < pairs[0].length && pairs[1][i] <= S.frame; i++) {
    const [a, b] = [pairs[0][i], pairs[1][i]];
    c.beginPath(); c.moveTo(view.px(xy[0][a]), view.py(xy[1][a])); c.lineTo(view.px(xy[0][b]), view.py(xy[1][b])); c.stroke();
  }
}

function drawRunPath(c, view, run, width, mate = null) {
  const p = path(run, phaseOf(run), mate);
  if (!p.xy) return;
  const final = phaseOf(run) === "final";
  c.strokeStyle = mate ? shade(mate.colour) : tint(run); c.lineWidth = width; c.setLineDash(run.dash.map((d) => 2 * d));
  if (final) { c.globalAlpha = 0.4; drawPath(c, view, p.xy[0], p.xy[1], S.frame, recording.frames); c.globalAlpha = 1; }
  drawPath(c, view, p.xy[0], p.xy[1], 0, S.frame + 1);
  c.setLineDash([]);
}

function drawRobot(c, view, run, size, mate = null) {
  const pose = poseOf(run, S.frame, mate), colour = mate ? shade(mate.colour) : tint(run);
  if (!pose) return;
  c.lineWidth = 1.2; c.setLineDash([]);
  c.strokeStyle = colour;
  if (Number.isFinite(pose.sx) && ellipse(c, view, pose.x, pose.y, S.enlarge * pose.sx, S.enlarge * pose.sy, pose.rho)) {
    c.stroke();
    if (run === focus()) { c.globalAlpha = 0.15; c.fillStyle = colour; c.fill(); c.globalAlpha = 1; }
  }
  robot(c, view, pose.x, pose.y, pose.theta, size, colour, paper());
}

function drawObserved(c, view, run, pose) {
  const colour = tint(run), now = landmarksNow(), places = new Map(now.map((l) => [l.number, l]));
  c.setLineDash([]);
  if (recording.head.walls) drawWalls(c, view, now, colour, run, new Set(decided(run).decision.slice(...rowsIn(S.frame))));
  else for (const l of now) {
    const x = view.px(l.x), y = view.py(l.y);
    if (x < -200 || y < -200 || x > view.width + 200 || y > view.height + 200) continue;
    c.strokeStyle = colour; c.lineWidth = 1;
    if (l.sx > KNOWN && ellipse(c, view, l.x, l.y, S.enlarge * l.sx, S.enlarge * l.sy, l.rho)) { c.globalAlpha = 0.8; c.stroke(); c.globalAlpha = 1; }
    c.fillStyle = colour; c.fillRect(x - 1.5, y - 1.5, 3, 3);
  }
  const d = decided(run), [from, to] = rowsIn(S.frame);
  const taken = [];  // by numbers
  if (S.numbers && !recording.head.walls) writeNumbers(c, view, now, colour, new Set(d.decision.slice(from, to)), taken);
  if (!pose) return;
  for (let row = from; row < to; row++) {
    const seen = seenPoint(row, pose), outcome = outcomeOf(d, row), tint = shade(outcome.colour);
    const x = view.px(seen.x), y = view.py(seen.y), paired = recording.head.walls ? null : places.get(d.decision[row]);
    if (S.rays) {
      c.strokeStyle = tint; c.lineWidth = row === S.row ? 2.5 : 1.3; c.setLineDash(outcome.dash);
      c.beginPath(); c.moveTo(view.px(pose.x), view.py(pose.y)); c.lineTo(x, y); c.stroke();
      if (paired) { c.lineWidth = 0.8; c.setLineDash([2, 2]); c.beginPath(); c.moveTo(x, y); c.lineTo(view.px(paired.x), view.py(paired.y)); c.stroke(); }
    }
    symbol(c, outcome.mark, x, y, row === S.row ? 5.5 : 3.5, tint);
    if (row === S.row) { c.lineWidth = 1.5; c.strokeStyle = ink(); c.beginPath(); c.arc(x, y, 10, 0, 7); c.stroke(); }
    marks.push({ row, x, y });
    const width = 7 * String(row - from).length + 2;
    if (S.numbers && free(taken, x - 6 - width, y - 4, width)) { c.textAlign = "right"; label(c, String(row - from), x - 6, y - 4, tint); }
  }
}

/** Whether a number fits at a place; it is taken then. */
function free(taken, x, y, w) {
  if (taken.some((t) => x < t.x + t.w && t.x < x + w && Math.abs(y - t.y) < 11)) return false;
  taken.push({ x, y, w });
  return true;
}

/** Landmark numbers, those of the frame's pairings first, without overlap. */
function writeNumbers(c, view, landmarks, colour, paired, taken) {
  c.textAlign = "left";
  for (const l of [...landmarks].sort((a, b) => paired.has(b.number) - paired.has(a.number) || a.number - b.number)) {
    const x = view.px(l.x) + 4, y = view.py(l.y) + 11, w = 7 * String(l.number).length + 2;
    if (x < 0 || y < 0 || x > view.width || y > view.height) continue;
    if (free(taken, x, y, w)) label(c, String(l.number), x, y, colour);
  }
}

/** Key poses and the loop closures found up to now, by their state. */
function drawLoops(c, view, run) {
  const keys = recording.column(run.key + "key_frame"), xy = recording.of(run.key + "key_xy");
  const pairs = recording.of(run.key + "loop_keys"), state = recording.column(run.key + "loop_state");
  for (let i = 0; i < state.length; i++) {
    const [a, b] = [pairs[0][i], pairs[1][i]], style = run.loops[state[i]];
    if (keys[b] > S.frame || !style) continue;
    c.strokeStyle = shade(style.colour); c.lineWidth = state[i] === 0 ? 0.6 : 1.2; c.setLineDash(style.dash.map((d) => 2 * d));
    c.beginPath(); c.moveTo(view.px(xy[0][a]), view.py(xy[1][a])); c.lineTo(view.px(xy[0][b]), view.py(xy[1][b])); c.stroke();
  }
  c.fillStyle = ink();
  for (let i = 0; i < keys.length && keys[i] <= S.frame; i++) c.fillRect(view.px(xy[0][i]) - 1, view.py(xy[1][i]) - 1, 2, 2);
}
