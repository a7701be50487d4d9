// Compatibility and matching of a frame in the robot's frame: x forward is up, y left is left.
let matchingView = null;

function drawMatching(run, from, to) {
  const canvas = $$("matching"), expected = run.candidates ? expectedIn(recording, run.key, S.frame) : new Map();
  canvas.hidden = S.row < 0 || !expected.size;
  if (canvas.hidden) return;
  const box = canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
  canvas.width = Math.round(box.width * ratio); canvas.height = Math.round(box.height * ratio);
  const p = recording.of("point"), sigma = recording.of("point_sigma"), rho = recording.column("point_rho");
  const c = canvas.getContext("2d"), d = decided(run), w = recording.head.methods.indexOf(S.method);
  const chosen = (row) => (w < 0 ? d.decision[row] : decidedBy(run, row, w));
  // the selected observation with its candidates and neighbours; forward is up
  const near = candidatesOf(recording, run.key, S.row).slice(0, 4).map((k) => expected.get(k.number)).filter(Boolean);
  const xs = [p[0][S.row], ...near.map((l) => l.x)], ys = [p[1][S.row], ...near.map((l) => l.y)];
  const middle = [(Math.min(...xs) + Math.max(...xs)) / 2, (Math.min(...ys) + Math.max(...ys)) / 2];
  const spread = Math.max(...near.slice(0, 1).map((l) => 3 * Math.max(l.sx, l.sy)), 3 * sigma[0][S.row], 3 * sigma[1][S.row], 0.02);
  const half = 1.25 * Math.max(Math.max(...xs) - middle[0], Math.max(...ys) - middle[1], 1.2 * spread);
  const scale = Math.min(box.width, box.height) / (2 * half);
  const view = { scale, width: box.width, height: box.height, px: (y) => box.width / 2 - (y - middle[1]) * scale,
    py: (x) => box.height / 2 - (x - middle[0]) * scale };
  // x forward is up and y left is left: the axes change places, and one changes sign with its correlation
  const turned = (l) => ellipse(c, { scale, px: () => view.px(l.y), py: () => view.py(l.x) }, 0, 0, l.sy, l.sx, -l.rho);
  c.setTransform(ratio, 0, 0, ratio, 0, 0);
  c.fillStyle = paper(); c.fillRect(0, 0, box.width, box.height);
  c.font = "11px system-ui, sans-serif"; c.setLineDash([]);
  for (const [number, l] of expected) {
    c.strokeStyle = faint(); c.lineWidth = 1;
    if (turned(l)) c.stroke();
    symbol(c, "plus", view.px(l.y), view.py(l.x), 3, faint());
    c.textAlign = "left"; label(c, String(number), view.px(l.y) + 5, view.py(l.x) + 11, faint());
  }
  const gate = recording.head.gate;
  for (let row = from; row < to; row++) {
    const right = d.right ? d.right[row] : NaN, n = chosen(row);
    const wrong = d.right && n > SINGULAR && !(n === right || (n < 0 && right < 0));
    const tint = shade(!d.right ? UNSCORED.colour : wrong ? "#D55E00" : "#0072B2");
    const x = view.px(p[1][row]), y = view.py(p[0][row]);
    const line = (l, colour, width, dash) => {
      c.strokeStyle = colour; c.lineWidth = width; c.setLineDash(dash);
      c.beginPath(); c.moveTo(x, y); c.lineTo(view.px(l.y), view.py(l.x)); c.stroke(); c.setLineDash([]);
    };
    for (const k of candidatesOf(recording, run.key, row)) {
      const l = expected.get(k.number);
      if (l && (gate === null || k.d2 < gate)) line(l, faint(), 0.8, []);
    }
    if (expected.has(n)) line(expected.get(n), tint, 2, wrong ? [4, 2] : []);
    if (wrong && expected.has(right)) line(expected.get(right), tint, 1, [1, 3]);
    c.strokeStyle = tint; c.lineWidth = 1;
    if (turned({ x: p[0][row], y: p[1][row], sx: sigma[0][row], sy: sigma[1][row], rho: rho[row] })) c.stroke();
    symbol(c, n >= 0 ? "dot" : n === NEW ? "star" : "cross", x, y, row === S.row ? 5 : 3.5, tint);
    c.textAlign = "right"; label(c, String(row - from), x - 6, y - 4, tint);
  }
  scaleBar(c, view);
  canvas.setAttribute("aria-label", `Observation ${S.row - from} and its expected candidates, forward is up. Grey lines: compatible pairs; coloured lines: pairs by ${S.method || run.association}; dashed: wrong pairs; dotted: to the right landmark. Dot: paired, star: new, cross: not used`);
}
