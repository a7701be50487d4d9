// What is shown now.
const recording = new Recording();
const S = { frame: 0, playing: false, speed: 1, clock: 0, run: 0, phase: "online", shown: new Set(), follow: false,
  numbers: true, rays: true, enlarge: 1, row: -1, method: "", component: 0 };
const histories = new Map();

function runs() { return recording.head.runs; }
function focus() { return runs()[S.run]; }
function phaseOf(run) { return run.phases.includes(S.phase) ? S.phase : run.phases[0]; }
function path(run, phase = phaseOf(run), robot = null) {
  const key = run.key + (robot ? robot.key : "") + phase + "_";
  return { xy: recording.of(key + "xy"), theta: recording.column(key + "theta"), sigma: recording.of(key + "sigma"),
    rho: recording.column(key + "rho"), nees: recording.column(key + "nees") };
}
function poseOf(run, frame = S.frame, robot = null) {
  const p = path(run, phaseOf(run), robot);
  if (!p.xy) return null;
  const [x, y, theta] = [p.xy[0][frame], p.xy[1][frame], p.theta[frame]];
  return Number.isFinite(x) ? { x, y, theta, sx: p.sigma[0][frame], sy: p.sigma[1][frame], rho: p.rho[frame] } : null;
}

/** Decisions, outcomes and right landmarks of the run in the phase that is shown. */
function decided(run) {
  const name = phaseOf(run) === "final" ? "final_" : "";
  return { decision: recording.column(run.key + name + "decision"), outcome: recording.column(run.key + name + "outcome"),
    right: recording.column(run.key + name + "right") };
}

let starts = null;
function rowsIn(frame) {
  if (!starts || starts.length !== recording.frames + 1) {
    const count = recording.column("count");
    starts = new Int32Array(recording.frames + 1);
    for (let k = 0; k < recording.frames; k++) starts[k + 1] = starts[k] + count[k];
  }
  return [starts[frame], starts[frame + 1]];
}
function frameOf(row) { rowsIn(0); return after(starts, row) - 1; }

function outcomeOf(d, row) { return d.outcome ? OUTCOMES[d.outcome[row]] : UNSCORED; }

/** Frames in which the run shown decided something wrongly, ascending. */
const wrongCache = new Map();
function wrongFrames() {
  if (!focus().decides) return [];
  const run = focus(), key = run.key + phaseOf(run);
  if (!wrongCache.has(key)) {
    const { outcome } = decided(run), found = [];
    for (let row = 0; outcome && row < outcome.length; row++) {
      if (outcome[row] >= 2) { const k = frameOf(row); if (found[found.length - 1] !== k) found.push(k); }
    }
    wrongCache.set(key, found);
  }
  return wrongCache.get(key);
}

/** Landmarks of the run shown as far as they are known for this instant. */
function landmarksNow() {
  const run = focus();
  if (run.task === "localization") return givenLandmarks(recording);
  if (phaseOf(run) === "online" && run.history) {
    if (!histories.has(run.key)) histories.set(run.key, landmarkHistory(recording, run.key, recording.head.quantum));
    return landmarksAt(histories.get(run.key), S.frame);
  }
  return landmarksLast(recording, run.key, phaseOf(run) === "final" ? Infinity : S.frame);
}

function seenPoint(row, pose) {
  const p = recording.of("point"), x = p[0][row], y = p[1][row], c = Math.cos(pose.theta), s = Math.sin(pose.theta);
  return { x: pose.x + c * x - s * y, y: pose.y + s * x + c * y };
}
function named(decision) {
  return decision >= 0 ? `landmark ${decision}` : { [NEW]: "new", [DISCARD]: "not used", [NOT_ASKED]: "not asked", [SINGULAR]: "singular covariance" }[decision];
}
