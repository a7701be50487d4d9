// Paths, ellipses, robots, symbols, in the colours of the figures, lighter on a dark page.
const DARK = window.matchMedia("(prefers-color-scheme: dark)");
const OUTCOMES = [
  { key: "tp", name: "TP", colour: "#0072B2", mark: "dot", dash: [], about: "paired with the right landmark" },
  { key: "tn", name: "TN", colour: "#56B4E9", mark: "star", dash: [2, 2], about: "correctly unpaired: not in the map" },
  { key: "fp", name: "FP", colour: "#D55E00", mark: "cross", dash: [], about: "paired with a wrong landmark" },
  { key: "fn", name: "FN", colour: "#E69F00", mark: "ring", dash: [5, 3], about: "unpaired, but in the map" },
];
const UNSCORED = { key: "", name: "?", colour: "#7A7A7A", mark: "dot", dash: [], about: "the right landmark is unknown" };
const SIGMAS = 3;

function ink() { return DARK.matches ? "#E4E4E4" : "#1B1B1B"; }
function faint() { return DARK.matches ? "#8A9098" : "#9A9A9A"; }
function paper() { return DARK.matches ? "#16181B" : "#FFFFFF"; }

const lighter = new Map();
function shade(colour) {
  if (!DARK.matches) return colour;
  if (!lighter.has(colour)) {
    const mixed = [1, 3, 5].map((i) => Math.round(parseInt(colour.slice(i, i + 2), 16) * 0.62 + 255 * 0.38));
    lighter.set(colour, `rgb(${mixed.join(",")})`);
  }
  return lighter.get(colour);
}

/** Rows [from, to) of a path; what falls on the same pixel is left out. */
function drawPath(c, view, xs, ys, from, to) {
  c.beginPath();
  let pen = false, lx = 0, ly = 0;
  for (let i = from; i < to; i++) {
    const x = view.px(xs[i]), y = view.py(ys[i]);
    if (!(x > -1e5 && x < 1e5 && y > -1e5 && y < 1e5)) { pen = false; continue; }
    if (!pen) { c.moveTo(x, y); pen = true; lx = x; ly = y; continue; }
    if (i < to - 1 && Math.abs(x - lx) < 1 && Math.abs(y - ly) < 1) continue;
    c.lineTo(x, y); lx = x; ly = y;
  }
  c.stroke();
}

/** Outline of the 3 sigma ellipse of a covariance given by its sigmas and correlation; on the canvas y points down. */
function ellipse(c, view, x, y, sx, sy, rho) {
  const a = sx * sx, b = rho * sx * sy, d = sy * sy;
  const middle = (a + d) / 2, half = Math.hypot((a - d) / 2, b);
  const long = SIGMAS * Math.sqrt(middle + half) * view.scale, short = SIGMAS * Math.sqrt(Math.max(middle - half, 0)) * view.scale;
  if (!(long < 1e5)) return false;
  c.beginPath();
  c.ellipse(view.px(x), view.py(y), Math.max(long, 0.5), Math.max(short, 0.5), -0.5 * Math.atan2(2 * b, a - d), 0, 2 * Math.PI);
  return true;
}

function robot(c, view, x, y, theta, size, fill, stroke) {
  const px = view.px(x), py = view.py(y), co = Math.cos(theta), si = Math.sin(theta);
  c.beginPath();
  for (const [i, [u, v]] of [[1, 0], [-0.7, 0.6], [-0.4, 0], [-0.7, -0.6]].entries()) {
    c[i ? "lineTo" : "moveTo"](px + size * (u * co - v * si), py - size * (u * si + v * co));
  }
  c.closePath();
  if (fill) { c.fillStyle = fill; c.fill(); }
  c.strokeStyle = stroke; c.stroke();
}

function symbol(c, mark, x, y, r, colour) {
  c.strokeStyle = colour; c.fillStyle = colour; c.lineWidth = 1.6; c.setLineDash([]);
  c.beginPath();
  if (mark === "dot") { c.arc(x, y, r, 0, 7); c.fill(); return; }
  if (mark === "ring") { c.arc(x, y, r, 0, 7); c.stroke(); return; }
  const lines = mark === "cross" ? [45, 135] : mark === "plus" ? [0, 90] : [0, 60, 120];
  for (const degrees of lines) {
    const u = r * 1.25 * Math.cos(degrees * Math.PI / 180), v = r * 1.25 * Math.sin(degrees * Math.PI / 180);
    c.moveTo(x - u, y - v); c.lineTo(x + u, y + v);
  }
  c.stroke();
}

function label(c, text, x, y, colour) {
  c.lineWidth = 3; c.strokeStyle = paper(); c.setLineDash([]); c.lineJoin = "round";
  c.strokeText(text, x, y); c.fillStyle = colour; c.fillText(text, x, y);
}

function scaleBar(c, view) {
  const wanted = 110 / view.scale, power = 10 ** Math.floor(Math.log10(wanted));
  const length = [5, 2, 1].map((f) => f * power).find((l) => l <= wanted) || power;
  const x = 12, y = view.height - 12, w = length * view.scale;
  c.setLineDash([]); c.strokeStyle = ink(); c.lineWidth = 1.5;
  c.beginPath(); c.moveTo(x, y - 4); c.lineTo(x, y); c.lineTo(x + w, y); c.lineTo(x + w, y - 4); c.stroke();
  c.textAlign = "left"; label(c, `${+length.toPrecision(2)} m`, x + 4, y - 5, ink());
}
