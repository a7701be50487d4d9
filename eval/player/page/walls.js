// Landmarks that are walls: straight lines n(alpha) . p = rho, where x of a landmark is rho [m] and y is alpha.
const BEYOND = 0.15;  // m that a wall is shown on either side of where it was seen

/** Where the run saw something, in the world, and how far along its wall: x, y by observation, for frames up to now. */
const seenCache = new Map();
function seenFrom(run) {
  const points = recording.of("point"), count = recording.column("count"), p = path(run);
  let own = seenCache.get(run.key);
  if (!own || own.path !== phaseOf(run)) seenCache.set(run.key, own = { path: phaseOf(run), x: [], y: [], frame: [], frames: 0 });
  let row = own.x.length;
  for (let k = own.frames; k < recording.frames; k++) {
    const c = Math.cos(p.theta[k]), s = Math.sin(p.theta[k]);
    for (let i = 0; i < count[k]; i++, row++) {
      own.x.push(p.xy[0][k] + c * points[0][row] - s * points[1][row]);
      own.y.push(p.xy[1][k] + s * points[0][row] + c * points[1][row]);
      own.frame.push(k);
    }
  }
  own.frames = recording.frames;
  return own;
}

/** By landmark number: from where to where along its line it has been seen up to the present frame [m]. */
function stretches(run, walls) {
  const seen = seenFrom(run), { decision } = decided(run), [, to] = rowsIn(S.frame), found = new Map();
  const places = new Map(walls.map((l) => [l.number, { along: [-Math.sin(l.y), Math.cos(l.y)], l }]));
  const created = recording.column(run.key + "created");
  for (let row = 0; row < to; row++) {
    const number = decision[row] >= 0 ? decision[row] : created ? created[row] : NEW, wall = places.get(number);
    if (!wall || !Number.isFinite(seen.x[row])) continue;
    const t = seen.x[row] * wall.along[0] + seen.y[row] * wall.along[1], own = found.get(number);
    if (!own) found.set(number, { from: t, to: t });
    else { own.from = Math.min(own.from, t); own.to = Math.max(own.to, t); }
  }
  return found;
}

/** A line across the whole view. */
function wallLine(c, view, rho, alpha, from = -Infinity, to = Infinity) {
  const n = [Math.cos(alpha), Math.sin(alpha)], far = (view.width + view.height) / view.scale;
  const middle = -n[1] * view.x + n[0] * view.y;
  const [a, b] = [Math.max(from, middle - far), Math.min(to, middle + far)];
  if (!(a < b)) return;
  c.beginPath();
  c.moveTo(view.px(rho * n[0] - a * n[1]), view.py(rho * n[1] + a * n[0]));
  c.lineTo(view.px(rho * n[0] - b * n[1]), view.py(rho * n[1] + b * n[0]));
  c.stroke();
}

/** The 3 sigma of a wall's distance along a stretch of it: var = s_rho^2 + 2 t cov + t^2 s_alpha^2. */
function wallBand(c, view, l, stretch) {
  const n = [Math.cos(l.y), Math.sin(l.y)], edge = [[], []], steps = 12;
  for (let i = 0; i <= steps; i++) {
    const t = stretch.from + (stretch.to - stretch.from) * i / steps;
    const variance = l.sx * l.sx - 2 * t * l.rho * l.sx * l.sy + t * t * l.sy * l.sy;
    const off = SIGMAS * S.enlarge * Math.sqrt(Math.max(variance, 0));
    for (const side of [0, 1]) {
      const d = l.x + (side ? off : -off);
      edge[side].push([view.px(d * n[0] - t * n[1]), view.py(d * n[1] + t * n[0])]);
    }
  }
  c.beginPath();
  for (const [i, [x, y]] of [...edge[0], ...edge[1].reverse()].entries()) c[i ? "lineTo" : "moveTo"](x, y);
  c.closePath(); c.fill();
}

function drawWalls(c, view, walls, colour, run, paired) {
  const found = stretches(run, walls), taken = [];
  c.textAlign = "center";
  for (const l of walls) {
    c.strokeStyle = colour; c.lineWidth = 0.6; c.globalAlpha = 0.3;
    wallLine(c, view, l.x, l.y);
    const seen = found.get(l.number);
    c.globalAlpha = 1;
    if (!seen) continue;
    const stretch = { from: seen.from - BEYOND, to: seen.to + BEYOND };
    c.fillStyle = colour; c.globalAlpha = 0.2;
    if (l.sx > KNOWN) wallBand(c, view, l, stretch);
    c.globalAlpha = 1; c.lineWidth = paired.has(l.number) ? 4 : 2.2;
    wallLine(c, view, l.x, l.y, stretch.from, stretch.to);
  }
  if (!S.numbers) return;
  for (const l of [...walls].sort((a, b) => paired.has(b.number) - paired.has(a.number) || a.number - b.number)) {
    const seen = found.get(l.number);
    if (!seen) continue;
    // beyond the wall, as seen from the robot, where no path is
    const n = [Math.cos(l.y), Math.sin(l.y)], t = (seen.from + seen.to) / 2, pose = poseOf(run);
    const side = pose && n[0] * pose.x + n[1] * pose.y > l.x ? -1 : 1;
    const x = view.px(l.x * n[0] - t * n[1]) + 13 * side * n[0], y = view.py(l.x * n[1] + t * n[0]) - 13 * side * n[1] + 4;
    if (taken.some((o) => Math.abs(x - o.x) < 18 && Math.abs(y - o.y) < 12)) continue;
    taken.push({ x, y });
    label(c, String(l.number), x, y, colour);
  }
}
