// Robots of a team: each has a colour; the one of this page has the key "" (see `data.wing.Wing.company`).
const LASTING = 0.1;  // s that an observation of a robot stays while frames are played
function robots() { return recording.head.team ? recording.head.team.robots : []; }
function mates() { return robots().filter((r) => r.key); }

/** Colour of a run, or of the robot of this page in the run shown in detail. */
function tint(run) {
  const own = run === focus() && robots().find((r) => !r.key);
  return shade(own ? own.colour : run.colour);
}

/** What robots observed of each other at this frame, from the observer's pose, in its colour. */
function drawMeetings(c, view, run) {
  const frame = recording.column("met_frame"), by = recording.column("met_by"), point = recording.of("met_point");
  const paired = recording.column(run.key + "met"), outcome = recording.column(run.key + "met_outcome");
  if (!robots().length || !paired || !S.rays) return;
  const time = recording.column("time"), since = S.playing ? after(time, S.clock - LASTING * S.speed) : S.frame;
  for (let i = after(frame, Math.min(since, S.frame) - 1); i < frame.length && frame[i] <= S.frame; i++) {
    const robot = robots()[by[i]], pose = poseOf(run, frame[i], robot), seen = OUTCOMES[outcome[i]] || UNSCORED;
    if (!pose) continue;
    const co = Math.cos(pose.theta), si = Math.sin(pose.theta), [u, v] = [point[0][i], point[1][i]];
    const x = view.px(pose.x + co * u - si * v), y = view.py(pose.y + si * u + co * v);
    const other = paired[i] >= 0 && poseOf(run, frame[i], robots()[paired[i]]);
    c.strokeStyle = shade(robot.colour); c.lineWidth = 1.4; c.setLineDash(seen.dash);
    c.beginPath(); c.moveTo(view.px(pose.x), view.py(pose.y)); c.lineTo(x, y); c.stroke();
    if (other) { c.lineWidth = 0.8; c.setLineDash([2, 2]); c.beginPath(); c.moveTo(x, y); c.lineTo(view.px(other.x), view.py(other.y)); c.stroke(); }
    if (seen.key !== "tp") symbol(c, seen.mark, x, y, 3.5, shade(seen.colour));
  }
}

function drawNames(c, view, run) {
  const taken = [];
  c.textAlign = "left";
  for (const r of robots()) {
    const pose = poseOf(run, S.frame, r), width = 6 * r.name.length;
    if (!pose) continue;
    const near = [[11, -9], [11, 15], [-11 - width, -9], [-11 - width, 15]].map(([u, v]) => [view.px(pose.x) + u, view.py(pose.y) + v]);
    const [x, y] = near.find((at) => free(taken, ...at, width)) || near[0];
    label(c, r.name, x, y, shade(r.colour));
  }
}

function teamLegend() {
  const named = robots().map((r) => `<span><b style="color:${shade(r.colour)}">―</b> ${r.name}</span>`);
  return named.length ? [...named, "<span>thin: true paths</span>", "lines between robots: who observes whom, in the observer's colour; broken: not used"] : [];
}
