// Landmarks of a run after any frame, and candidates of its observations.
const COARSE = 0.01, ROUGH = 0.02;  // steps of the stored logarithm of a sigma, and of a correlation (eval/player/scene.py)

/** By landmark number: frames of its changes, and state after each: x, y, sigma_x, sigma_y, rho, there. */
function landmarkHistory(recording, key, quantum) {
  const number = recording.column(key + "change_number");
  if (!number) return null;
  const frame = recording.column(key + "change_frame"), there = recording.column(key + "change_there");
  const steps = recording.of(key + "change"), begins = recording.begins.get(key + "change"), found = new Map();
  for (let i = 0; i < number.length; i++) {
    if (begins.has(i)) for (const own of found.values()) own.sum.fill(0);  // differences restart
    let own = found.get(number[i]);
    if (!own) found.set(number[i], own = { sum: [0, 0, 0, 0, 0], frames: [], states: [] });
    for (let c = 0; c < 5; c++) own.sum[c] += steps[c][i];
    const s = own.sum;
    own.frames.push(frame[i] - recording.first);
    own.states.push({ number: number[i], x: s[0] * quantum, y: s[1] * quantum, sx: Math.exp(s[2] * COARSE),
      sy: Math.exp(s[3] * COARSE), rho: s[4] * ROUGH, there: there[i] === 1 });
  }
  return found;
}

function landmarksAt(history, frame) {
  const found = [];
  for (const own of history.values()) {
    const i = after(own.frames, frame) - 1;
    if (i >= 0 && own.states[i].there) found.push(own.states[i]);
  }
  return found;
}

/** Landmarks of the last map initialized up to `frame`; all of a given map. */
function landmarksLast(recording, key, frame) {
  const number = recording.column(key + "map_number"), found = [];
  if (!number) return found;
  const first = recording.column(key + "map_first"), xy = recording.of(key + "map_xy");
  const sigma = recording.of(key + "map_sigma"), rho = recording.column(key + "map_rho");
  for (let i = 0; i < number.length; i++) {
    if (first[i] <= frame) {
      found.push({ number: number[i], x: xy[0][i], y: xy[1][i], sx: sigma[0][i], sy: sigma[1][i], rho: rho[i], there: true });
    }
  }
  return found;
}

function givenLandmarks(recording) {
  const number = recording.column("map_number"), xy = recording.of("map_xy"), found = [];
  for (let i = 0; number && i < number.length; i++) {
    found.push({ number: number[i], x: xy[0][i], y: xy[1][i], sx: 0, sy: 0, rho: 0, there: true });
  }
  return found;
}

/** Rows of a sorted column that equal x: [from, to). */
function rowsOf(values, x) {
  return [after(values, x - 0.5), after(values, x)];
}

/** Candidates of an observation (row of the log), nearest first: {number, d2}. */
function candidatesOf(recording, key, row) {
  const rows = recording.column(key + "pair_row");
  if (!rows) return [];
  const number = recording.column(key + "pair_number"), d2 = recording.column(key + "pair_d2"), found = [];
  const [from, to] = rowsOf(rows, row);
  for (let i = from; i < to; i++) found.push({ number: number[i], d2: d2[i] });
  return found.sort((a, b) => a.d2 - b.d2 || a.number - b.number);
}

/** Where the candidates of a frame were expected, in the robot's frame. */
function expectedIn(recording, key, frame) {
  const frames = recording.column(key + "seen_frame"), found = new Map();
  if (!frames) return found;
  const number = recording.column(key + "seen_number"), xy = recording.of(key + "seen_xy");
  const sigma = recording.of(key + "seen_sigma"), rho = recording.column(key + "seen_rho");
  const [from, to] = rowsOf(frames, frame);
  for (let i = from; i < to; i++) {
    found.set(number[i], { x: xy[0][i], y: xy[1][i], sx: sigma[0][i], sy: sigma[1][i], rho: rho[i] });
  }
  return found;
}
